"""Where robots are and how they move, as arrays."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

from caterpillar_env.arrays import Array


@dataclass(frozen=True)
class Pose:
    """Positions of R robots, in the world frame and SI units: the inputs of the failure check.

    While robots move, everything but the time refers to the start of the last physics step (2.5 ms ago
    by default), as in Gymnasium's MuJoCo environments. Updating it would make every step 3 % slower.
    """

    time_s: Array  #: simulated since reset, (R,)
    com_m: Array  #: centre of mass of the whole robot, (R, 3)
    up: Array  #: mean over the elements of their own upward axis, (R, 3)
    forward: Array  #: mean over the elements of their own forward axis, (R, 3)
    clearance_m: Array  #: lowest point of feet and elements above the ground, (R,)
    load_n: Array  #: vertical load on feet and body, mean over the last control interval, (R, 2)


@dataclass(frozen=True)
class BodyState(Pose):
    """Positions and velocities of R robots with J internal joints.

    `velocity` is as old as the pose; joints and springs are current.
    """

    velocity: Array  #: mean velocity (3) and mean angular velocity (3) of the elements, (R, 6)
    joint_position: Array  #: axial, bend and neck joints from head to tail, m or rad, (R, J)
    joint_velocity: Array  #: the same in m/s or rad/s, (R, J)
    temperature_c: Array  #: of the springs, (R, num_springs)
    fraction: Array  #: austenite fraction, (R, num_springs)


class Trace(NamedTuple):
    """Poses, temperatures and energy after every thermal step, for drawing."""

    qpos: Array  #: MuJoCo generalised positions, (R, K, nq)
    temperature_c: Array  #: of the springs, (R, K, num_springs)
    energy_j: Array  #: electrical, since reset, (R, K)
