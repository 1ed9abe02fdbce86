"""Simulation of robots with the same topology and different bodies, with MuJoCo's `Batch`.

Apart from checks in `caterpillar_env.validation`, no other module steps the physics. A single
environment is a batch of one. The vector environment and the fitness evaluation use larger batches.
The trajectory of a robot is bitwise identical in all of them, for any number of threads.
"""

from __future__ import annotations

import os
from collections.abc import Sequence
from functools import lru_cache
from typing import Any

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from caterpillar_env.arrays import Array, Rows, select
from caterpillar_env.errors import CaterpillarError, check_number
from caterpillar_env.gait import count_steps
from caterpillar_env.ground import LOADS, STANCE_M, clearances_m, half_axes_m, touching_geoms
from caterpillar_env.heating import Heating, heat
from caterpillar_env.machine import MAX_THREADS, cores
from caterpillar_env.model import ELEMENTS_PER_SEGMENT, ModelBuilder
from caterpillar_env.morphology import Body
from caterpillar_env.physics import SMA_STEP_S, Physics
from caterpillar_env.pose import (
    BodyState,
    Pose,
    SimulationState,
    Trace,
    find_diverged,
    mean_axes,
    mean_velocity,
)
from caterpillar_env.randomization import Conditions, apply_conditions
from caterpillar_env.sma import SmaState

_CACHED_BODIES = 256
_POSITIONS_AND_VELOCITIES = mujoco.mjtStage.mjSTAGE_VEL.value
FREE_QPOS, FREE_QVEL = 7, 6  # sizes of the head's free joint; the internal joints follow


class Simulation:
    """Simulate robots with common physics and individual bodies, starting from the initial state.

    Args:
        bodies: bodies of B robots. The index of a robot is its row.
        physics: material, numerics and number of segments.
        threads: number of threads; 0 means `machine.cores()`. The results do not depend on it.

    Attributes:
        bodies: body of each row. Only `reset` changes it.
        conditions: conditions of each row; None means those of `physics`.
        models: compiled model of each row, without scenery.
        energy_j: electrical energy of each row since its reset, J, (B,).
        simulated_s: time simulated so far, summed over the rows, s.

    Raises:
        CaterpillarError: there are no bodies, the number of threads is negative, or the number of
            segments of a body differs from that of `physics`.
    """

    def __init__(self, bodies: Sequence[Body], physics: Physics, threads: int = 0) -> None:
        check_number("threads", threads, 0, MAX_THREADS, whole=True)
        if not len(bodies):
            raise CaterpillarError("a simulation needs at least one body; got none")
        size, springs = len(bodies), physics.num_springs
        self.physics, self.simulated_s = physics, 0.0
        self._substeps = count_steps(SMA_STEP_S, physics.timestep_s, "the thermal step")
        # Cache models, because bodies recur (elites, vector environments with one body).
        self._build = lru_cache(_CACHED_BODIES)(ModelBuilder(physics, scenery=False).build)
        self.bodies = list(bodies)
        self.conditions: list[Conditions | None] = [None] * size
        self.models = [self._build(body) for body in bodies]
        self._process = os.getpid()
        self.engine = Batch(self.models[0], size, threads or cores())
        self.engine.set_models(self.models)
        bind = self.engine.bind
        self._qpos, self._qvel = bind("qpos"), bind("qvel")
        self._warmstart, self._time = bind("qacc_warmstart"), bind("time")
        self._xpos, self._xmat = bind("xpos"), bind("xmat")
        self._com, self._cvel = bind("subtree_com"), bind("cvel")
        self._geom_xpos, self._geom_xmat = bind("geom_xpos"), bind("geom_xmat")
        touching = touching_geoms(self.models[0])
        self._touching = slice(touching[0], touching[-1] + 1)  # no other geoms lie in between
        self._half_axes = np.stack([half_axes_m(model) for model in self.models])
        self._elements = 1, 1 + physics.num_segments * ELEMENTS_PER_SEGMENT  # first body, last + 1
        self._axes, self._clearance_m = np.zeros((size, 9)), np.zeros(size)  # see `Pose`
        self._ambient_c = np.full((size, 1), physics.spring.ambient_c)
        self._sma = SmaState.cold(physics.spring, (size, springs))
        self._steps = np.zeros(size, dtype=np.int64)  # thermal steps since reset
        self.energy_j = np.zeros(size)
        self._load_n = np.zeros((size, 2))  # on feet and skin, mean of the last `advance`
        self.reset()

    @property
    def engine(self) -> Batch:
        """The MuJoCo `Batch` that steps the rows. A wrapper that records calls may replace it.

        Raises:
            CaterpillarError: this process is a fork, which does not have the threads of the batch.
        """
        if os.getpid() != self._process and self._engine.nthread > 1:
            raise CaterpillarError(
                "a forked process has no threads of this simulation; create the environment in that "
                'process, use threads=1, or use the start method "spawn"'
            )
        return self._engine

    @engine.setter
    def engine(self, engine: Batch) -> None:
        self._engine = engine

    def reset(
        self,
        bodies: Sequence[Body] | None = None,
        rows: Rows | None = None,
        *,
        conditions: Sequence[Conditions | None] | None = None,
    ) -> None:
        """Reset robots to the initial state: straight along x, at rest and with cold springs.

        Args:
            bodies: new body of each of these robots. By default, bodies do not change.
            rows: indices of the robots to reset, (R,); all by default.
            conditions: conditions of each of these robots; None means those of `physics`.

        Raises:
            CaterpillarError: the number of bodies differs from the number of rows.
        """
        index = self.indices(rows)
        if bodies is None:
            bodies = [self.bodies[row] for row in index]
        if len(bodies) != len(index):
            raise CaterpillarError(
                f"bodies must have one entry for each of {len(index)} robots; got {len(bodies)}"
            )
        used = [None] * len(index) if conditions is None else conditions
        changed = False
        for row, body, condition in zip(index.tolist(), bodies, used, strict=True):
            if self.bodies[row] != body or self.conditions[row] != condition:
                self._change(row, body, condition)
                changed = True
        if changed:
            self.engine.set_models(self.models)
        self.engine.reset(index, stage=mujoco.mjtStage.mjSTAGE_NONE.value)
        shape = (len(index), self.physics.num_springs)
        cold = SmaState.cold(self.physics.spring, shape, self._ambient_c[index])
        self._sma.enthalpy_j_kg[index], self._sma.fraction[index] = cold
        self._steps[index] = 0
        self.energy_j[index] = 0.0
        self._load_n[index] = 0.0
        self._refresh(index, standing=not self.physics.world.level)

    def _change(self, row: int, body: Body, condition: Conditions | None) -> None:
        model, ambient_c = self._build(body), self.physics.spring.ambient_c
        if condition is not None:
            model = apply_conditions(model, self.physics, condition)
            ambient_c = condition.ambient_c
        self.bodies[row], self.conditions[row], self.models[row] = body, condition, model
        self._ambient_c[row], self._half_axes[row] = ambient_c, half_axes_m(model)

    def place(
        self,
        qpos: Array,
        rows: Rows | None = None,
        *,
        qvel: Array | float = 0.0,
        standing: bool = False,
    ) -> None:
        """Move robots to given poses. Springs and time do not change.

        Args:
            qpos: MuJoCo generalized positions, (R, nq): position and unit quaternion of the head, then
                the internal joints (`model.joint_names`).
            rows: indices of the robots to move, (R,); all by default.
            qvel: MuJoCo generalized velocities, (R, nv); 0 by default.
            standing: whether to put each robot on the ground; always done on uneven ground.

        Raises:
            CaterpillarError: `qpos` has the wrong shape.
        """
        index = self.indices(rows)
        expected = (len(index), self._qpos.shape[1])
        if qpos.shape != expected:
            raise CaterpillarError(f"qpos must have shape {expected}; got {qpos.shape}")
        self._qpos[index], self._qvel[index] = qpos, qvel
        self._refresh(index, standing=standing or not self.physics.world.level)

    def get_state(self, rows: Rows | None = None) -> SimulationState:
        """Return the state of robots as new arrays, from which their motion can be repeated exactly."""
        index = self.indices(rows)
        return SimulationState(*(field[index] for field in self._state_fields()))

    def set_state(self, state: SimulationState, rows: Rows | None = None) -> None:
        """Set the state of robots. Bodies and conditions must be the same as in `get_state`.

        Args:
            state: state of R robots.
            rows: indices of the robots to change, (R,); all by default.
        """
        index = self.indices(rows)
        self.engine.reset(index, stage=mujoco.mjtStage.mjSTAGE_NONE.value)  # clears warnings
        for field, value in zip(self._state_fields(), state, strict=True):
            field[index] = value
        self._refresh(index)

    def _state_fields(self) -> tuple[NDArray[Any], ...]:
        """Return the arrays of `SimulationState` for all rows."""
        engine = (self._qpos, self._qvel, self._time, self._warmstart)
        return (*engine, *self._sma, self._steps, self.energy_j, self._load_n)

    def heat(self, power: Array, rows: Rows | None = None) -> Heating:
        """Compute the thermal states of springs for the next K thermal steps. The robots do not move.

        Pass the result to `advance`. Temperatures do not depend on the motion, and one call for many
        steps is faster than many calls.

        Args:
            power: share of the drive power in each thermal step, in [0, 1], (R, K, num_springs).
            rows: indices of the robots to heat, (R,); all by default.

        Raises:
            CaterpillarError: `power` has the wrong shape.
        """
        index = self.indices(rows)
        if power.ndim != 3 or power[:, 0].shape != (len(index), self.physics.num_springs):
            raise CaterpillarError(
                f"power must have shape ({len(index)}, steps, {self.physics.num_springs}); "
                f"got {power.shape}"
            )
        before, air_c = self._sma.rows(index), self._ambient_c[index]
        return heat(self.physics.spring, before, power, air_c, index, self._substeps)

    def advance(
        self,
        heating: Heating,
        active: Rows | None = None,
        first: int = 0,
        last: int | None = None,
        *,
        trace: bool = False,
    ) -> Trace | None:
        """Advance robots by the thermal steps `first` to `last - 1` of `heating`.

        Args:
            heating: return value of `heat`.
            active: indices into `heating.rows` of the robots to advance, ascending; all by default.
            first: first step. It must be 0 or the `last` of the previous call.
            last: index after the last step; all steps by default.
            trace: whether to record and return a trace of the steps.
        """
        path, energy_j = heating.springs.path, heating.energy_j
        last = len(energy_j) if last is None else last
        control = heating.control[:, first * self._substeps : last * self._substeps]
        index: Rows = heating.rows
        chosen: Rows | slice = slice(None)  # a slice makes no copies
        if active is not None and len(active) < len(index):
            index, chosen, control = index[active], active, control[active]
        rows = select(index, len(self.bodies))
        record = self.engine.rollout(
            nstep=control.shape[1],
            control=control,
            record=("sensordata", "qpos") if trace else ("sensordata",),
            ids=None if isinstance(rows, slice) else index,  # MuJoCo's check of indices is slow
        )
        self.simulated_s += (last - first) * SMA_STEP_S * len(index)
        self._steps[rows] += last - first
        self._sma.enthalpy_j_kg[rows], self._sma.fraction[rows] = path.rows((last - 1, chosen))
        loads = np.add.accumulate(record["sensordata"][..., LOADS], axis=1)
        self._load_n[rows] = loads[:, -1] / control.shape[1]
        # `np.sum` would add in a different order for a single row.
        before_j, used_j = self.energy_j[index], np.add.accumulate(energy_j[first:last, chosen])
        self.energy_j[rows] = before_j + used_j[-1]
        self._locate(index)
        if not trace:
            return None
        springs = path.rows((slice(first, last), chosen))
        return Trace(
            record["qpos"][:, self._substeps - 1 :: self._substeps],
            np.swapaxes(springs.temperature_c(self.physics.spring), 0, 1),
            before_j[:, None] + used_j.T,
        )

    def _refresh(self, index: Rows, *, standing: bool = False) -> None:
        """Update derived fields after a change of the state; `standing` puts robots on the ground."""
        self.engine.forward(index, stage=_POSITIONS_AND_VELOCITIES)
        self._locate(index)
        if standing:
            self._qpos[index, 2] -= self._clearance_m[index] + STANCE_M
            self._refresh(index)

    def _locate(self, index: Rows) -> None:
        """Update the axes and clearances of `Pose` after a change of the positions."""
        chosen = select(index, len(self.bodies))
        self._axes[index] = mean_axes(index, self._xmat, *self._elements)  # x, y, z are columns
        centres_m, turns = (f[chosen, self._touching] for f in (self._geom_xpos, self._geom_xmat))
        lowest = clearances_m(self.physics.world, centres_m, turns, self._half_axes[chosen])
        self._clearance_m[chosen] = np.minimum.reduce(lowest, axis=1)

    def diverged(self, rows: Rows | None = None) -> NDArray[np.bool_]:
        """Return whether the state is not finite or MuJoCo has warned since reset, (R,)."""
        return find_diverged(self.indices(rows), self.engine.warning, self._qpos, self._qvel)

    def pose(self, rows: Rows | None = None) -> Pose:
        """Return the positions of the rows as new arrays."""
        index = self.indices(rows)
        axes = self._axes[index]
        return Pose(
            time_s=self._steps[index].astype(np.float64) * SMA_STEP_S,
            com_m=self._com[index, 1],
            up=axes[:, 2::3],
            forward=axes[:, 0::3],
            clearance_m=self._clearance_m[index],
            load_n=self._load_n[index],
        )

    def state(self, rows: Rows | None = None) -> BodyState:
        """Return the positions and velocities of the rows as new arrays."""
        index = self.indices(rows)
        pose, sma = self.pose(index), self._sma.rows(index)
        return BodyState(
            **vars(pose),
            velocity=mean_velocity(index, self._cvel, self._xpos, pose.com_m, *self._elements),
            joint_position=self._qpos[index, FREE_QPOS:],
            joint_velocity=self._qvel[index, FREE_QVEL:],
            temperature_c=sma.temperature_c(self.physics.spring),
            fraction=sma.fraction,
        )

    def qpos(self, row: int) -> Array:
        """Return the MuJoCo generalized positions of a row as a new array, (nq,)."""
        position: Array = self._qpos[row].copy()
        return position

    def data(self, row: int) -> mujoco.MjData:
        """Return a copy of the MuJoCo data of a row, with positions and velocities up to date."""
        data = self.engine.get_data(row)
        mujoco.mj_fwdPosition(self.models[row], data)
        mujoco.mj_fwdVelocity(self.models[row], data)
        return data

    def indices(self, rows: Rows | None = None) -> Rows:
        """Return `rows`, or the indices of all robots for None."""
        return np.arange(len(self.bodies)) if rows is None else rows
