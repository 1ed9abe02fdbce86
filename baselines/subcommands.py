"""`caterpillar rl train`, `rl eval` and `rl compare`."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tyro
from rich.console import Console
from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn
from rich.table import Table

from baselines.config import TrainConfig
from baselines.policy import AtRandom, Policy, TrainedRobot, judge
from baselines.records import Point, Record
from baselines.training import train
from caterpillar_env.errors import CaterpillarError
from caterpillar_env.morphology import Morphology
from caterpillar_env.physics import Physics
from caterpillar_env.task import label
from evolution import cli
from evolution.commands import film, unused
from evolution.fitness import Outcomes
from evolution.individual import Individual


@dataclass(frozen=True)
class TrainArgs:
    """Train a policy, on one body or on bodies that evolve with it."""

    out: Path | None = None
    """Folder to make; by default a new one under runs/."""
    body: Path | None = None
    """Take the body of an evolved robot: its run folder, or its best.json."""
    video: bool = True
    """Write best.mp4."""
    track: Literal["nowhere", "tensorboard"] = "nowhere"
    """tensorboard: log what the algorithm says of itself to the folder too."""
    threads: int = 0
    """Threads to simulate on; 0 for all cores."""
    config: TrainConfig = field(default_factory=TrainConfig)


def train_command(argv: Sequence[str]) -> int:
    """`caterpillar rl train`."""
    args = cli.parse(TrainArgs, argv, "rl train", TrainArgs())
    config = args.config
    if args.body is not None:
        body = Individual.load(args.body).morphology
        if not isinstance(body, Morphology):
            raise CaterpillarError(
                f"{args.body} has a body for every segment; a policy needs one for all"
            )
        config = replace(config, morphology=body)
    name = f"{config.algorithm}-{config.mode}" + ("-bandit" if config.open_loop else "")
    name += "" if config.design == "fixed" else f"-{config.design}-body"
    folder = args.out or unused(Path("runs"), f"{name}-seed{config.seed}")
    console = cli.console()
    with _Display(config, console) as display:
        result = train(
            config, folder, on_point=display.point, on_progress=display.progress,
            tensorboard=args.track == "tensorboard", threads=args.threads,
        )  # fmt: skip
    if not result.finished:
        console.print(f"stopped; the policies so far are in {folder}")
        return 130
    if args.video:
        film(TrainedRobot.load(folder), folder / "best.mp4", console)
    if result.best is None:
        print(f"no policy kept its robot from failing, in {folder}")
    else:
        print(f"best: {1000 * result.best.distance_m:.1f} mm in 30 s, in {folder}")
    return 0


class _Display:
    """A bar on a terminal, and a line for each evaluation."""

    def __init__(self, config: TrainConfig, console: Console) -> None:
        self._budget_s, self._console = config.budget_s, console
        self._best_m: float | None = None
        self._bar = Progress(
            TextColumn("{task.description}"), BarColumn(), TextColumn("{task.percentage:.0f} %, left"),
            TimeRemainingColumn(), console=console, disable=not console.is_terminal,
        )  # fmt: skip
        self._task = self._bar.add_task("training", total=config.budget_s)

    def __enter__(self) -> _Display:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def progress(self, spent_s: float) -> None:
        """Draw how far the training is."""
        self._bar.update(self._task, completed=min(spent_s, self._budget_s))

    def point(self, point: Point) -> None:
        """Print an evaluation."""
        if point.failure == "ok" and (self._best_m is None or point.distance_m > self._best_m):
            self._best_m = point.distance_m
        best = "none yet" if self._best_m is None else f"{1000 * self._best_m:.1f} mm"
        task = self._bar.tasks[0]
        elapsed, share = task.elapsed or 0.0, point.simulated_s / self._budget_s
        left = "" if self._console.is_terminal else f", left {elapsed * (1 / share - 1) / 60:.0f} min"
        self._bar.update(self._task, description=f"training, best {best}")
        self._console.print(
            f"{100 * min(share, 1.0):3.0f} %{left}  simulated {point.simulated_s:,.0f} s  deterministic "
            f"policy: {1000 * point.distance_m:.1f} mm ({point.failure}), best {best}",
        )


@dataclass(frozen=True)
class EvalArgs:
    """Let a trained policy crawl: as it was judged, drawing its actions, or on other ground."""

    folder: Annotated[Path, tyro.conf.Positional]
    """A training's folder."""
    which: Literal["best", "last", "random"] = "best"
    """Which of the policies that were kept; random: actions drawn evenly from the space instead."""
    stochastic: bool = False
    """Draw actions as in training, instead of taking the likeliest."""
    episodes: int = 1
    """How many episodes; without drawn actions all would be alike."""
    friction: tuple[float, ...] = ()
    """Try these friction coefficients."""
    mismatch_seeds: tuple[int, ...] = ()
    """Try these robots: other draws of the springs' strengths."""
    timestep: float | None = None
    """Another timestep than the training's, in s."""
    json: bool = False
    """Print data instead of sentences."""
    video: bool = False
    """Write eval.mp4 into the folder, of the first episode."""


def eval_command(argv: Sequence[str]) -> int:
    """`caterpillar rl eval`."""
    args = cli.parse(EvalArgs, argv, "rl eval")
    if args.episodes < 1:
        raise CaterpillarError(f"episodes = {args.episodes} must be at least 1")
    drawn = args.stochastic or args.which == "random"
    if args.video and drawn:
        raise CaterpillarError("a film is of the likeliest actions: leave out --video, or drawn actions")
    if args.episodes > 1 and not drawn:
        raise CaterpillarError(
            "episodes of the likeliest actions are all alike; add --stochastic to draw them"
        )
    robot = TrainedRobot.load(args.folder, "last" if args.which == "last" else "best")
    if args.which == "random":
        space = judge(robot.config).action_space
        robot = replace(robot, policy=Policy(AtRandom(space, robot.config.seed), None))
    rows = []
    for physics in _settings(robot.physics, args):
        for episode in range(args.episodes):
            outcome = replace(robot, physics=physics).simulate(
                args.timestep, seed=robot.config.seed + episode, deterministic=not drawn
            )
            rows.append(_row(physics, episode, outcome))
    if args.json:
        print(json.dumps(rows, indent=2))
    else:
        for row in rows:
            print(
                f"{1000 * row['distance_m']:.1f} mm in {row['time_s']:.1f} s ({row['failure']}), "
                f"{row['energy_j']:.1f} J, friction {row['friction']:g}, "
                f"mismatch seed {row['mismatch_seed']}"
            )
        if len(rows) > 1:
            fitness = [row["distance_m"] if row["failure"] == "ok" else 0.0 for row in rows]
            low, middle, high = 1000 * np.quantile(fitness, [0.25, 0.5, 0.75])
            print(f"median {middle:.1f} mm, quartiles {low:.1f} to {high:.1f}, failures counted as 0")
    if args.video:
        first = replace(robot, physics=_settings(robot.physics, args)[0])
        film(first, args.folder / "eval.mp4", cli.console(), args.timestep)
    return 0


def _settings(physics: Physics, args: EvalArgs) -> list[Physics]:
    """Every friction on every robot asked for."""
    return [
        replace(physics, friction=friction, mismatch_seed=seed)
        for friction in args.friction or (physics.friction,)
        for seed in args.mismatch_seeds or (physics.mismatch_seed,)
    ]


def _row(physics: Physics, episode: int, outcome: Outcomes) -> dict[str, Any]:
    return {
        "friction": physics.friction,
        "mismatch_seed": physics.mismatch_seed,
        "episode": episode,
        "distance_m": float(outcome.distance_m[0]),
        "energy_j": float(outcome.energy_j[0]),
        "time_s": float(outcome.simulated_s[0]),
        "failure": label(outcome.failure[0]),
    }


@dataclass(frozen=True)
class CompareArgs:
    """Put trainings side by side: a table, and their learning curves over simulated time."""

    folders: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Folders of trainings; those that differ in the seed alone are one row."""
    out: Path = Path("learning.png")
    """Where to draw the learning curves."""
    json: bool = False
    """Print data instead of a table."""


def compare_command(argv: Sequence[str]) -> int:
    """`caterpillar rl compare`."""
    from baselines import comparison

    args = cli.parse(CompareArgs, argv, "rl compare")
    if not args.folders:
        raise CaterpillarError("give the folders of trainings to compare")
    groups = comparison.grouped({folder: Record.load(folder) for folder in args.folders})
    rows = [comparison.summary(name, folders) for name, folders in groups.items()]
    comparison.draw(groups, args.out)
    if args.json:
        print(json.dumps([row._asdict() for row in rows], indent=2))
    else:
        table = Table(box=None, pad_edge=False)
        for heading in ("training", "seeds", "simulated", "untrained", "best: median", "least", "most"):
            table.add_column(heading, justify="left" if heading == "training" else "right")
        for row in rows:
            table.add_row(
                row.name, str(row.runs), f"{row.simulated_s:,.0f} s",
                *(f"{1000 * m:.1f} mm" for m in row[3:]),
            )  # fmt: skip
        Console(width=140).print(table)
    cli.console().print(f"learning curves drawn in {args.out}")
    return 0
