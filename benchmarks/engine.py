"""How fast robots are simulated here, beside the bare engine that makes the very same steps."""

from __future__ import annotations

import time
from typing import NamedTuple

from caterpillar_env.physics import SMA_STEP_S, Physics
from caterpillar_env.task import EPISODE_S, STEPS_PER_INTERVAL, Crawl
from caterpillar_env.validation.recorder import recorded
from caterpillar_env.validation.robots import random_robots
from evolution.run.evaluators import CHUNK


class Speed(NamedTuple):
    """What a trial showed."""

    robots: int
    simulated_s: float  #: really stepped, over all robots
    build_s: float  #: wall time to build the robots
    crawl_s: float  #: wall time to simulate them
    engine_s: float  #: of the bare engine, for the same steps
    threads: int

    @property
    def simulated_s_per_s(self) -> float:
        """Simulated seconds in a second, once the robots are built."""
        return self.simulated_s / self.crawl_s

    @property
    def share_of_limit(self) -> float:
        """Our speed over the bare engine's."""
        return self.engine_s / self.crawl_s

    def run_s(self, evaluations: int) -> float:
        """Wall time of a run of so many evaluations in which no robot fails, s."""
        return evaluations * (self.build_s / self.robots + EPISODE_S / self.simulated_s_per_s)


def measure(robots: int = CHUNK, limit_s: float = 8.0, threads: int = 0) -> Speed:
    """Let random robots crawl for 30 s, or until the time is up.

    After every control interval the bare engine makes its steps too, so that a slow spell of the machine
    falls on both.

    Args:
        robots: side by side.
        limit_s: wall time after which no further interval is begun, of ours and the engine together.
        threads: 0 means all cores.
    """
    bodies, timings = random_robots(robots, 0, Physics())
    power = timings.mirrored().power(SMA_STEP_S)
    started = time.perf_counter()
    crawl = Crawl(bodies, Physics(), threads)
    built = time.perf_counter()
    engine_s, done = 0.0, 0
    with recorded(crawl.simulation) as asked:
        batch = asked.batch(threads)
        begun = time.perf_counter()
        for number in range(round(EPISODE_S / SMA_STEP_S) // STEPS_PER_INTERVAL):
            first = number * STEPS_PER_INTERVAL % power.shape[1]
            crawl.run(power[:, first : first + STEPS_PER_INTERVAL])
            before = time.perf_counter()
            asked.repeat(batch, done)
            engine_s += time.perf_counter() - before
            done = len(asked.calls)
            if time.perf_counter() - started >= limit_s:
                break
        total_s = time.perf_counter() - begun
    simulated_s = float(crawl.progress().time_s.sum())
    return Speed(robots, simulated_s, built - started, total_s - engine_s, engine_s, batch.nthread)
