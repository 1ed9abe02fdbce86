"""The robots that the validation is run on: random ones, and evolved ones, kept as data.

Evolution seeks out the faults of a simulator, random genomes do not. The evolved ones are the best of
short runs of the genetic algorithm at the default physics; `python -m evolution.validation.robots` makes
them anew (about ten minutes on two cores), which a change of the physics calls for.
"""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path

import numpy as np

from caterpillar_env.gait import GaitTimings
from caterpillar_env.morphology import Body
from caterpillar_env.physics import Physics
from caterpillar_env.task import Failure
from evolution.config import Prior, RunConfig
from evolution.genome import Encoding
from evolution.individual import Individual
from evolution.journal import Journal
from evolution.optimizers.ga import GaConfig
from evolution.run import evolve

FILE = Path(__file__).with_name("evolved.json")
RUNS: tuple[tuple[Prior, int], ...] = tuple(
    (prior, seed) for prior in ("preprocessed", "uniform") for seed in range(5)
)
TOP = 5  #: robots kept of each run


def random_individuals(count: int, seed: int, physics: Physics) -> list[Individual]:
    """Robots of uniformly random genomes, one by one."""
    encoding = Encoding(physics)
    drawn = np.random.default_rng(seed).random((count, len(encoding.genes)))
    return [Individual.of_genome(genome, encoding) for genome in drawn]


def random_robots(count: int, seed: int, physics: Physics) -> tuple[list[Body], GaitTimings]:
    """Bodies and gaits of uniformly random genomes."""
    return together(random_individuals(count, seed, physics))


def evolved_robots(count: int = TOP * len(RUNS)) -> list[Individual]:
    """Evolved robots, the best of each run first."""
    return [Individual.from_dict(data) for data in json.loads(FILE.read_text("utf-8"))[:count]]


def together(robots: list[Individual]) -> tuple[list[Body], GaitTimings]:
    """Bodies and gaits of robots that share one gait period, as `fitness.simulate` takes them."""
    on = np.stack([r.timings.on_s for r in robots])
    off = np.stack([r.timings.off_s for r in robots])
    return [r.morphology for r in robots], GaitTimings(robots[0].timings.period_s, on, off)


def make(path: Path = FILE) -> None:
    """Evolve them anew and write `path`, best robots of all runs first, then the second best, ..."""
    ranked: list[list[Individual]] = []
    for prior, seed in RUNS:
        config = RunConfig(
            seed=seed,
            generations=10,
            prior=prior,
            ga=GaConfig(population=30, hall_of_fame=4),
        )
        with tempfile.TemporaryDirectory() as folder:
            evolve(config, Path(folder) / "run")
            ranked.append(best_of(Path(folder) / "run", config, TOP))
        print(prior, seed, [f"{1000 * (r.fitness_m or 0):.0f}" for r in ranked[-1]], file=sys.stderr)
    robots = [ranks[place] for place in range(TOP) for ranks in ranked]
    path.write_text(json.dumps([r.to_dict() for r in robots], indent=1) + "\n", encoding="utf-8")


def best_of(folder: Path, config: RunConfig, count: int) -> list[Individual]:
    """The `count` best robots of a run."""
    with Journal(folder) as journal:
        healthy = [e for e in journal.evaluations() if e.failure is Failure.NONE]
    return [
        Individual.of_genome(e.genome, config.encoding, fitness_m=e.distance_m, generation=e.generation)
        for e in sorted(healthy, key=lambda e: -e.distance_m)[:count]
    ]


if __name__ == "__main__":
    make()
