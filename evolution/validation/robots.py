"""The robots that the validation is run on: random ones, and evolved ones, kept as data.

Evolution seeks out the faults of a simulator, random genomes do not. Each evolved robot is the best of a
run of its own at the default physics: the genetic algorithm and CMA-ES, with and without the prior. A
change of the physics calls for new ones: `python -m evolution.validation.robots FOLDER` evolves them
(half an hour on two cores) and resumes runs that it finds in FOLDER.
"""

from __future__ import annotations

import json
import sys
from concurrent.futures import ProcessPoolExecutor
from pathlib import Path

import numpy as np

from caterpillar_env.gait import GAIT_PERIOD_S, GaitTimings
from caterpillar_env.morphology import Body, Morphology
from caterpillar_env.physics import Physics
from evolution.config import OptimizerName, Prior, RunConfig
from evolution.evaluators import LocalEvaluator
from evolution.genome import Encoding
from evolution.individual import Individual
from evolution.optimizers.ga import GaConfig
from evolution.run import evolve, resume

FILE = Path(__file__).with_name("evolved.json")
SEEDS = 8  #: runs of each optimizer with each prior
BUDGET_S = 4000.0  #: simulated seconds of a run
_OPTIMIZERS: tuple[OptimizerName, ...] = ("ga", "cma-es")
_PRIORS: tuple[Prior, ...] = ("preprocessed", "uniform")
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


def random_individuals(count: int, seed: int, physics: Physics) -> list[Individual]:
    """Robots of uniformly random genomes, one by one."""
    encoding = Encoding(physics)
    drawn = np.random.default_rng(seed).random((count, len(encoding.genes)))
    return [Individual.of_genome(genome, encoding) for genome in drawn]


def random_robots(count: int, seed: int, physics: Physics) -> tuple[list[Body], GaitTimings]:
    """Bodies and gaits of uniformly random genomes."""
    return together(random_individuals(count, seed, physics))


def wave_robots(count: int, seed: int, physics: Physics) -> tuple[list[Body], GaitTimings]:
    """Robots that crawl without being evolved: random bodies, springs heated in a wave from the tail."""
    rng = np.random.default_rng(seed)
    gaps, period_s = physics.num_segments - 1, GAIT_PERIOD_S
    bodies: list[Body] = [Morphology.from_unit(rng.random(8)) for _ in range(count)]
    lag, offset = rng.uniform(-0.35, -0.15, (count, 1, 1)), rng.uniform(0.4, 0.6, (count, 1, 1))
    duty = rng.uniform(0.15, 0.25, (count, 1, 2))  # of the dorsal and the ventral pairs
    on = (lag * np.arange(gaps)[:, None] + offset * np.arange(2)) % 1.0
    off = (on + duty) % 1.0
    return bodies, GaitTimings(
        period_s, period_s * on.reshape(count, -1), period_s * off.reshape(count, -1)
    )


def evolved_robots(count: int = len(RUNS)) -> list[Individual]:
    """Evolved robots, one a run: those of the first seed first, then the second, ..."""
    return [Individual.from_dict(data) for data in json.loads(FILE.read_text("utf-8"))[:count]]


def farthest_robots(count: int) -> list[Individual]:
    """The evolved robots that crawl farthest, in that order."""
    return sorted(evolved_robots(), key=lambda r: -(r.fitness_m or 0.0))[:count]


def together(robots: list[Individual]) -> tuple[list[Body], GaitTimings]:
    """Bodies and gaits of robots that share one gait period, as `fitness.simulate` takes them."""
    on = np.stack([r.timings.on_s for r in robots])
    off = np.stack([r.timings.off_s for r in robots])
    return [r.morphology for r in robots], GaitTimings(robots[0].timings.period_s, on, off)


def make(folder: Path, path: Path = FILE) -> None:
    """Evolve the robots in run folders within `folder`; write them to `path`, ordered as `RUNS`."""
    names = [f"{config.optimizer}-{config.prior}-{config.seed}" for config in RUNS]
    with ProcessPoolExecutor() as pool:
        robots = list(pool.map(_evolved, RUNS, [folder / name for name in names]))
    path.write_text(json.dumps([r.to_dict() for r in robots], indent=1) + "\n", encoding="utf-8")


def _evolved(config: RunConfig, folder: Path) -> Individual:
    evaluator = LocalEvaluator(threads=1)
    if folder.exists():
        resume(folder, evaluator=evaluator)
    else:
        evolve(config, folder, evaluator=evaluator)
    robot = Individual.load(folder)
    print(folder.name, f"{1000 * (robot.fitness_m or 0):.0f} mm", file=sys.stderr, flush=True)
    return robot


if __name__ == "__main__":
    make(Path(sys.argv[1]))
