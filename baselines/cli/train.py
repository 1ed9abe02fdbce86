"""`caterpillar rl train`."""

from __future__ import annotations

import re
import shlex
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path

from baselines.config import TrainConfig, Training
from baselines.policy import TrainedRobot
from baselines.training import train
from caterpillar_env.drawing.video import Recording, is_video_of
from caterpillar_env.errors import CaterpillarError
from caterpillar_env.files import unused
from caterpillar_env.morphology import Morphology
from caterpillar_env.robot import Robot
from evolution import cli
from evolution.cli.running import ThreadArgs
from evolution.run.history import History


@dataclass(frozen=True)
class TrainArgs(ThreadArgs):
    """Train a policy within a budget of simulated seconds, for one body or together with the body."""

    out: Path | None = None
    """Folder to create; by default a new one in runs/."""
    body: Path | None = None
    """Run folder or best.json of an evolved robot, to use its body."""
    config: TrainConfig = field(default_factory=TrainConfig)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.body is not None and self.config.morphology != Morphology():
            raise CaterpillarError(
                "--body sets all parameters of the body; do not combine --body with options of single "
                "parameters, such as --segment-length-m"
            )


def train_command(argv: Sequence[str]) -> int:
    """Train a policy within a budget of simulated seconds."""
    args = cli.parse(TrainArgs, argv, "rl train", TrainArgs())
    config = args.config
    if args.body is not None:
        robot = Robot.load(args.body)
        body, old, new = robot.morphology, robot.physics.to_dict(), config.physics.to_dict()
        for name, value in old.items():
            if value != new[name]:
                cli.console().print(
                    f"warning: {args.body} was evolved with {name} = {value}; training uses {new[name]}"
                )
        if not isinstance(body, Morphology):
            raise CaterpillarError(
                f"{args.body} has one body per segment, but a policy needs the same body for all "
                "segments: give a robot evolved with --genome shared or full"
            )
        config = replace(config, morphology=body)
    name = re.sub(r"[^A-Za-z0-9.=-]+", "-", config.title)[:100]
    folder = args.out or unused(Path("runs"), f"{name}-seed{config.seed}")
    return follow(partial(train, config, folder, threads=args.threads), config, args.video)


def follow(run: Callable[..., Training], config: TrainConfig, video: bool) -> int:
    """Run `train` or `resume` with a progress bar, film the best robot, and return the exit status."""
    console = cli.console()
    with cli.bar(console) as bar:
        task = bar.add_task("training", total=config.budget_s)

        def show(history: History) -> None:
            latest, best = history.evaluations[-1], history.best
            best_text = "none yet" if best is None else f"{1000 * best.distance_m:.1f} mm"
            bar.update(task, completed=history.simulated_s, description=f"training, best {best_text}")
            left = cli.time_left(bar, console)
            console.print(
                f"{100 * history.simulated_s / config.budget_s:3.0f} %{left}  simulated "
                f"{history.simulated_s:,.0f} s  deterministic policy: {1000 * latest.distance_m:.1f} mm "
                f"({latest.failure.label}), best {best_text}"
            )

        history = run(
            on_evaluation=show, on_progress=lambda spent_s: bar.update(task, completed=spent_s)
        ).history
    folder = history.folder
    if not history.finished:
        console.print(f"stopped; continue with: caterpillar rl resume {shlex.quote(str(folder))}")
        return 130
    if len({evaluation.distance_m for evaluation in history.evaluations}) == 1:
        console.print(
            "all evaluations have the same distance: with a larger --budget-s, the policy may change"
        )
    if history.best is None:
        print(f"no policy crawled forwards without failing, in {folder}")
        return 0
    path = folder / "best.mp4"
    if video and not is_video_of(path, robot := TrainedRobot.load(folder)):
        cli.film(Recording(robot), path, console)
    print(f"best: {1000 * history.best.distance_m:.1f} mm in 30 s, in {folder}")
    return 0
