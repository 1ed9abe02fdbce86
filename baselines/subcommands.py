"""`caterpillar rl train` and `caterpillar rl eval`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated, Literal

import tyro
from rich.console import Console

from baselines.training import Point, TrainConfig, crawl, load, train
from evolution import cli
from evolution.commands import unused


@dataclass(frozen=True)
class TrainArgs:
    """Train a policy on one body."""

    out: Path | None = None
    """Folder to make; by default a new one under runs/."""
    config: TrainConfig = field(default_factory=TrainConfig)


def train_command(argv: Sequence[str]) -> int:
    """`caterpillar rl train`."""
    args = cli.parse(TrainArgs, argv, "rl train", TrainArgs())
    config = args.config
    folder = args.out or unused(Path("runs"), f"{config.algorithm}-{config.mode}-seed{config.seed}")
    console = Console(stderr=True, markup=False, highlight=False)

    def told(point: Point) -> None:
        share = min(point.simulated_s / config.budget_s, 1.0)
        console.print(
            f"{100 * share:3.0f} %  simulated {point.simulated_s:,.0f} s  deterministic policy: "
            f"{1000 * point.distance_m:.1f} mm ({point.failure})",
            soft_wrap=True,
        )

    result = train(config, folder, told)
    if not result.finished:
        console.print(f"stopped; the policies so far are in {folder}", soft_wrap=True)
        return 130
    if result.best is None:
        print(f"no policy kept its robot from failing, in {folder}")
    else:
        print(f"best: {1000 * result.best.distance_m:.1f} mm in 30 s, in {folder}")
    return 0


@dataclass(frozen=True)
class EvalArgs:
    """Let a trained policy crawl once, deterministically."""

    folder: Annotated[Path, tyro.conf.Positional]
    """A training's folder."""
    which: Literal["best", "last"] = "best"
    """Which of the policies that were kept."""


def eval_command(argv: Sequence[str]) -> int:
    """`caterpillar rl eval`."""
    args = cli.parse(EvalArgs, argv, "rl eval")
    config, model, normalizer = load(args.folder, args.which)
    judge = config.environment(1)
    judge.seed(config.seed)
    final = crawl(model, judge, normalizer)
    judge.close()
    print(
        f"{1000 * final['distance']:.1f} mm in {final['time_s']:.1f} s ({final['failure']}), "
        f"{final['energy_j']:.1f} J"
    )
    return 0
