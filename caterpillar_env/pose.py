"""Positions and velocities of robots as arrays."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from caterpillar_env.arrays import Array


@dataclass(frozen=True)
class Pose:
    """Positions of R robots, in the world frame and SI units: the inputs of the failure check.

    After a step, all fields except the time refer to the start of the last physics step (2.5 ms earlier
    by default), as in Gymnasium's MuJoCo environments. An update would make every step 3 % slower.
    """

    time_s: Array  #: simulated since reset, (R,)
    com_m: Array  #: centre of mass of the robot, (R, 3)
    up: Array  #: mean upward axis of the elements, (R, 3)
    forward: Array  #: mean forward axis of the elements, (R, 3)
    clearance_m: Array  #: height of the lowest point of feet and elements above the ground, (R,)
    load_n: Array  #: vertical load on feet and body, mean over the last control interval, (R, 2)


@dataclass(frozen=True)
class BodyState(Pose):
    """Positions and velocities of R robots with J internal joints.

    `velocity` refers to the same time as the pose. Joints and springs are up to date.
    """

    velocity: Array  #: mean velocity (3) and mean angular velocity (3) of the elements, (R, 6)
    joint_position: Array  #: axial, bend and neck joints from head to tail, m or rad, (R, J)
    joint_velocity: Array  #: their velocities, m/s or rad/s, (R, J)
    temperature_c: Array  #: of the springs, (R, num_springs)
    fraction: Array  #: austenite fraction, (R, num_springs)


class Trace(NamedTuple):
    """Poses, temperatures and energy after every thermal step, for drawing."""

    qpos: Array  #: MuJoCo generalized positions, (R, K, nq)
    temperature_c: Array  #: of the springs, (R, K, num_springs)
    energy_j: Array  #: electrical, since reset, (R, K)


class SimulationState(NamedTuple):
    """State of R robots: everything that their motion depends on, except bodies and conditions."""

    qpos: Array  #: MuJoCo generalized positions, (R, nq)
    qvel: Array  #: MuJoCo generalized velocities, (R, nv)
    time_s: Array  #: MuJoCo's time, (R,)
    warmstart: Array  #: accelerations from which MuJoCo's solver starts, (R, nv)
    enthalpy_j_kg: Array  #: of the springs, (R, num_springs)
    fraction: Array  #: austenite fraction of the springs, (R, num_springs)
    steps: NDArray[np.int64]  #: thermal steps since reset, (R,)
    energy_j: Array  #: electrical energy since reset, (R,)
    load_n: Array  #: on feet and skin, mean of the last interval, (R, 2)
