"""Fitness: how far a genome's robot crawls in 30 s (Saunders 2009, section IV)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from caterpillar_env.gait import GaitTimings, whole
from caterpillar_env.morphology import Body
from caterpillar_env.physics import CONTROL_INTERVAL_S, SMA_STEP_S, Physics
from caterpillar_env.simulation import Trace
from caterpillar_env.task import EPISODE_S, STEPS_PER_INTERVAL, Crawl, Failure, Progress
from evolution.genome import Encoding

Array = NDArray[np.float64]
_CHUNK_STEPS = 10 * STEPS_PER_INTERVAL


class Outcomes(NamedTuple):
    """What became of P genomes. A failure is a status, not a number."""

    failure: NDArray[np.int8]  #: values of `Failure`, (P,)
    distance_m: Array  #: until the end or the failure, finite, (P,)
    energy_j: Array  #: electrical, (P,)
    simulated_s: Array  #: really stepped, (P,)

    @classmethod
    def of(cls, end: Progress) -> Outcomes:
        """What became of robots that have come to their end."""
        # Of a robot that went nowhere finite no distance can be told; its status says why.
        distance_m = np.where(np.isfinite(end.distance_m), end.distance_m, 0.0)
        return cls(end.failure, distance_m, end.energy_j, end.time_s)

    def fitness(self, failed_fitness: float = 0.0) -> Array:
        """Distance in m, not below 0; `failed_fitness` for a failure, (P,)."""
        ok = self.failure == Failure.NONE
        return np.where(ok, np.maximum(self.distance_m, 0.0), failed_fitness)


def evaluate(
    genomes: Array,
    encoding: Encoding,
    *,
    threads: int = 0,
    duration_s: float = EPISODE_S,
    on_progress: Callable[[float], None] | None = None,
) -> Outcomes:
    """Let the robots of P genomes crawl side by side, each until it fails.

    Args:
        genomes: in [0, 1], shape (P, n).
        encoding: what they stand for; the gait period a whole number of control intervals.
        threads: 0 means all cores; results do not depend on it.
        duration_s: how long each crawls.
        on_progress: told the share that is done.
    """
    intervals = 0

    def tick(_: object) -> None:
        nonlocal intervals
        intervals += 1
        if on_progress is not None:
            on_progress(intervals * CONTROL_INTERVAL_S / duration_s)

    bodies, timings = encoding.decode(genomes)
    return simulate(
        bodies, timings, encoding.physics, threads=threads, duration_s=duration_s, on_interval=tick
    )


def simulate(
    bodies: Sequence[Body],
    timings: GaitTimings,
    physics: Physics,
    *,
    threads: int = 0,
    duration_s: float = EPISODE_S,
    on_interval: Callable[[Trace | None], None] | None = None,
    trace: bool = False,
) -> Outcomes:
    """Let P robots crawl side by side, each until it fails.

    Args:
        bodies: P of them.
        timings: of their springs or mirrored pairs, arrays of shape (P, springs) or (P, pairs).
        physics: material, numerics, number of segments.
        threads: 0 means all cores; results do not depend on it.
        duration_s: how long each crawls.
        on_interval: called after each control interval, see `Crawl.run`.
        trace: whether to trace what is needed to draw.
    """
    whole(timings.period_s, CONTROL_INTERVAL_S, "the gait period")
    steps = whole(duration_s, CONTROL_INTERVAL_S, "the duration") * STEPS_PER_INTERVAL
    power = timings.of_springs(physics.num_springs).power(SMA_STEP_S)
    crawl = Crawl(len(bodies), physics, threads)
    crawl.reset(bodies)
    # Some intervals at a time, so that no array of the whole 30 s is made.
    first = 0
    while first < steps:
        phase = first % power.shape[1]
        part = power[:, phase : phase + min(_CHUNK_STEPS, steps - first)]
        crawl.run(part, on_interval=on_interval, trace=trace)
        first += part.shape[1]
    return Outcomes.of(crawl.progress())
