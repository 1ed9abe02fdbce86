"""Many robots of one topology and different bodies, advanced together on MuJoCo's `Batch`.

This is the only place where the physics is stepped: one environment is a batch of one, the vector
environment and fitness evaluation are larger batches, and a row's trajectory has the same bits in all
of them, at any number of threads.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import mujoco
import numpy as np
from mujoco.batch import Batch
from numpy.typing import NDArray

from caterpillar_env.errors import SimulationError
from caterpillar_env.gait import whole
from caterpillar_env.model import ELEMENTS_PER_SEGMENT, FOOT_RADIUS_M, SMA_STEP_S, Physics, build_model
from caterpillar_env.morphology import Morphology
from caterpillar_env.sma import SmaState, advance

Array = NDArray[np.float64]
Rows = NDArray[np.intp]

FREE_QPOS, FREE_QVEL = 7, 6  # of the head's free joint; the other joints follow


class BodyState(NamedTuple):
    """Where R robots are and how they move. World frame, SI units; E elements, J internal joints."""

    time_s: Array  #: simulated since reset, (R,)
    com_m: Array  #: centre of mass of the whole robot, (R, 3)
    up: Array  #: mean over the elements of their own upward axis, (R, 3)
    forward: Array  #: mean over the elements of their own forward axis, (R, 3)
    clearance_m: Array  #: lowest point of feet and elements above the ground, (R,)
    velocity: Array  #: mean velocity (3) and mean angular velocity (3) of the elements, (R, 6)
    joint_position: Array  #: axial, bend and neck joints from head to tail, m or rad, (R, J)
    joint_velocity: Array  #: likewise, m/s or rad/s, (R, J)
    temperature_c: Array  #: of the springs, (R, num_springs)
    fraction: Array  #: austenite fraction, (R, num_springs)


class Trace(NamedTuple):
    """Poses and temperatures after every thermal step, for drawing."""

    qpos: Array  #: MuJoCo generalised positions, (R, K, nq)
    temperature_c: Array  #: of the springs, (R, K, num_springs)


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
                f"a simulation needs num_rows >= 1 and threads >= 0; got {num_rows} and {threads}"
            )
        self.physics = physics
        self.num_rows = num_rows
        self.simulated_s = 0.0
        self._substeps = whole(SMA_STEP_S, physics.timestep_s, "the thermal step")
        self._strengths = physics.strengths()
        nominal = build_model(Morphology(), physics, self._strengths)
        self._models = [nominal] * num_rows
        self._morphologies = [Morphology()] * num_rows
        self._batch = Batch(nominal, num_rows, threads)
        self._qpos, self._qvel = self._batch.bind("qpos"), self._batch.bind("qvel")
        self._xpos, self._xmat = self._batch.bind("xpos"), self._batch.bind("xmat")
        self._com, self._cvel = self._batch.bind("subtree_com"), self._batch.bind("cvel")
        self._geom_xpos = self._batch.bind("geom_xpos")
        names = [nominal.geom(i).name for i in range(nominal.ngeom)]
        self._feet = [i for i, name in enumerate(names) if name.startswith("foot")]
        self._shells = [i for i, name in enumerate(names) if name.startswith("shell")]
        self._sma = SmaState.cold(physics.spring, (num_rows, physics.num_springs))
        self._steps = np.zeros(num_rows, dtype=np.int64)  # thermal steps since reset
        self._radius = np.full(num_rows, Morphology().segment_radius_m)
        self._ready = np.zeros(num_rows, dtype=bool)
        self.energy_j = np.zeros(num_rows)  # electrical, since reset

    def morphology(self, row: int) -> Morphology:
        """The body of a row."""
        return self._morphologies[row]

    def reset(
        self,
        morphologies: Sequence[Morphology],
        rows: Rows | None = None,
        *,
        heading_rad: float = 0.0,
        offset: Array | None = None,
    ) -> None:
        """Put robots back to the start: straight, at rest, springs cold, head towards `heading_rad`.

        Args:
            morphologies: one body for each row that is reset.
            rows: which rows; all by default.
            heading_rad: starting heading, counter-clockwise from world x.
            offset: added to the internal joints' positions, m or rad, shape (R, J).

        Raises:
            SimulationError: not one morphology a row.
        """
        index = self._rows(rows)
        if len(morphologies) != len(index):
            raise SimulationError(f"{len(index)} rows need as many bodies; got {len(morphologies)}")
        for row, morphology in zip(index.tolist(), morphologies, strict=True):
            if self._morphologies[row] != morphology:
                self._models[row] = build_model(morphology, self.physics, self._strengths)
                self._morphologies[row] = morphology
                self._radius[row] = morphology.segment_radius_m
        self._batch.set_models(self._models)
        self._batch.reset(index, stage=mujoco.mjtStage.mjSTAGE_NONE.value)
        half = heading_rad / 2
        if heading_rad != 0.0:
            self._qpos[index, 3:FREE_QPOS] = [np.cos(half), 0.0, 0.0, np.sin(half)]
        if offset is not None:
            self._qpos[index, FREE_QPOS:] += offset
        cold = SmaState.cold(self.physics.spring, (len(index), self.physics.num_springs))
        self._sma.enthalpy_j_kg[index], self._sma.fraction[index] = cold
        self._steps[index] = 0
        self.energy_j[index] = 0.0
        self._ready[index] = True
        self._refresh(index)
        if offset is not None:  # the lowest foot stands on the ground again
            self._qpos[index, 2] -= self.state(index).clearance_m
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

    def advance(self, power: Array, rows: Rows | None = None, *, trace: bool = False) -> Trace | None:
        """Advance robots by K thermal steps of `SMA_STEP_S`.

        Args:
            power: share of the drive power per step and spring, in [0, 1], (R, K, num_springs).
            rows: which rows; all by default.
            trace: whether to return what is needed to draw the steps.

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
        before = SmaState(self._sma.enthalpy_j_kg[index], self._sma.fraction[index])
        heated = advance(self.physics.spring, before, np.swapaxes(power, 0, 1), SMA_STEP_S)
        self._sma.enthalpy_j_kg[index], self._sma.fraction[index] = heated.state
        energy = heated.power.sum(axis=(0, 2)) * (self.physics.spring.drive_power_w * SMA_STEP_S)
        self.energy_j[index] += energy

        record = self._batch.rollout(
            nstep=power.shape[1] * self._substeps,
            control=self._control(before.fraction, heated.fraction),
            record=("qpos",) if trace else (),
            ids=index,
        )
        self._steps[index] += power.shape[1]
        self.simulated_s += power.shape[1] * SMA_STEP_S * len(index)
        self._refresh(index)
        if not trace:
            return None
        last = slice(self._substeps - 1, None, self._substeps)
        path = SmaState(heated.enthalpy_j_kg, heated.fraction)
        temperature = path.temperature_c(self.physics.spring)
        return Trace(record["qpos"][:, last], np.swapaxes(temperature, 0, 1))

    def _control(self, start: Array, fraction: Array) -> Array:
        """Mean fraction during each physics step, linear between thermal steps: (R, K n, springs)."""
        nodes = np.concatenate([start[None], fraction])  # (K + 1, R, springs)
        share = ((np.arange(self._substeps) + 0.5) / self._substeps)[:, None, None]
        fine = nodes[:-1, None] + share * (nodes[1:, None] - nodes[:-1, None])  # (K, n, R, springs)
        flat = fine.reshape(-1, *start.shape)
        return np.ascontiguousarray(np.swapaxes(flat, 0, 1))

    def _refresh(self, index: Rows) -> None:
        """Make derived fields current; they lag one physics step otherwise."""
        self._batch.forward(index, stage=mujoco.mjtStage.mjSTAGE_VEL.value)

    def diverged(self, rows: Rows | None = None) -> NDArray[np.bool_]:
        """Whether MuJoCo warned of a bad state or a full constraint buffer since reset, (R,)."""
        index = self._rows(rows)
        finite = np.isfinite(self._qpos[index]).all(axis=1) & np.isfinite(self._qvel[index]).all(axis=1)
        warned: NDArray[np.bool_] = (self._batch.warning[index, :, 1] > 0).any(axis=1)
        diverged: NDArray[np.bool_] = warned | ~finite
        return diverged

    def state(self, rows: Rows | None = None) -> BodyState:
        """Fresh copies of where the rows are."""
        index = self._rows(rows)
        elements = slice(1, 1 + self.physics.num_segments * ELEMENTS_PER_SEGMENT)
        com = self._com[index, 1]
        matrices = self._xmat[index, elements].reshape(len(index), -1, 3, 3)
        shells = self._geom_xpos[index][:, self._shells, 2].min(axis=1) - self._radius[index]
        feet = self._geom_xpos[index][:, self._feet, 2].min(axis=1) - FOOT_RADIUS_M
        spatial = self._cvel[index, elements]  # angular; linear at the centre of mass of the robot
        angular, linear = spatial[..., :3], spatial[..., 3:]
        arm = self._xpos[index, elements] - com[:, None]
        linear = linear + np.cross(angular, arm)
        sma = SmaState(self._sma.enthalpy_j_kg[index], self._sma.fraction[index])
        return BodyState(
            time_s=self._steps[index].astype(np.float64) * SMA_STEP_S,
            com_m=com,
            up=matrices[..., 2].mean(axis=1),
            forward=matrices[..., 0].mean(axis=1),
            clearance_m=np.minimum(shells, feet),
            velocity=np.concatenate([linear.mean(axis=1), angular.mean(axis=1)], axis=-1),
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
        """A copy of a row's model and data, its derived fields computed, to render."""
        model = self._batch.get_model(row)
        data = self._batch.get_data(row)
        mujoco.mj_forward(model, data)
        return model, data

    def _rows(self, rows: Rows | None) -> Rows:
        return np.arange(self.num_rows) if rows is None else rows
