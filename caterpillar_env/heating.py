"""Thermal states of the springs of many robots, as controls of the physics steps."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from caterpillar_env.arrays import Array, Rows
from caterpillar_env.physics import SMA_STEP_S
from caterpillar_env.sma import SmaSpring, SmaState, SmaStep, advance


class Heating(NamedTuple):
    """Thermal states of the springs of R robots in the next K thermal steps."""

    rows: Rows  #: indices of the robots, (R,)
    springs: SmaStep  #: enthalpy and fraction after each step, (K, R, num_springs)
    control: Array  #: mean fraction in each physics step (n per thermal step), (R, K n, num_springs)
    energy_j: Array  #: electrical energy of each thermal step, (K, R)


def heat(
    spring: SmaSpring, before: SmaState, power: Array, ambient_c: Array, rows: Rows, middles: Array
) -> Heating:
    """Compute the springs of robots for the next K thermal steps.

    Args:
        spring: properties of the springs.
        before: state of the springs, arrays of shape (R, num_springs).
        power: share of the drive power in each thermal step, in [0, 1], (R, K, num_springs).
        ambient_c: air temperature of each robot, degC, (R, 1).
        rows: indices of the robots, (R,).
        middles: midpoints of the n physics steps, as shares of a thermal step, (n, 1).
    """
    steps = advance(spring, before, np.swapaxes(power, 0, 1), SMA_STEP_S, ambient_c)
    # Interpolate the fraction between thermal steps, at the midpoints of the physics steps.
    nodes = np.concatenate([before.fraction[:, None], np.swapaxes(steps.fraction, 0, 1)], axis=1)
    fine = (nodes[:, 1:] - nodes[:, :-1])[:, :, None] * middles
    fine += nodes[:, :-1, None]  # (R, K, n, S)
    control = fine.reshape(len(rows), -1, power.shape[2])
    energy_j = steps.power.sum(axis=2) * (spring.drive_power_w * SMA_STEP_S)
    return Heating(rows, steps, control, energy_j)
