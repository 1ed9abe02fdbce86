"""A run's page: what was asked, what came out, and how to see it again, in one file."""

from __future__ import annotations

import json
import shlex
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

from matplotlib.figure import Figure

from caterpillar_env.drawing.video import is_video_of
from caterpillar_env.task import EPISODE_S, Failure
from caterpillar_env.validation.gaits import measure_gait
from evolution.config import OPTIMIZERS, PRIORS, RunConfig
from evolution.genome import Gene, gene_values
from evolution.priors.preprocessor import GenePrior, paper_priors
from evolution.report import figures as draw
from evolution.report.page import PageError, data_url, render
from evolution.run.history import Generation, History

PAGE = "report.html"
LARGEST_VIDEO_BYTES = 16 * 2**20


class GeneRow(NamedTuple):
    """A gene of the best robot, for people: values in mm, g, ° and s."""

    title: str
    unit: str
    value: float
    lower: float
    upper: float
    place: float  #: of the value between the bounds, in [0, 1]
    peak: float | None  #: of the prior; None if it is uniform
    width: float | None  #: standard deviation of the prior
    band: tuple[float, float]  #: from where to where the prior's width reaches, in [0, 1]
    peak_place: float | None


def write(folder: Path) -> Path:
    """Write `convergence.png`, `gait.png` and `report.html` into a run folder; the page's path.

    All of it comes out of the folder, and is the same each time.

    Raises:
        JournalError: see `Record.read`.
        RobotError: likewise.
        PageError: the folder cannot be written.
    """
    record = History.read(folder)
    generations = record.generations
    drawings: dict[str, Figure] = {}
    if generations:
        title = f"{folder.resolve().name}: {generations[-1].evaluations} evaluations"
        drawings["convergence"] = draw.convergence(generations, title)
    if record.best_robot is not None:
        drawings["gait"] = draw.gait(record.best_robot)
    try:
        for name, figure in drawings.items():
            draw.save(figure, folder / f"{name}.png")
        path = folder / PAGE
        drawn = {name: draw.inline_svg(figure, name) for name, figure in drawings.items()}
        path.write_text(page(record, drawn), encoding="utf-8")
    except OSError as error:
        raise PageError(
            f"cannot write into {folder}: {error.strerror}; make room there, or copy the run to "
            "a folder that can be written"
        ) from None
    return path


def page(record: History, figures: Mapping[str, str]) -> str:
    """The text of the page, with figures (SVG elements) of `convergence` and `gait` where there are."""
    config, generations = record.config, record.generations
    reasons = Counter(e.failure.label for e in record.evaluations)
    video, no_video = _video(record)
    known = [s.wall_s for s in record.sessions if s.wall_s is not None]
    in_session = Counter(e.session for e in record.evaluations)
    own = record.configuration.get("own_optimizer")
    commands = _commands(record, generations)
    return render(
        "run.html",
        {"mm": lambda m: f"{1000 * m:,.1f}", "duration": _duration},
        name=record.folder.resolve().name,
        commands=commands,
        width=max(len(line) for line, _ in commands),
        config=config,
        own=own,
        optimizer=f"an optimizer of its own, {own}" if own else OPTIMIZERS[config.optimizer],
        prior="" if own else PRIORS[config.prior],
        genes=gene_rows(record),
        changed=list(changed(record.configuration)),
        configuration=json.dumps(record.configuration, indent=2),
        finished=record.finished,
        ended=_ending(record, config, generations),
        generations=len(generations),
        unfinished=len(record.evaluations) - (generations[-1].evaluations if generations else 0),
        evaluations=len(record.evaluations),
        failed=len(record.evaluations) - reasons["ok"],
        failures=[(f.label, reasons[f.label]) for f in Failure if reasons[f.label]],
        simulated_s=sum(e.simulated_s for e in record.evaluations),
        sessions=[(s, in_session[s.number]) for s in record.sessions],
        wall_s=sum(known),
        unknown_ends=len(record.sessions) - len(known),
        episode_s=EPISODE_S,
        best=record.best_robot,
        gait=None if record.best_robot is None else measure_gait(record.best_robot),
        winner=record.best,
        figures=figures,
        video=video,
        no_video=no_video,
        version=version("caterpillar-sma"),
    )


def gene_rows(record: History) -> list[GeneRow]:
    """The genes of the best robot beside their bounds and what they are drawn from; none without one."""
    if record.best_robot is None:
        return []
    config = record.config
    drawn = config.distributions("mutation" if config.prior == "mutation-only" else "init")
    said = paper_priors(config.encoding)
    (best,) = gene_values([record.best_robot.morphology], record.best_robot.gaits)
    values = best.tolist()
    return [
        _gene_row(replace(prior, distribution=d), value)
        for prior, d, value in zip(said, drawn, values, strict=True)
    ]


def _gene_row(prior: GenePrior, value: float) -> GeneRow:
    gene: Gene = prior.gene
    factor, unit = gene.shown
    span = gene.upper - gene.lower

    def place(v: float) -> float:
        return min(max((v - gene.lower) / span, 0.0), 1.0)

    row = GeneRow(
        gene.title, unit, factor * value, factor * gene.lower, factor * gene.upper, place(value),
        None, None, (0.0, 1.0), None,
    )  # fmt: skip
    data = prior.to_dict()
    if data["mu"] is None or data["sigma"] is None:
        return row
    mu, sigma = float(data["mu"]), float(data["sigma"])
    return row._replace(
        peak=factor * mu, width=factor * sigma, peak_place=place(mu),
        band=(place(mu - sigma), place(mu + sigma)),
    )  # fmt: skip


def changed(configuration: Mapping[str, Any]) -> Iterator[tuple[str, str, str]]:
    """Fields of a configuration that are not the default: name, value and default, as JSON."""
    default = dict(_flat(RunConfig().to_dict()))
    for name, value in _flat(configuration):
        if name in default and json.dumps(value) != json.dumps(default[name]):
            yield name, json.dumps(value), json.dumps(default[name])


def _flat(data: Mapping[str, Any], prefix: str = "") -> Iterator[tuple[str, Any]]:
    for name, value in data.items():
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{name}.")
        else:
            yield prefix + name, value


def _ending(record: History, config: RunConfig, generations: Sequence[Generation]) -> str | None:
    """Why a finished run ends with this configuration; None if it would go on, or is not finished."""
    if not record.finished or not generations:
        return None
    last = generations[-1]
    return config.ending(len(generations), last.simulated_s, last.farthest_m)


def _commands(record: History, generations: Sequence[Generation]) -> list[tuple[str, str]]:
    """What can be done with the run, and why one would."""
    name = shlex.quote(record.folder.resolve().name)
    said = [
        (f"caterpillar replay {name}", "simulate the best robot again, and film it"),
        (f"caterpillar replay {name} --timestep-s 0.0005", "does it survive a finer timestep?"),
        (f"caterpillar replay {name} --generations 0 5 10 25 50", "the film of its evolution"),
        (f"caterpillar view {name}", "watch it in the browser, and change it by hand"),
    ] * (record.best_robot is not None)
    said.append((f"caterpillar export {name}", "every evaluation as a table"))
    more = 2 * record.config.generations
    if record.configuration.get("own_optimizer") is None:
        if not record.finished:
            said.append((f"caterpillar resume {name}", "go on"))
        elif _ending(record, replace(record.config, generations=more), generations) is None:
            said.append((f"caterpillar resume {name} --generations {more}", "go on for longer"))
    said.append((f"caterpillar report {name}", "make this page anew"))
    return said


def _video(record: History) -> tuple[str | None, str]:
    """The film as a data URL, or None and why not."""
    path = record.folder / "best.mp4"
    again = f"caterpillar report {shlex.quote(record.folder.resolve().name)}"
    if record.best_robot is None:
        return None, "There is no robot to film."
    if not path.exists():
        return None, f"best.mp4 was not made. {again} makes it, where this machine can draw."
    if not is_video_of(path, record.best_robot):
        return None, f"best.mp4 is of another robot than best.json. {again} makes it anew."
    size = path.stat().st_size
    if size > LARGEST_VIDEO_BYTES:
        return None, f"best.mp4, beside this page, is too large to be in it ({size / 2**20:.0f} MiB)."
    return data_url("video/mp4", path.read_bytes()), ""


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    if hours:
        return f"{hours} h {minutes} min"
    return f"{minutes} min {rest} s" if minutes else f"{rest} s"
