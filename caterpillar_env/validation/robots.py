"""Robots for the validation: random robots, robots with wave gaits, and stored evolved robots.

Evolution exploits simulator errors that random robots do not reveal. After a change of the physics,
evolve new robots with `python -m benchmarks.validation_robots`.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from caterpillar_env.arrays import Array
from caterpillar_env.gait import GAIT_PERIOD_S, GaitTimings
from caterpillar_env.model import joint_names
from caterpillar_env.morphology import PARAMETERS, Body, Morphology, segments_of
from caterpillar_env.physics import Physics
from caterpillar_env.robot import Robot, gait_power, repeat, stack
from caterpillar_env.task import Crawl

FILE = Path(__file__).with_name("evolved.json")


def random_robots(count: int, seed: int, physics: Physics) -> list[Robot]:
    """Return robots with uniformly random bodies and gaits."""
    size, times = len(PARAMETERS), physics.num_springs
    genomes = np.random.default_rng(seed).random((count, size + times))
    gaits = GaitTimings.from_action((2.0 * genomes[:, size:] - 1.0).astype(np.float32), GAIT_PERIOD_S)
    bodies = [Morphology.from_unit(genome[:size]) for genome in genomes]
    return _make_robots(bodies, gaits.on_s, gaits.off_s, physics)


def wave_robots(count: int, seed: int, physics: Physics) -> list[Robot]:
    """Return robots with random bodies and gaits that heat the springs in a wave from the tail."""
    rng = np.random.default_rng(seed)
    gaps = physics.num_segments - 1
    bodies = [Morphology.from_unit(rng.random(8)) for _ in range(count)]
    lag, offset = rng.uniform(-0.35, -0.15, (count, 1, 1)), rng.uniform(0.4, 0.6, (count, 1, 1))
    duty = rng.uniform(0.15, 0.25, (count, 1, 2))  # for dorsal and ventral pairs
    on = (lag * np.arange(gaps)[:, None] + offset * np.arange(2)) % 1.0
    off = (on + duty) % 1.0
    on_s, off_s = (GAIT_PERIOD_S * share.reshape(count, -1) for share in (on, off))
    return _make_robots(bodies, on_s, off_s, physics)


def _make_robots(bodies: list[Morphology], on_s: Array, off_s: Array, physics: Physics) -> list[Robot]:
    return [
        Robot(body, GaitTimings(GAIT_PERIOD_S, on, off), physics)
        for body, on, off in zip(bodies, on_s, off_s, strict=True)
    ]


def evolved_robots(count: int | None = None) -> list[Robot]:
    """Return the stored evolved robots, one per run, ordered by the seed of the run."""
    return [Robot.from_dict(data) for data in json.loads(FILE.read_text("utf-8"))[:count]]


def farthest_robots(count: int) -> list[Robot]:
    """Return the evolved robots with the highest fitness, in descending order."""
    return sorted(evolved_robots(), key=lambda r: -(r.fitness_m or 0.0))[:count]


def stack_power(robots: Sequence[Robot]) -> tuple[list[Body], Array]:
    """Return the bodies, and the power over one gait period, (R, steps, springs), see `Crawl.run`."""
    bodies, timings = stack(robots)
    return bodies, gait_power(timings, robots[0].physics)


def crawl_for(
    duration_s: float, bodies: Sequence[Body], power: Array, physics: Physics, *,
    heading_rad: float = 0.0, offset_m: float = 0.0, stop_on_failure: bool = True,
) -> Crawl:  # fmt: skip
    """Simulate robots for `duration_s`, repeating one period of power; see `start` and `repeat`."""
    crawl = start(
        bodies, physics, heading_rad=heading_rad, offset_m=offset_m, stop_on_failure=stop_on_failure
    )
    repeat(crawl, power, duration_s)
    return crawl


def start(
    bodies: Sequence[Body], physics: Physics, *,
    heading_rad: float = 0.0, offset_m: float = 0.0, stop_on_failure: bool = True,
) -> Crawl:  # fmt: skip
    """Create a `Crawl` of robots in their initial state.

    `offset_m` slightly changes the initial state to measure the sensitivity of the result. It is added
    to every axial joint. Hinges turn so that the centre of the element behind moves by the same length.
    """
    crawl = Crawl(bodies, physics, stop_on_failure=stop_on_failure)
    axial = np.array([n.startswith("axial") for n in joint_names(physics.num_segments)])
    # A hinge is halfway between two elements, a quarter of a segment from the centre of each.
    heads = [segments_of(body, physics.num_segments)[0] for body in bodies]
    arms_m = np.array([head.segment_length_m / 4 for head in heads])[:, None]
    offset = np.where(axial, offset_m, offset_m / arms_m)
    crawl.reset(heading_rad=heading_rad, offset=offset)
    return crawl
