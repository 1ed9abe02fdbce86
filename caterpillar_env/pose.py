"""Positions and velocities of robots as arrays."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from caterpillar_env.arrays import Array, Rows, compiled


@dataclass(frozen=True)
class Pose:
    """Positions of R robots, in the world frame and SI units: the inputs of the failure check.

    After a step, all fields except `time_s` and `load_n` refer to the start of the last physics step
    (2.5 ms earlier by default), as in Gymnasium's MuJoCo environments. Updating them would make every
    step 3 % slower.
    """

    time_s: Array  #: simulated time since reset, (R,)
    com_m: Array  #: centre of mass of the robot, (R, 3)
    up: Array  #: mean upward axis of the elements, (R, 3)
    forward: Array  #: mean forward axis of the elements, (R, 3)
    clearance_m: Array  #: height of the lowest point of feet and elements above the ground, (R,)
    load_n: Array  #: vertical load on feet and on elements, mean over the last control interval, (R, 2)


@dataclass(frozen=True)
class BodyState(Pose):
    """Positions and velocities of R robots with J internal joints.

    `velocity` refers to the same time as the positions. Joints and springs refer to the end of the step.
    """

    velocity: Array  #: mean velocity (3) and mean angular velocity (3) of the elements, (R, 6)
    joint_position: Array  #: axial, bend and neck joints from head to tail, m or rad, (R, J)
    joint_velocity: Array  #: velocities of these joints, m/s or rad/s, (R, J)
    temperature_c: Array  #: spring temperatures, (R, num_springs)
    fraction: Array  #: austenite fraction, (R, num_springs)


class Trace(NamedTuple):
    """Poses, temperatures and energy after every thermal step, for drawing."""

    qpos: Array  #: MuJoCo generalized positions, (R, K, nq)
    temperature_c: Array  #: spring temperatures, (R, K, num_springs)
    energy_j: Array  #: electrical energy since reset, (R, K)


class SimulationState(NamedTuple):
    """State of R robots: everything that their motion depends on, except bodies and conditions."""

    qpos: Array  #: MuJoCo generalized positions, (R, nq)
    qvel: Array  #: MuJoCo generalized velocities, (R, nv)
    time_s: Array  #: MuJoCo's time, (R,)
    warmstart: Array  #: accelerations from which MuJoCo's solver starts, (R, nv)
    enthalpy_j_kg: Array  #: specific enthalpy of the springs, (R, num_springs)
    fraction: Array  #: austenite fraction of the springs, (R, num_springs)
    steps: NDArray[np.int64]  #: thermal steps since reset, (R,)
    energy_j: Array  #: electrical energy since reset, (R,)
    load_n: Array  #: mean vertical load on the feet and on the elements in the last interval, (R, 2)


@compiled
def mean_axes(rows: Rows, matrices: Array, first: int, last: int) -> Array:
    """Return the mean rotation matrix of the bodies `first` to `last - 1`, row-major, (R, 9)."""
    axes = np.zeros((len(rows), 9))
    for r, row in enumerate(rows):
        for body in range(first, last):
            axes[r] += matrices[row, body]
    return axes / (last - first)


@compiled
def mean_velocity(
    rows: Rows, spatial: Array, positions_m: Array, com_m: Array, first: int, last: int
) -> Array:
    """Return the mean linear and angular velocity of the bodies `first` to `last - 1`, (R, 6).

    Args:
        rows: indices of R of the B robots in the simulation, (R,).
        spatial: angular velocity, and linear velocity of the body at `com_m`, (B, bodies, 6).
        positions_m: positions of the bodies, (B, bodies, 3).
        com_m: centre of mass of each of these robots, (R, 3).
        first: first body.
        last: index after the last body.
    """
    mean = np.zeros((len(rows), 6))
    for r, row in enumerate(rows):
        for body in range(first, last):
            omega, velocity = spatial[row, body, :3], spatial[row, body, 3:]
            arm_m = positions_m[row, body] - com_m[r]
            for i in range(3):
                j, k = (i + 1) % 3, (i + 2) % 3
                mean[r, i] += velocity[i] + (omega[j] * arm_m[k] - omega[k] * arm_m[j])
                mean[r, 3 + i] += omega[i]
    return mean / (last - first)


@compiled
def find_diverged(
    rows: Rows, warnings: NDArray[np.int32], qpos: Array, qvel: Array
) -> NDArray[np.bool_]:
    """Return whether MuJoCo has warned or the state is not finite, (R,)."""
    diverged = np.zeros(len(rows), np.bool_)
    for r, row in enumerate(rows):
        finite = np.all(np.isfinite(qpos[row])) and np.all(np.isfinite(qvel[row]))
        diverged[r] = not finite or np.any(warnings[row, :, 1] != 0)
    return diverged


@compiled
def turn(rows: Rows, direction: Array, vectors: Array) -> Array:
    """Return the components of vectors along and across a direction, (R, 2).

    Args:
        rows: indices of R of the B robots in the simulation, (R,).
        direction: cosine and sine of the direction of each of the B robots, (B, 2).
        vectors: vector of each of these robots, (R, 2 or more).
    """
    turned = np.empty((len(rows), 2))
    for r, row in enumerate(rows):
        cosine, sine = direction[row]
        x, y = vectors[r, 0], vectors[r, 1]
        turned[r, 0], turned[r, 1] = x * cosine + y * sine, y * cosine - x * sine
    return turned
