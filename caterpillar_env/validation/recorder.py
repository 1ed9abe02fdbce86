"""Record what a simulation asks of the engine, and repeat it on a bare one."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import mujoco
from mujoco.batch import Batch

from caterpillar_env.arrays import Array
from caterpillar_env.simulation import Simulation


class EngineCalls:
    """What a `Simulation` asks of the engine since its last reset, with its bodies and controls.

    Only the engine's work is repeated: no heating of springs, no judging, no observation.
    """

    def __init__(self, simulation: Simulation) -> None:
        self.models = list(simulation.models)
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
    batch = simulation.engine

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

    simulation.engine = Listener()
    try:
        yield recording
    finally:
        simulation.engine = batch
