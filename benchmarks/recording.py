"""What a simulation asks of the engine, recorded, and asked once more with nothing around it."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from caterpillar_env.simulation import Simulation

Array = NDArray[np.float64]


class Recording:
    """The rollouts of a `Simulation` since its last reset, with the bodies and controls of each.

    Only the physics steps are repeated: no heating of springs, no judging, no observation.
    """

    def __init__(self, simulation: Simulation) -> None:
        self.models = list(simulation._models)
        self.rollouts: list[tuple[int, Array, NDArray[np.intp]]] = []

    @property
    def steps(self) -> int:
        """Physics steps in all, over rows."""
        return sum(nstep * len(ids) for nstep, _, ids in self.rollouts)

    def batch(self, threads: int) -> Batch:
        """A fresh engine with the same bodies, at the start."""
        batch = Batch(self.models[0], len(self.models), threads)
        batch.set_models(self.models)
        batch.reset(stage=mujoco.mjtStage.mjSTAGE_NONE.value)
        return batch

    def repeat(self, batch: Batch) -> None:
        """The same rollouts, call by call."""
        for nstep, control, ids in self.rollouts:
            batch.rollout(nstep=nstep, control=control, record=(), ids=ids)

    def joined(self) -> Recording:
        """The same steps in as few calls as can be: one for every stretch with the same rows."""
        other = object.__new__(Recording)
        other.models, other.rollouts = self.models, []
        stretch: list[tuple[int, Array, NDArray[np.intp]]] = []
        for rollout in [*self.rollouts, None]:
            if stretch and (rollout is None or not np.array_equal(stretch[0][2], rollout[2])):
                control = np.concatenate([c for _, c, _ in stretch], axis=1)
                other.rollouts.append((control.shape[1], control, stretch[0][2]))
                stretch = []
            if rollout is not None:
                stretch.append(rollout)
        return other


@contextmanager
def recorded(simulation: Simulation) -> Iterator[Recording]:
    """Record what `simulation`, just reset, asks of the engine within the block."""
    recording = Recording(simulation)
    batch = simulation._batch

    class Listener:
        def __getattr__(self, name: str) -> Any:
            return getattr(batch, name)

        def rollout(self, *, nstep: int, control: Array, record: Any, ids: Any) -> Any:
            recording.rollouts.append((nstep, control.copy(), ids.copy()))
            return batch.rollout(nstep=nstep, control=control, record=record, ids=ids)

    simulation._batch = Listener()
    try:
        yield recording
    finally:
        simulation._batch = batch
