"""The page of a run: its settings, its results and its best robot, in one HTML file."""

from __future__ import annotations

import json
import shlex
from collections import Counter
from collections.abc import Iterator, Mapping
from datetime import timedelta
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

from matplotlib.figure import Figure

from caterpillar_env.drawing.video import Recording, is_video_of
from caterpillar_env.files import COPY, name_of, write_bytes
from caterpillar_env.task import EPISODE_S, Failure
from caterpillar_env.validation.gaits import measure_gait
from evolution.config import RunConfig
from evolution.objective import stopped
from evolution.report import figures as draw
from evolution.report.page import data_url, render
from evolution.report.replay import encode
from evolution.run.database import is_in_use
from evolution.run.history import History, to_outcomes

PAGE = "report.html"


class GeneRow(NamedTuple):
    """A gene of the best robot with its bounds and its prior, in mm, g, °, s or %."""

    title: str
    unit: str
    value: float
    lower: float
    upper: float
    peak: float | None  #: peak of the prior; None if the prior is uniform
    width: float | None  #: standard deviation of the prior; None if the prior is uniform

    def percent(self, value: float) -> float:
        """Return the position of a value between the bounds, clipped to 0 to 100."""
        share = (value - self.lower) / (self.upper - self.lower)
        return 100.0 * min(max(share, 0.0), 1.0)


def write(history: History, recording: Recording | None = None) -> Path:
    """Write `convergence.png`, `gait.png` and `report.html` into the run folder. Return the page's path.

    Args:
        history: the run.
        recording: recording of its best robot, if there is one already; otherwise one is made.

    Raises:
        CaterpillarError: a file cannot be written.
    """
    folder, generations, best = history.folder, history.generations, history.best_robot
    drawings: dict[str, Figure] = {}
    if generations:
        title = f"{name_of(folder)}: {generations[-1].evaluations} evaluations"
        drawings["convergence"] = draw.convergence(generations, title)
    if best is not None:
        drawings["gait"] = draw.gait(best)
    path = folder / PAGE
    for name, figure in drawings.items():
        draw.save(figure, folder / f"{name}.png")
    svgs = {name: draw.inline_svg(figure, name) for name, figure in drawings.items()}
    if recording is None and best is not None:
        recording = Recording(best)
    write_bytes(path, page(history, svgs, recording).encode(), COPY)
    return path


def page(history: History, figures: Mapping[str, str], recording: Recording | None = None) -> str:
    """Return the text of the page.

    Args:
        history: the run.
        figures: SVG elements by name, `convergence` and `gait`; both are optional.
        recording: recording of the best robot, for the 3D replay; optional.
    """
    config, generations, best = history.config, history.generations, history.best_robot
    evaluations, sessions, own = history.evaluations, history.sessions, history.own_optimizer
    reasons = Counter(e.failure.label for e in evaluations)
    per_session = Counter(e.session for e in evaluations)
    commands = next_commands(history, shlex.quote(name_of(history.folder)))
    return render(
        "run.html",
        {"mm": lambda m: f"{1000 * m:,.1f}", "duration": lambda s: str(timedelta(seconds=s))},
        name=name_of(history.folder),
        commands=commands,
        width=max((len(command) for command, _ in commands), default=0),
        config=config,
        own=own,
        own_objective=history.own_objective,
        genes=gene_rows(history),
        changed=list(changed(history.configuration)),
        configuration=json.dumps(history.configuration, indent=2),
        finished=history.finished,
        ending=history.stop_reason() if history.finished else None,
        generations=len(generations),
        incomplete=len(evaluations) - (generations[-1].evaluations if generations else 0),
        evaluations=len(evaluations),
        failed=len(evaluations) - reasons["ok"],
        stopped=int(stopped(to_outcomes(evaluations)).sum()),
        failures=[(f.label, reasons[f.label]) for f in Failure if reasons[f.label]],
        simulated_s=sum(e.simulated_s for e in evaluations),
        sessions=[(session, per_session[session.number]) for session in sessions],
        episode_s=EPISODE_S,
        best=history.best,
        gait=measure_gait(best) if best is not None and best.fitness_m else None,
        figures=figures,
        replay=None if recording is None else encode(recording),
        video=_embed_video(history),
        version=version("caterpillar-sma"),
    )


def gene_rows(history: History) -> list[GeneRow]:
    """Return the genes of the best robot, or an empty list if there is none."""
    best, config = history.best, history.config
    if best is None:
        return []
    (values,) = config.encoding.values(best.genome).tolist()
    rows = []
    for row, value in zip(config.priors(), values, strict=True):
        gene, (factor, unit) = row.gene, row.gene.shown
        bounds = factor * gene.lower, factor * gene.upper
        peak, width = (None if x is None else factor * x for x in (row.peak, row.width))
        rows.append(GeneRow(gene.title, unit, factor * value, *bounds, peak, width))
    return rows


def changed(configuration: Mapping[str, Any]) -> Iterator[tuple[str, str, str]]:
    """Yield the settings that differ from the defaults: name, value and default, as JSON."""
    default = dict(_flatten(RunConfig().to_dict()))
    for name, value in _flatten(configuration):
        if name in default and json.dumps(value) != json.dumps(default[name]):
            yield name, json.dumps(value), json.dumps(default[name])


def _flatten(data: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in data.items():
        if isinstance(value, Mapping):
            yield from _flatten(value, f"{prefix}{name}.")
        else:
            yield prefix + name, value


def next_commands(history: History, folder: str) -> list[tuple[str, str]]:
    """Return commands for the next steps with a run, each with its purpose.

    Args:
        history: the run.
        folder: the run folder for the commands, quoted for the shell.
    """
    commands = []
    if history.best is not None:
        commands += [
            (f"caterpillar replay {folder}", "simulate the best robot again, and film it"),
            (f"caterpillar view {folder}", "watch the robot in the browser, and change it by hand"),
        ]
    more = 2 * history.config.generations
    own = history.own_optimizer is not None or history.own_objective is not None
    if not own and not is_in_use(history.folder):
        if not history.finished:
            commands.append((f"caterpillar resume {folder}", "continue the run"))
        elif history.stop_reason(more) is None:
            commands.append((f"caterpillar resume {folder} --generations {more}", "make the run longer"))
    return commands


def _embed_video(history: History) -> str | None:
    """Return the video of the best robot as a data URL, or None if there is none."""
    path, best = history.folder / "best.mp4", history.best_robot
    if best is None or not is_video_of(path, best):
        return None
    return data_url("video/mp4", path.read_bytes())
