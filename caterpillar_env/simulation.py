"""Robots of one topology with different bodies, advanced together on MuJoCo's `Batch`.

This is the only place where the physics is stepped. A single environment is a batch of one; the vector
environment and the fitness evaluation are larger batches. A robot's trajectory has the same bits in all
of them, with any number of threads.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache
from typing import NamedTuple

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from caterpillar_env.arrays import Array, Rows
from caterpillar_env.errors import SimulationError
from caterpillar_env.gait import count_steps
from caterpillar_env.ground import STANCE_M, clearances_m, half_axes_m, loads_n, touching_geoms
from caterpillar_env.machine import cores
from caterpillar_env.model import ELEMENTS_PER_SEGMENT, ModelBuilder
from caterpillar_env.morphology import Body
from caterpillar_env.physics import SMA_STEP_S, Physics
from caterpillar_env.pose import BodyState, Pose, Trace
from caterpillar_env.randomization import Conditions, apply_conditions
from caterpillar_env.sma import SmaState, SmaStep, advance

_CACHED_BODIES = 256
_POSITIONS_AND_VELOCITIES = mujoco.mjtStage.mjSTAGE_VEL.value
FREE_QPOS, FREE_QVEL = 7, 6  # sizes of the head's free joint; the internal joints follow


class Heating(NamedTuple):
    """Springs of R robots over K thermal steps that the robots have yet to make."""

    rows: Rows  #: of the robots, (R,)
    springs: SmaStep  #: enthalpy and fraction after each step, (K, R, num_springs)
    control: Array  #: mean fraction in each of n physics steps a thermal step, (R, K n, num_springs)
    energy_j: Array  #: electrical energy of each step, (K, R)


class Simulation:
    """Robots that share `physics`, each with a body of its own; at the start when made.

    Args:
        bodies: one for each of B robots; a robot's place is its row.
        physics: material, numerics, number of segments.
        threads: threads to step on; 0 means `machine.cores()`. The results do not depend on it.

    Attributes:
        bodies: the body of each row. Only `reset` changes it.
        conditions: the conditions of each row; None stands for those of `physics`.
        models: the compiled model of each row, without scenery.
        engine: the MuJoCo `Batch` that steps the rows. A wrapper may take its place, to record calls.
        energy_j: electrical energy of each row since its reset, (B,).
        simulated_s: time simulated so far, summed over the rows.

    Raises:
        SimulationError: no bodies, or a negative number of threads.
        MorphologyError: a body does not have the physics' number of segments.
    """

    def __init__(self, bodies: Sequence[Body], physics: Physics, threads: int = 0) -> None:
        if not len(bodies) or threads < 0:
            raise SimulationError(
                "a simulation needs at least one body and threads >= 0 (0: all usable cores); got "
                f"{len(bodies)} bodies and {threads} threads"
            )
        size, springs = len(bodies), physics.num_springs
        self.physics = physics
        self.simulated_s = 0.0
        self._substeps = count_steps(SMA_STEP_S, physics.timestep_s, "the thermal step")
        # Bodies that return (elites, the one body of a vector environment) are not built again.
        self._build = lru_cache(_CACHED_BODIES)(ModelBuilder(physics, scenery=False).build)
        self.bodies = list(bodies)
        self.conditions: list[Conditions | None] = [None] * size
        self.models = [self._build(body) for body in bodies]
        self.engine = Batch(self.models[0], size, threads or cores())
        self.engine.set_models(self.models)
        bind = self.engine.bind
        self._qpos, self._qvel = bind("qpos"), bind("qvel")
        self._xpos, self._xmat = bind("xpos"), bind("xmat")
        self._com, self._cvel = bind("subtree_com"), bind("cvel")
        self._geom_xpos, self._geom_xmat = bind("geom_xpos"), bind("geom_xmat")
        self._warning = self.engine.warning
        self._touching = touching_geoms(self.models[0])
        self._half_axes = np.stack([half_axes_m(model) for model in self.models])
        self._elements = slice(1, 1 + physics.num_segments * ELEMENTS_PER_SEGMENT)
        self._middles = (np.arange(self._substeps)[:, None] + 0.5) / self._substeps
        self._ambient_c = np.full((size, 1), physics.spring.ambient_c)
        self._sma = SmaState.cold(physics.spring, (size, springs))
        self._steps = np.zeros(size, dtype=np.int64)  # thermal steps since reset
        self.energy_j = np.zeros(size)
        self._load_n = np.zeros((size, 2))  # on feet and skin, mean over the last steps
        self.reset()

    def reset(
        self,
        bodies: Sequence[Body] | None = None,
        rows: Rows | None = None,
        *,
        conditions: Sequence[Conditions] | None = None,
    ) -> None:
        """Put robots back to the start: straight along x, at rest, springs cold.

        Args:
            bodies: one for each row that is reset; the present ones by default.
            rows: which rows; all by default.
            conditions: one for each row that is reset; those of `physics` by default.

        Raises:
            SimulationError: the number of bodies is not the number of rows.
        """
        index = self.rows(rows)
        if bodies is None:
            bodies = [self.bodies[row] for row in index]
        if len(bodies) != len(index):
            raise SimulationError(f"give one body for each of {len(index)} rows; got {len(bodies)}")
        met = [None] * len(index) if conditions is None else conditions
        changed = False
        for row, body, condition in zip(index.tolist(), bodies, met, strict=True):
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
        self._refresh(index)

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
        """Move robots to other poses. Springs and clock stay as they are.

        Args:
            qpos: MuJoCo generalised positions, (R, nq): position and unit quaternion of the head, then
                the internal joints (`model.joint_names`).
            rows: which rows; all by default.
            qvel: MuJoCo generalised velocities, (R, nv); at rest by default.
            standing: whether to raise or lower each robot until its lowest point touches the ground.

        Raises:
            SimulationError: `qpos` has the wrong shape.
        """
        index = self.rows(rows)
        expected = (len(index), self._qpos.shape[1])
        if qpos.shape != expected:
            raise SimulationError(f"qpos must have shape {expected}; got {qpos.shape}")
        self._qpos[index], self._qvel[index] = qpos, qvel
        self._refresh(index)
        if standing:
            self._qpos[index, 2] -= self.pose(index).clearance_m + STANCE_M
            self._refresh(index)

    def heat(self, power: Array, rows: Rows | None = None) -> Heating:
        """Heat the springs of robots for K thermal steps of `SMA_STEP_S`, which `advance` then makes.

        Temperatures do not depend on the motion; many steps in one call are faster.

        Args:
            power: share of the drive power per step and spring, in [0, 1], (R, K, num_springs).
            rows: which rows; all by default.

        Raises:
            SimulationError: `power` has the wrong shape.
        """
        index, spring = self.rows(rows), self.physics.spring
        if power.ndim != 3 or power[:, 0].shape != (len(index), self.physics.num_springs):
            raise SimulationError(
                f"power must have shape ({len(index)}, steps, {self.physics.num_springs}); "
                f"got {power.shape}"
            )
        before = SmaState(self._sma.enthalpy_j_kg[index], self._sma.fraction[index])
        steps = advance(spring, before, np.swapaxes(power, 0, 1), SMA_STEP_S, self._ambient_c[index])
        # The fraction is linear between thermal steps; physics steps get its value in their middle.
        nodes = np.concatenate([before.fraction[:, None], np.swapaxes(steps.fraction, 0, 1)], axis=1)
        fine = (nodes[:, 1:] - nodes[:, :-1])[:, :, None] * self._middles
        fine += nodes[:, :-1, None]  # (R, K, n, S)
        control = fine.reshape(len(index), -1, self.physics.num_springs)
        return Heating(
            index, steps, control, steps.power.sum(axis=2) * (spring.drive_power_w * SMA_STEP_S)
        )

    def advance(
        self,
        heating: Heating,
        places: Rows | None = None,
        first: int = 0,
        last: int | None = None,
        *,
        trace: bool = False,
    ) -> Trace | None:
        """Make the thermal steps from `first` to before `last` of those that have been heated, in turn.

        Args:
            heating: what `heat` returned.
            places: which of its robots to advance, in order; all by default.
            first: 0, or `last` of the call before.
            last: all steps by default.
            trace: whether to return what is needed to draw the steps.
        """
        springs, control, energy_j = heating.springs, heating.control, heating.energy_j
        last = len(energy_j) if last is None else last
        control = control[:, first * self._substeps : last * self._substeps]
        index: Rows = heating.rows
        chosen: Rows | slice = slice(None)  # makes no copies
        if places is not None and len(places) < len(index):
            index, chosen, control = index[places], places, control[places]
        record = self.engine.rollout(
            nstep=control.shape[1],
            control=control,
            record=("sensordata", "qpos") if trace else ("sensordata",),
            ids=index,
        )
        self._steps[index] += last - first
        self.simulated_s += (last - first) * SMA_STEP_S * len(index)
        self._sma.enthalpy_j_kg[index] = springs.enthalpy_j_kg[last - 1, chosen]
        self._sma.fraction[index] = springs.fraction[last - 1, chosen]
        loads = np.add.accumulate(loads_n(record["sensordata"]), axis=1)
        self._load_n[index] = loads[:, -1] / control.shape[1]
        # Summed one after the other; `sum` would take another order for a single row.
        before_j, used_j = self.energy_j[index], np.add.accumulate(energy_j[first:last, chosen])
        self.energy_j[index] = before_j + used_j[-1]
        if not trace:
            return None
        path = SmaState(springs.enthalpy_j_kg[first:last, chosen], springs.fraction[first:last, chosen])
        return Trace(
            record["qpos"][:, self._substeps - 1 :: self._substeps],
            np.swapaxes(path.temperature_c(self.physics.spring), 0, 1),
            before_j[:, None] + used_j.T,
        )

    def _refresh(self, index: Rows) -> None:
        """Update derived fields after the state was set by hand."""
        self.engine.forward(index, stage=_POSITIONS_AND_VELOCITIES)

    def diverged(self, rows: Rows | None = None) -> NDArray[np.bool_]:
        """Whether the state is not finite, or MuJoCo has warned since reset, (R,)."""
        index = self.rows(rows)
        finite = np.isfinite(self._qpos[index]).all(axis=1) & np.isfinite(self._qvel[index]).all(axis=1)
        diverged: NDArray[np.bool_] = self._warning[index, :, 1].any(axis=1) | ~finite
        return diverged

    def pose(self, rows: Rows | None = None) -> Pose:
        """Positions of the rows, as new arrays."""
        index = self.rows(rows)
        matrices = self._xmat[index, self._elements]
        axes = np.add.reduce(matrices, axis=1) / matrices.shape[1]  # row-major: x, y, z are columns
        touching = (index[:, None], self._touching)
        lowest = clearances_m(
            self._geom_xpos[touching], self._geom_xmat[touching], self._half_axes[index]
        )
        return Pose(
            time_s=self._steps[index].astype(np.float64) * SMA_STEP_S,
            com_m=self._com[index, 1],
            up=axes[:, 2::3],
            forward=axes[:, 0::3],
            clearance_m=np.minimum.reduce(lowest, axis=1),
            load_n=self._load_n[index],
        )

    def state(self, rows: Rows | None = None) -> BodyState:
        """Positions and velocities of the rows, as new arrays."""
        index = self.rows(rows)
        pose = self.pose(index)
        spatial = self._cvel[index, self._elements]  # angular; linear at the robot's centre of mass
        angular = spatial[..., :3]
        arm = self._xpos[index, self._elements] - pose.com_m[:, None]
        spatial[..., 3:] += _cross(angular, arm)
        mean = np.add.reduce(spatial, axis=1) / spatial.shape[1]
        sma = SmaState(self._sma.enthalpy_j_kg[index], self._sma.fraction[index])
        return BodyState(
            **vars(pose),
            velocity=mean[:, [3, 4, 5, 0, 1, 2]],
            joint_position=self._qpos[index, FREE_QPOS:],
            joint_velocity=self._qvel[index, FREE_QVEL:],
            temperature_c=sma.temperature_c(self.physics.spring),
            fraction=sma.fraction,
        )

    def qpos(self, row: int) -> Array:
        """MuJoCo generalised positions of a row, as a new array, (nq,)."""
        position: Array = self._qpos[row].copy()
        return position

    def rows(self, rows: Rows | None = None) -> Rows:
        """Indices of `rows`; of all robots for None."""
        return np.arange(len(self.bodies)) if rows is None else rows


def _cross(a: Array, b: Array) -> Array:
    """`np.cross` of (..., 3) arrays; NumPy's takes several times as long for a few vectors."""
    return a[..., [1, 2, 0]] * b[..., [2, 0, 1]] - a[..., [2, 0, 1]] * b[..., [1, 2, 0]]
