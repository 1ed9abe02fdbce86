"""`caterpillar evolve`."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

from caterpillar_env.files import unused
from evolution import cli
from evolution.cli.running import Reporter, WorkerArgs, finish
from evolution.config import RunConfig
from evolution.optimizers.shade import ShadeConfig
from evolution.run.loop import evolve

PRESETS = {
    "paper": RunConfig(),
    "quick": RunConfig(
        generations=4,
        optimizer="shade",
        timing="wave",
        prior="body+gait",
        race_share=0.34,
        shade=ShadeConfig(shade_population=15, shade_candidates=10),
    ),
}


@dataclass(frozen=True)
class EvolveArgs:
    """Evolve body and gait. The defaults are those of the paper: 200 genomes, 50 generations."""

    preset: Literal["paper", "quick"] = "paper"
    """Defaults of the other options. quick: one minute of SHADE with waves, priors and racing."""
    out: Path | None = None
    """Run folder to create; by default, a new folder under runs/."""
    workers: WorkerArgs = field(default_factory=WorkerArgs)
    config: RunConfig = field(default_factory=RunConfig)


def evolve_command(argv: Sequence[str]) -> int:
    """Evolve body and gait: genetic algorithm, SHADE, CMA-ES or random search."""
    preset = argparse.ArgumentParser("caterpillar evolve", add_help=False, allow_abbrev=False)
    preset.add_argument("--preset", default="paper")
    name = preset.parse_known_args(argv)[0].preset
    defaults = EvolveArgs(config=PRESETS.get(name, PRESETS["paper"]))  # `parse` rejects other names
    args = cli.parse(EvolveArgs, argv, "evolve", defaults)
    config, workers, console = args.config, args.workers, cli.console()
    name = f"{config.optimizer}-{config.prior.replace('+', '-')}-seed{config.seed}"
    folder = args.out or unused(Path("runs"), name)
    with Reporter(config, console) as reporter:
        history = evolve(
            config, folder, evaluator=workers.make_evaluator(), on_generation=reporter.generation,
            on_progress=reporter.progress,
        )  # fmt: skip
    return finish(history, console, video=workers.video)
