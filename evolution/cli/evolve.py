"""`caterpillar evolve`."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from caterpillar_env.files import unused
from evolution import cli
from evolution.cli.running import Reporter, WorkerArgs, finish
from evolution.config import RunConfig
from evolution.optimizers.ga import GaConfig
from evolution.run.loop import evolve

PRESETS = {
    "paper": RunConfig(),
    "quick": RunConfig(generations=6, ga=GaConfig(population=20, hall_of_fame=2)),
}


@dataclass(frozen=True)
class EvolveArgs:
    """Evolve body and gait. Without options: the paper's run, 200 genomes for 50 generations."""

    preset: Literal["paper", "quick"] = "paper"
    """quick: 20 genomes for 6 generations, about a minute on two cores. Other flags change a preset."""
    out: Path | None = None
    """Run folder to make; by default a new one under runs/."""
    workers: WorkerArgs = field(default_factory=WorkerArgs)
    config: RunConfig = field(default_factory=RunConfig)


def evolve_command(argv: Sequence[str]) -> int:
    """Evolve body and gait: genetic algorithm, CMA-ES or random search."""
    args = cli.parse(EvolveArgs, argv, "evolve", EvolveArgs(config=PRESETS[_preset(argv)]))
    config = args.config
    folder = args.out or unused(Path("runs"), f"{config.optimizer}-{config.prior}-seed{config.seed}")
    console = cli.console()
    workers = args.workers
    with Reporter(config, console) as reporter, workers.following(reporter, folder) as told:
        result = evolve(
            config, folder, evaluator=workers.make(), on_generation=told, on_progress=reporter.progress,
        )  # fmt: skip
    return finish(result, config, folder, console, video=args.workers.video)


def _preset(argv: Sequence[str]) -> str:
    """The preset named in the arguments: it makes the defaults for all other flags."""
    for flag, value in itertools.pairwise([*argv, ""]):
        name = value if flag == "--preset" else flag.removeprefix("--preset=")
        if flag.startswith("--preset") and name in PRESETS:
            return name
    return "paper"
