"""The ground: which parts touch it, how high they are above it, and how much load they carry.

Feet and skin touch two coincident planes, so that the engine sums the loads of the two separately.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from caterpillar_env.arrays import Array

#: Contact bits of the two kinds of parts that touch the ground.
FOOT, SKIN = 1, 2
#: Depth of the feet in the ground at the start, so that rounding does not decide which of them touch it.
STANCE_M = 1e-9
_PLANES = {"ground": FOOT, "ground_skin": SKIN}
_FORCE = 1 << mujoco.mjtConDataField.mjCONDATA_FORCE.value
_NET_FORCE = 3  # `reduce="netforce"` of MuJoCo's contact sensor
_SENSORS = slice(2, None, 3)  # vertical components of the two forces, N


def add_ground(spec: mujoco.MjSpec) -> mujoco.MjsGeom:
    """Add the ground, with a sensor of the load on the feet and one of that on the skin.

    Returns:
        The plane that is drawn.
    """
    planes = []
    for name, bit in _PLANES.items():
        drawn = bit == FOOT
        planes.append(
            spec.worldbody.add_geom(
                name=name, type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 0.05],
                contype=bit, conaffinity=0, priority=0, rgba=[0.5, 0.5, 0.5, float(drawn)],
            )
        )  # fmt: skip
        spec.add_sensor(
            name=f"{name}_load", type=mujoco.mjtSensor.mjSENS_CONTACT,
            objtype=mujoco.mjtObj.mjOBJ_GEOM, objname=name, intprm=[_FORCE, _NET_FORCE, 1],
            datatype=mujoco.mjtDataType.mjDATATYPE_REAL,
        )  # fmt: skip
    return planes[0]


def condim(friction: float) -> int:
    """MuJoCo's number of contact dimensions: without friction only the normal one.

    With three, MuJoCo raises a coefficient of 0 to 1e-5, which moves a robot by millimetres in 30 s.
    """
    return 3 if friction > 0 else 1


def loads_n(sensordata: Array) -> Array:
    """Vertical load on feet and on skin from MuJoCo's sensor data, (..., sensors) to (..., 2), N."""
    return sensordata[..., _SENSORS]


def touching_geoms(model: mujoco.MjModel) -> NDArray[np.intp]:
    """Indices of the geoms that can touch the ground: feet (spheres) and shells (ellipsoids)."""
    return np.flatnonzero(model.geom_conaffinity)


def half_axes_m(model: mujoco.MjModel) -> Array:
    """Half axes of the `touching_geoms`, shape (G, 3), m."""
    size = model.geom_size[touching_geoms(model)]
    axes: Array = np.where(size > 0, size, size[:, :1])  # of a sphere only the first is given
    return axes


def clearances_m(positions_m: Any, matrices: Any, half_axes_m: Any) -> Array:
    """How far the lowest points of ellipsoids are above the ground, m.

    Args:
        positions_m: of their centres, (..., 3).
        matrices: their orientations, row by row, (..., 9).
        half_axes_m: their half axes, (..., 3).

    Returns:
        Heights, shape (...); negative inside the ground.
    """
    reach = matrices[..., 6:] * half_axes_m
    lowest: Array = positions_m[..., 2] - np.sqrt((reach * reach).sum(axis=-1))
    return lowest
