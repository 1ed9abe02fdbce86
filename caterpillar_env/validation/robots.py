"""The robots that the validation runs on: random ones, and evolved ones, kept as data.

Evolution finds the faults of a simulator; random genomes do not. `python -m
benchmarks.validation_robots` evolves new robots after a change of the physics.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from caterpillar_env.gait import GAIT_PERIOD_S, GaitTimings
from caterpillar_env.morphology import PARAMETERS, Body, Morphology
from caterpillar_env.physics import Physics
from caterpillar_env.robot import Robot

FILE = Path(__file__).with_name("evolved.json")


def random_individuals(count: int, seed: int, physics: Physics) -> list[Robot]:
    """Robots of uniformly random genomes, one by one."""
    size, times = len(PARAMETERS), physics.num_springs
    genomes = np.random.default_rng(seed).random((count, size + times))
    gaits = GaitTimings.from_action((2.0 * genomes[:, size:] - 1.0).astype(np.float32), GAIT_PERIOD_S)
    return [
        Robot(Morphology.from_unit(genome[:size]), GaitTimings(GAIT_PERIOD_S, on, off), physics)
        for genome, on, off in zip(genomes, gaits.on_s, gaits.off_s, strict=True)
    ]


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


def evolved_robots(count: int | None = None) -> list[Robot]:
    """Evolved robots, one a run: those of the first seed first, then the second, ..."""
    return [Robot.from_dict(data) for data in json.loads(FILE.read_text("utf-8"))[:count]]


def farthest_robots(count: int) -> list[Robot]:
    """The evolved robots that crawl farthest, in that order."""
    return sorted(evolved_robots(), key=lambda r: -(r.fitness_m or 0.0))[:count]


def together(robots: list[Robot]) -> tuple[list[Body], GaitTimings]:
    """Bodies and gaits of robots that share one gait period, as `fitness.simulate` takes them."""
    on = np.stack([r.timings.on_s for r in robots])
    off = np.stack([r.timings.off_s for r in robots])
    return [r.morphology for r in robots], GaitTimings(robots[0].timings.period_s, on, off)
