"""Thermal states of the springs of many robots, and the MuJoCo controls computed from them."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from caterpillar_env.arrays import Array, Rows, compiled
from caterpillar_env.physics import SMA_STEP_S
from caterpillar_env.sma import SmaSpring, SmaState, SmaSteps, advance


class Heating(NamedTuple):
    """Thermal states of the springs of R robots in the next K thermal steps."""

    rows: Rows  #: indices of the robots, (R,)
    springs: SmaSteps  #: arrays of shape (K, R, num_springs)
    control: Array  #: mean fraction in each physics step (n per thermal step), (R, K n, num_springs)
    energy_j: Array  #: electrical energy of each thermal step, (K, R)


def heat(
    spring: SmaSpring, before: SmaState, power: Array, ambient_c: Array, rows: Rows, substeps: int
) -> Heating:
    """Compute the thermal states of the springs of robots for the next K thermal steps.

    Args:
        spring: properties of the springs.
        before: state of the springs, arrays of shape (R, num_springs).
        power: share of the drive power in each thermal step, in [0, 1], (R, K, num_springs).
        ambient_c: air temperature of each robot, degC, (R, 1).
        rows: indices of the robots, (R,).
        substeps: number n of physics steps in a thermal step.
    """
    steps = advance(spring, before, np.swapaxes(power, 0, 1), SMA_STEP_S, ambient_c)
    control = _interpolate(before.fraction, steps.path.fraction, substeps)
    energy_j = steps.power.sum(axis=2) * (spring.drive_power_w * SMA_STEP_S)
    return Heating(rows, steps, control, energy_j)


@compiled
def _interpolate(before: Array, after: Array, substeps: int) -> Array:
    """Return the fraction at the midpoint of each physics step, (R, K n, num_springs).

    Args:
        before: fraction before the first thermal step, (R, num_springs).
        after: fraction after each thermal step, (K, R, num_springs).
        substeps: number n of physics steps in a thermal step.
    """
    steps, rows, springs = after.shape
    control = np.empty((rows, steps * substeps, springs))
    for r in range(rows):
        for k in range(steps):
            for n in range(substeps):
                share = (n + 0.5) / substeps
                for i in range(springs):
                    start = after[k - 1, r, i] if k else before[r, i]
                    control[r, k * substeps + n, i] = (after[k, r, i] - start) * share + start
    return control
