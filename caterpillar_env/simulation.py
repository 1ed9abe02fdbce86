"""Many robots of one topology and different bodies, advanced together on MuJoCo's `Batch`.

This is the only place where the physics is stepped: one environment is a batch of one, the vector
environment and fitness evaluation are larger batches, and a row's trajectory has the same bits in all
of them, at any number of threads.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import NamedTuple

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from caterpillar_env.arrays import Array
from caterpillar_env.errors import SimulationError
from caterpillar_env.gait import whole
from caterpillar_env.ground import STANCE_M, clearances_m, half_axes_m, loads_n, touching_geoms
from caterpillar_env.model import ELEMENTS_PER_SEGMENT, ModelBuilder, build_model
from caterpillar_env.morphology import Body, Morphology
from caterpillar_env.physics import SMA_STEP_S, Physics
from caterpillar_env.randomization import Conditions, varied
from caterpillar_env.sma import SmaState, advance

Rows = NDArray[np.intp]

_CACHED_BODIES = 256
_POSITIONS_AND_VELOCITIES = mujoco.mjtStage.mjSTAGE_VEL.value
FREE_QPOS, FREE_QVEL = 7, 6  # of the head's free joint; the other joints follow


@dataclass(frozen=True)
class Pose:
    """Where R robots are: what a verdict is made of. World frame, SI units.

    While robots move, all but the time is derived at the start of the last physics step (2.5 ms ago by
    default), as in Gymnasium's own MuJoCo environments; to derive it anew would cost 3 % of all steps.
    """

    time_s: Array  #: simulated since reset, (R,)
    com_m: Array  #: centre of mass of the whole robot, (R, 3)
    up: Array  #: mean over the elements of their own upward axis, (R, 3)
    forward: Array  #: mean over the elements of their own forward axis, (R, 3)
    clearance_m: Array  #: lowest point of feet and elements above the ground, (R,)
    load_n: Array  #: vertical load on feet and body, mean over the last control interval, (R, 2)


@dataclass(frozen=True)
class BodyState(Pose):
    """Where R robots are and how they move; J internal joints.

    `velocity` is as old as the pose; joints and springs are those of this very moment.
    """

    velocity: Array  #: mean velocity (3) and mean angular velocity (3) of the elements, (R, 6)
    joint_position: Array  #: axial, bend and neck joints from head to tail, m or rad, (R, J)
    joint_velocity: Array  #: likewise, m/s or rad/s, (R, J)
    temperature_c: Array  #: of the springs, (R, num_springs)
    fraction: Array  #: austenite fraction, (R, num_springs)


class Trace(NamedTuple):
    """Poses, temperatures and energy after every thermal step, for drawing."""

    qpos: Array  #: MuJoCo generalised positions, (R, K, nq)
    temperature_c: Array  #: of the springs, (R, K, num_springs)
    energy_j: Array  #: electrical, since reset, (R, K)


class Simulation:
    """`num_rows` robots with bodies of their own, sharing `physics`.

    Args:
        num_rows: number of robots B.
        physics: material, numerics, number of segments.
        threads: threads to step on; 0 means all cores. The results do not depend on it.

    Every row must be `reset` before it is advanced.
    """

    def __init__(self, num_rows: int, physics: Physics, threads: int = 0) -> None:
        if num_rows < 1 or threads < 0:
            raise SimulationError(
                "a simulation needs num_rows >= 1 and threads >= 0 (0: all cores); got "
                f"{num_rows} and {threads}"
            )
        self.physics = physics
        self.num_rows = num_rows
        self.simulated_s = 0.0
        self._substeps = whole(SMA_STEP_S, physics.timestep_s, "the thermal step")
        # Bodies that come back (elites, a vector environment's one body) are not built again.
        builder = ModelBuilder(physics, scenery=False)
        self._build = lru_cache(_CACHED_BODIES)(builder.build)
        nominal = self._build(Morphology())
        self._models = [nominal] * num_rows
        self._bodies: list[Body] = [Morphology()] * num_rows
        self._conditions: list[Conditions | None] = [None] * num_rows
        self._ambient_c = np.full((num_rows, 1), physics.spring.ambient_c)
        self._batch = Batch(nominal, num_rows, threads)
        self._batch.set_models(self._models)
        self._qpos, self._qvel = self._batch.bind("qpos"), self._batch.bind("qvel")
        self._xpos, self._xmat = self._batch.bind("xpos"), self._batch.bind("xmat")
        self._com, self._cvel = self._batch.bind("subtree_com"), self._batch.bind("cvel")
        self._geom_xpos, self._geom_xmat = self._batch.bind("geom_xpos"), self._batch.bind("geom_xmat")
        self._warning = self._batch.warning
        self._touching = touching_geoms(nominal)
        self._half_axes = np.tile(half_axes_m(nominal), (num_rows, 1, 1))
        self._middles = (np.arange(self._substeps)[:, None] + 0.5) / self._substeps
        self._sma = SmaState.cold(physics.spring, (num_rows, physics.num_springs))
        self._steps = np.zeros(num_rows, dtype=np.int64)  # thermal steps since reset
        self._elements = slice(1, 1 + physics.num_segments * ELEMENTS_PER_SEGMENT)
        self._ready = np.zeros(num_rows, dtype=bool)
        self.energy_j = np.zeros(num_rows)  # electrical, since reset
        self._load_n = np.zeros((num_rows, 2))  # on feet and skin, mean of the last steps

    def body(self, row: int) -> Body:
        """The body of a row."""
        return self._bodies[row]

    def reset(
        self,
        bodies: Sequence[Body],
        rows: Rows | None = None,
        *,
        conditions: Sequence[Conditions] | None = None,
        heading_rad: float = 0.0,
        offset: Array | None = None,
    ) -> None:
        """Put robots back to the start: straight, at rest, springs cold, head towards `heading_rad`.

        Args:
            bodies: one for each row that is reset.
            rows: which rows; all by default.
            conditions: what each of them meets with; those of `physics` by default.
            heading_rad: starting heading, counter-clockwise from world x.
            offset: added to the internal joints' positions, m or rad, shape (R, J).

        Raises:
            SimulationError: not one body a row.
        """
        index = self._rows(rows)
        if len(bodies) != len(index):
            raise SimulationError(f"{len(index)} rows need as many bodies; got {len(bodies)}")
        changed = False
        met = [None] * len(index) if conditions is None else conditions
        for row, body, condition in zip(index.tolist(), bodies, met, strict=True):
            if self._bodies[row] != body or self._conditions[row] != condition:
                model = self._build(body)
                own = self.physics.spring.ambient_c
                self._models[row] = (
                    model if condition is None else varied(model, self.physics, condition)
                )
                self._ambient_c[row] = own if condition is None else condition.ambient_c
                self._bodies[row], self._conditions[row] = body, condition
                self._half_axes[row] = half_axes_m(model)
                changed = True
        if changed:
            self._batch.set_models(self._models)
        self._batch.reset(index, stage=mujoco.mjtStage.mjSTAGE_NONE.value)
        half = heading_rad / 2
        if heading_rad != 0.0:
            self._qpos[index, 3:FREE_QPOS] = [np.cos(half), 0.0, 0.0, np.sin(half)]
        if offset is not None:
            self._qpos[index, FREE_QPOS:] += offset
        shape = (len(index), self.physics.num_springs)
        cold = SmaState.cold(self.physics.spring, shape, self._ambient_c[index])
        self._sma.enthalpy_j_kg[index], self._sma.fraction[index] = cold
        self._steps[index] = 0
        self.energy_j[index] = 0.0
        self._load_n[index] = 0.0
        self._ready[index] = True
        self._refresh(index)
        if offset is not None:  # the lowest foot stands on the ground again
            self._qpos[index, 2] -= self.pose(index).clearance_m + STANCE_M
            self._refresh(index)

    def place(self, qpos: Array, rows: Rows | None = None) -> None:
        """Move robots that have been reset to other poses, at rest.

        Args:
            qpos: MuJoCo generalised positions, (R, nq): position and unit quaternion of the head, then
                the internal joints (`model.joint_names`).
            rows: which rows; all by default.

        Raises:
            SimulationError: wrong shape.
        """
        index = self._rows(rows)
        expected = (len(index), self._qpos.shape[1])
        if qpos.shape != expected:
            raise SimulationError(f"qpos must have shape {expected}; got {qpos.shape}")
        self._qpos[index], self._qvel[index] = qpos, 0.0
        self._refresh(index)

    def advance(
        self,
        power: Array,
        rows: Rows | None = None,
        *,
        trace: bool = False,
        every: int | None = None,
        watch: Callable[[Rows, Trace | None], NDArray[np.bool_]] | None = None,
    ) -> Trace | None:
        """Advance robots by K thermal steps of `SMA_STEP_S`, or until `watch` stops them.

        Args:
            power: share of the drive power per step and spring, in [0, 1], (R, K, num_springs).
            rows: which rows; all by default.
            trace: whether to trace what is needed to draw the steps.
            every: thermal steps between two calls of `watch`; K by default.
            watch: called with the rows that still go on and their trace of these steps; returns which
                of them are to go on, bool, one per row.

        Returns:
            The trace of the last steps, those since the last call of `watch`; None unless `trace`.

        Raises:
            SimulationError: wrong shape, or a row that was never reset.
        """
        index = self._rows(rows)
        springs = self.physics.num_springs
        if power.ndim != 3 or power.shape[0] != len(index) or power.shape[2] != springs:
            raise SimulationError(
                f"power must have shape ({len(index)}, steps, {springs}); got {power.shape}"
            )
        if not self._ready[index].all():
            raise SimulationError("reset a row before advancing it")
        # Temperatures do not depend on the motion: all of them first, and what springs draw.
        before = SmaState(self._sma.enthalpy_j_kg[index], self._sma.fraction[index])
        heated = advance(
            self.physics.spring, before, np.swapaxes(power, 0, 1), SMA_STEP_S, self._ambient_c[index]
        )
        control = self._control(before.fraction, heated.fraction)
        energy_j = heated.power.sum(axis=2) * (self.physics.spring.drive_power_w * SMA_STEP_S)

        steps, traced = power.shape[1], None
        every, going = every or steps, np.arange(len(index))
        for first in range(0, steps, every):
            if not going.size:
                break
            last = min(first + every, steps)
            now, everyone = index[going], len(going) == len(index)
            part = control[:, first * self._substeps : last * self._substeps]
            record = self._batch.rollout(
                nstep=part.shape[1],
                control=part if everyone else part[going],
                record=("sensordata", "qpos") if trace else ("sensordata",),
                ids=now,
            )
            self._steps[now] += last - first
            self.simulated_s += (last - first) * SMA_STEP_S * len(now)
            self._sma.enthalpy_j_kg[now] = heated.enthalpy_j_kg[last - 1, going]
            self._sma.fraction[now] = heated.fraction[last - 1, going]
            loads = np.add.accumulate(loads_n(record["sensordata"]), axis=1)
            self._load_n[now] = loads[:, -1] / part.shape[1]
            # Summed one after the other; `sum` would take another order for a single row.
            before_j, drawn_j = self.energy_j[now], np.add.accumulate(energy_j[first:last, going])
            self.energy_j[now] = before_j + drawn_j[-1]
            if trace:
                path = SmaState(
                    heated.enthalpy_j_kg[first:last, going], heated.fraction[first:last, going]
                )
                temperature = np.swapaxes(path.temperature_c(self.physics.spring), 0, 1)
                qpos = record["qpos"][:, self._substeps - 1 :: self._substeps]
                traced = Trace(qpos, temperature, before_j[:, None] + drawn_j.T)
            if watch is not None:
                going = going[watch(now, traced)]
        return traced

    def _control(self, start: Array, fraction: Array) -> Array:
        """Mean fraction during each physics step, linear between thermal steps: (R, K n, springs)."""
        nodes = np.concatenate([start[:, None], np.swapaxes(fraction, 0, 1)], axis=1)  # (R, K + 1, S)
        fine = (nodes[:, 1:] - nodes[:, :-1])[:, :, None] * self._middles
        fine += nodes[:, :-1, None]  # (R, K, n, S)
        flat: Array = fine.reshape(len(start), -1, start.shape[1])
        return flat

    def _refresh(self, index: Rows) -> None:
        """Make derived fields current, after the state was set by hand."""
        self._batch.forward(index, stage=_POSITIONS_AND_VELOCITIES)

    def diverged(self, rows: Rows | None = None) -> NDArray[np.bool_]:
        """Whether MuJoCo warned of a bad state or a full constraint buffer since reset, (R,)."""
        index = self._rows(rows)
        finite = np.isfinite(self._qpos[index]).all(axis=1) & np.isfinite(self._qvel[index]).all(axis=1)
        warned = self._warning[index, :, 1].any(axis=1)
        diverged: NDArray[np.bool_] = warned | ~finite
        return diverged

    def pose(self, rows: Rows | None = None) -> Pose:
        """Where the rows are, as fresh arrays."""
        index = self._rows(rows)
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
        """Where the rows are and how they move, as fresh arrays."""
        index = self._rows(rows)
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
        """MuJoCo generalised positions of a row, (nq,)."""
        position: Array = self._qpos[row].copy()
        return position

    def drawable(self, row: int) -> tuple[mujoco.MjModel, mujoco.MjData]:
        """A row to render: a model with scenery, and data in its pose with all derived fields."""
        model = build_model(self._bodies[row], self.physics)
        data = mujoco.MjData(model)
        data.qpos[:], data.qvel[:] = self._qpos[row], self._qvel[row]
        mujoco.mj_forward(model, data)
        return model, data

    def _rows(self, rows: Rows | None) -> Rows:
        return np.arange(self.num_rows) if rows is None else rows


def _cross(a: Array, b: Array) -> Array:
    """`np.cross` of (..., 3) arrays, which takes several times as long for a few vectors."""
    return a[..., [1, 2, 0]] * b[..., [2, 0, 1]] - a[..., [2, 0, 1]] * b[..., [1, 2, 0]]
