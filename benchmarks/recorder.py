"""Record the engine calls of a simulation and repeat them on a different engine."""

from __future__ import annotations

from copy import deepcopy
from dataclasses import dataclass
from typing import Any

import mujoco
from mujoco.batch import Batch

from benchmarks.harness import Step
from caterpillar_env.arrays import Array
from caterpillar_env.simulation import Simulation


@dataclass(frozen=True)
class EngineCalls:
    """Engine calls of a `Simulation` since its last reset.

    Repeating them measures the engine alone, without spring model, failure checks and observations.
    """

    models: list[mujoco.MjModel]  #: model of each row
    calls: list[list[tuple[str, dict[str, Any]]]]  #: method names and arguments in each step

    @property
    def physics_steps(self) -> int:
        """Number of physics steps, summed over rows."""
        rollouts = (call for step in self.calls for name, call in step if name == "rollout")
        return sum(call["nstep"] * len(call["control"]) for call in rollouts)

    def make_batch(self, threads: int) -> Batch:
        """Return a new engine with the same models, in its initial state."""
        batch = Batch(self.models[0], len(self.models), threads)
        batch.set_models(self.models)
        batch.reset(stage=mujoco.mjtStage.mjSTAGE_NONE.value)
        return batch

    def repeat(self, batch: Batch, number: int) -> None:
        """Repeat the calls of a step on an engine that has made all previous calls."""
        for name, call in self.calls[number]:
            getattr(batch, name)(**call)

    def begin(self, threads: int) -> Step:
        """Return a function that repeats the calls of step i on a new engine."""
        batch = self.make_batch(threads)
        return lambda number: self.repeat(batch, number)


def record_calls(simulation: Simulation, step: Step, steps: int) -> EngineCalls:
    """Record the engine calls that `step` makes. The caller resets the simulation just before."""
    recorded, engine = EngineCalls(list(simulation.models), []), simulation.engine

    class Recorder:
        def __getattr__(self, name: str) -> Any:
            return getattr(engine, name)

        def rollout(self, *, nstep: int, control: Array, record: Any, ids: Any) -> Any:
            call = {"nstep": nstep, "control": control, "record": (), "ids": ids}
            recorded.calls[-1].append(("rollout", deepcopy(call)))
            return engine.rollout(nstep=nstep, control=control, record=record, ids=ids)

        def reset(self, ids: Any, *, stage: int) -> None:
            recorded.calls[-1].append(("reset", {"ids": ids.copy(), "stage": stage}))
            engine.reset(ids, stage=stage)

    simulation.engine = Recorder()
    for number in range(steps):
        recorded.calls.append([])
        step(number)
    simulation.engine = engine
    return recorded
