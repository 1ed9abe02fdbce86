"""The ground plane, its load sensors, and the clearance of the robot above it.

There are two coincident planes, one for the feet and one for the skin, so that MuJoCo sums the loads of
feet and skin separately.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from caterpillar_env.arrays import Array

#: Contact bits of the feet and of the skin.
FOOT, SKIN = 1, 2
#: Initial depth of the feet in the ground. All feet then touch it despite rounding errors.
STANCE_M = 1e-9
_PLANES = {"ground": FOOT, "ground_skin": SKIN}
_FORCE = 1 << mujoco.mjtConDataField.mjCONDATA_FORCE.value
_NET_FORCE = 3  # `reduce="netforce"` of MuJoCo's contact sensor
#: Vertical loads on feet and skin, N, in MuJoCo's sensor data.
LOADS = slice(2, None, 3)


def add_ground(spec: mujoco.MjSpec) -> mujoco.MjsGeom:
    """Add the ground planes and their load sensors to `spec`, and return the visible plane."""
    planes = []
    for name, bit in _PLANES.items():
        visible = bit == FOOT
        planes.append(
            spec.worldbody.add_geom(
                name=name, type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 0.05],
                contype=bit, conaffinity=0, priority=0, rgba=[0.5, 0.5, 0.5, float(visible)],
            )
        )  # fmt: skip
        spec.add_sensor(
            name=f"{name}_load", type=mujoco.mjtSensor.mjSENS_CONTACT,
            objtype=mujoco.mjtObj.mjOBJ_GEOM, objname=name, intprm=[_FORCE, _NET_FORCE, 1],
            datatype=mujoco.mjtDataType.mjDATATYPE_REAL,
        )  # fmt: skip
    return planes[0]


def condim(friction: float) -> int:
    """Return MuJoCo's contact dimensionality: 3 with friction, 1 (normal force only) without.

    With `condim` 3, MuJoCo raises a friction of 0 to 1e-5. That moves a robot by millimetres in 30 s.
    """
    return 3 if friction > 0 else 1


def touching_geoms(model: mujoco.MjModel) -> NDArray[np.intp]:
    """Return the indices of the geoms that can touch the ground: feet (spheres), shells (ellipsoids)."""
    return np.flatnonzero(model.geom_conaffinity)


def half_axes_m(model: mujoco.MjModel) -> Array:
    """Return the half axes of the `touching_geoms`, m, shape (G, 3)."""
    size = model.geom_size[touching_geoms(model)]
    axes: Array = np.where(size > 0, size, size[:, :1])  # MuJoCo stores only the first for a sphere
    return axes


def clearances_m(positions_m: Any, matrices: Any, half_axes_m: Any) -> Array:
    """Return the height of the lowest point of each ellipsoid above the ground.

    Args:
        positions_m: centres, m, (..., 3).
        matrices: rotation matrices in row-major order, (..., 9).
        half_axes_m: half axes, m, (..., 3).

    Returns:
        Heights, m, shape (...); negative below the ground.
    """
    reach = matrices[..., 6:] * half_axes_m
    lowest: Array = positions_m[..., 2] - np.sqrt(np.add.reduce(reach * reach, axis=-1))
    return lowest
