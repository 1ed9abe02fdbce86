"""How fast robots are simulated here, beside the bare engine that makes the very same steps."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, NamedTuple

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from caterpillar_env.physics import SMA_STEP_S, Physics
from caterpillar_env.simulation import Simulation
from caterpillar_env.task import EPISODE_S, STEPS_PER_INTERVAL, Crawl
from evolution.evaluators import CHUNK
from evolution.validation.robots import random_robots

Array = NDArray[np.float64]


class EngineCalls:
    """What a `Simulation` asks of the engine since its last reset, with its bodies and controls.

    Only the engine's work is repeated: no heating of springs, no judging, no observation.
    """

    def __init__(self, simulation: Simulation) -> None:
        self.models = list(simulation._models)
        self.calls: list[tuple[str, dict[str, Any]]] = []

    @property
    def steps(self) -> int:
        """Physics steps in all, over rows."""
        return sum(call["nstep"] * len(call["ids"]) for name, call in self.calls if name == "rollout")

    def batch(self, threads: int) -> Batch:
        """A fresh engine with the same bodies, at the start."""
        batch = Batch(self.models[0], len(self.models), threads)
        batch.set_models(self.models)
        batch.reset(stage=mujoco.mjtStage.mjSTAGE_NONE.value)
        return batch

    def repeat(self, batch: Batch, first: int = 0, last: int | None = None) -> None:
        """The calls from number `first` to before `last`, to an engine that has made those before."""
        for name, call in self.calls[first:last]:
            getattr(batch, name)(**call)


@contextmanager
def recorded(simulation: Simulation) -> Iterator[EngineCalls]:
    """Record what `simulation`, just reset, asks of the engine within the block."""
    recording = EngineCalls(simulation)
    batch = simulation._batch

    class Listener:
        def __getattr__(self, name: str) -> Any:
            return getattr(batch, name)

        def rollout(self, *, nstep: int, control: Array, record: Any, ids: Any) -> Any:
            call = {"nstep": nstep, "control": control.copy(), "record": (), "ids": ids.copy()}
            recording.calls.append(("rollout", call))
            return batch.rollout(nstep=nstep, control=control, record=record, ids=ids)

        def reset(self, ids: Any, *, stage: int) -> None:
            recording.calls.append(("reset", {"ids": ids.copy(), "stage": stage}))
            batch.reset(ids, stage=stage)

    simulation._batch = Listener()
    try:
        yield recording
    finally:
        simulation._batch = batch


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
    crawl = Crawl(robots, Physics(), threads)
    started = time.perf_counter()
    crawl.reset(bodies)
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
