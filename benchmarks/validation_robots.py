"""Evolve the robots of the validation: `python -m benchmarks.validation_robots FOLDER`.

Run this after a change of the physics. It takes half an hour on two cores and resumes runs in FOLDER.
Each robot is the best of its own run: genetic algorithm or CMA-ES, with or without the prior.
"""

from __future__ import annotations

import json
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

from caterpillar_env.robot import Robot
from caterpillar_env.validation.robots import FILE
from evolution.config import OptimizerName, RunConfig
from evolution.optimizers.ga import GaConfig
from evolution.priors import Prior
from evolution.run.evaluators import LocalEvaluator
from evolution.run.loop import evolve, resume

SEEDS = 8  #: number of runs for each optimizer and prior
BUDGET_S = 4000.0  #: simulated seconds of a run
_OPTIMIZERS: tuple[OptimizerName, ...] = ("ga", "cma-es")
_PRIORS: tuple[Prior, ...] = ("body", "uniform")
#: Configuration of the run behind each evolved robot.
RUNS: tuple[RunConfig, ...] = tuple(
    RunConfig(
        seed=seed, generations=10_000, budget_s=BUDGET_S, optimizer=optimizer, prior=prior,
        ga=GaConfig(population=30, hall_of_fame=4, elites_breed=False),
    )
    for seed in range(SEEDS)
    for optimizer in _OPTIMIZERS
    for prior in _PRIORS
)  # fmt: skip


def make(folder: Path, path: Path = FILE) -> None:
    """Evolve a robot for each of `RUNS` in `folder` and write them to `path` in that order."""
    names = [f"{config.optimizer}-{config.prior}-{config.seed}" for config in RUNS]
    with ProcessPoolExecutor() as pool:
        robots = list(pool.map(_evolve_robot, RUNS, [folder / name for name in names]))
    path.write_text(json.dumps([r.to_dict() for r in robots], indent=1) + "\n", encoding="utf-8")


def _evolve_robot(config: RunConfig, folder: Path) -> Robot:
    evaluator = LocalEvaluator(threads=1)
    if folder.exists():
        resume(folder, evaluator=evaluator)
    else:
        evolve(config, folder, evaluator=evaluator)
    robot = Robot.load(folder)
    print(folder.name, f"{1000 * (robot.fitness_m or 0):.0f} mm", file=sys.stderr, flush=True)
    return robot


if __name__ == "__main__":
    make(Path(sys.argv[1]))
