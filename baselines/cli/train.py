"""`caterpillar rl train`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Literal

from rich.console import Console

from baselines.config import TrainConfig
from baselines.policy import TrainedRobot
from baselines.records import Point
from baselines.training import train
from caterpillar_env.errors import CaterpillarError
from caterpillar_env.files import unused
from caterpillar_env.morphology import Morphology
from caterpillar_env.robot import Robot
from evolution import cli
from evolution.cli.running import check_threads, film


@dataclass(frozen=True)
class TrainArgs:
    """Train a policy, on one body or on bodies that evolve with it."""

    out: Path | None = None
    """Folder to make; by default a new one under runs/."""
    body: Path | None = None
    """Take the body of an evolved robot: its run folder, or its best.json."""
    video: bool = True
    """Write best.mp4, a video of the best robot."""
    track: Literal["nowhere", "tensorboard"] = "nowhere"
    """tensorboard: log what the algorithm says of itself into the folder too."""
    threads: int = 0
    """Threads to simulate on; 0 for all cores."""
    config: TrainConfig = field(default_factory=TrainConfig)

    def __post_init__(self) -> None:
        check_threads(self.threads)
        if self.body is not None and self.config.morphology != Morphology():
            raise CaterpillarError(
                f"--body {self.body} says all of the body: leave out its single numbers"
            )


def train_command(argv: Sequence[str]) -> int:
    """`caterpillar rl train`."""
    args = cli.parse(TrainArgs, argv, "rl train", TrainArgs())
    config = args.config
    if args.body is not None:
        body = Robot.load(args.body).morphology
        if not isinstance(body, Morphology):
            raise CaterpillarError(
                f"{args.body} has a body for every segment, and a policy needs one for all: give a "
                "robot evolved with --genome shared or full"
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
        self._bar = cli.bar(console)
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
