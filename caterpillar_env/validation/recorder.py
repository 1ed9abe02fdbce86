"""Record the engine calls of a simulation and repeat them on a different engine."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import mujoco
from mujoco.batch import Batch

from caterpillar_env.arrays import Array
from caterpillar_env.simulation import Simulation


class EngineCalls:
    """Engine calls of a `Simulation` since its last reset.

    Repeating them measures the engine alone, without spring model, failure checks and observations.
    """

    def __init__(self, simulation: Simulation) -> None:
        self.models = list(simulation.models)
        self.calls: list[tuple[str, dict[str, Any]]] = []  #: method names and arguments

    @property
    def steps(self) -> int:
        """Number of physics steps, summed over rows."""
        return sum(call["nstep"] * len(call["ids"]) for name, call in self.calls if name == "rollout")

    def make_batch(self, threads: int) -> Batch:
        """Return a new engine with the same models, in its initial state."""
        batch = Batch(self.models[0], len(self.models), threads)
        batch.set_models(self.models)
        batch.reset(stage=mujoco.mjtStage.mjSTAGE_NONE.value)
        return batch

    def repeat(self, batch: Batch, first: int = 0, last: int | None = None) -> None:
        """Repeat calls `first` to `last` (exclusive) on an engine that has made all previous calls."""
        for name, call in self.calls[first:last]:
            getattr(batch, name)(**call)


@contextmanager
def record_calls(simulation: Simulation) -> Iterator[EngineCalls]:
    """Record the engine calls made within the block. Reset the simulation just before entering it."""
    recording, batch = EngineCalls(simulation), simulation.engine

    class Recorder:
        def __getattr__(self, name: str) -> Any:
            return getattr(batch, name)

        def rollout(self, *, nstep: int, control: Array, record: Any, ids: Any) -> Any:
            call = {"nstep": nstep, "control": control.copy(), "record": (), "ids": ids.copy()}
            recording.calls.append(("rollout", call))
            return batch.rollout(nstep=nstep, control=control, record=record, ids=ids)

        def reset(self, ids: Any, *, stage: int) -> None:
            recording.calls.append(("reset", {"ids": ids.copy(), "stage": stage}))
            batch.reset(ids, stage=stage)

    simulation.engine = Recorder()
    try:
        yield recording
    finally:
        simulation.engine = batch
