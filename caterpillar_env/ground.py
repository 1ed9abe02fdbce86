"""The ground of a world, its load sensors, and the clearance of the robot above it.

The *skin* consists of the ellipsoids of all elements. The ground exists twice, once for the feet and
once for the skin, so that MuJoCo sums the loads on feet and skin separately.
"""

from __future__ import annotations

from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from caterpillar_env.arrays import Array, compiled
from caterpillar_env.worlds import FIRST_STEP_M, Patches, Rough, Steps, World

#: Contact bits of the feet and of the skin.
FOOT, SKIN = 1, 2
#: Initial depth of the feet in the ground. All feet then touch it despite rounding errors.
STANCE_M = 1e-9
#: Clearance below which images and replays mark a foot or an element as touching the ground.
TOUCHING_M = 1e-4
#: Priorities of geoms. Ground without tiles has priority 0. In a contact, MuJoCo uses the friction of
#: the geom with the higher priority.
TILE, ROBOT = 2, 1
_LAYERS = {"ground": FOOT, "ground_skin": SKIN}
_FORCE = 1 << mujoco.mjtConDataField.mjCONDATA_FORCE.value
_NET_FORCE = 3  # `reduce="netforce"` of MuJoCo's contact sensor
#: Vertical loads on feet and skin, N, in MuJoCo's sensor data.
LOADS = slice(2, None, 3)
_GREY = (0.5, 0.5, 0.5)
_FAR_M, _DEEP_M = 5.0, 0.05  # half lengths of the outer boxes; half depth of the boxes


def add_ground(spec: mujoco.MjSpec, world: World) -> list[mujoco.MjsGeom]:
    """Add the ground of a world and its load sensors to `spec`, and return the visible geoms."""
    visible = []
    for name, bit in _LAYERS.items():
        parts = _make_parts(spec, world, bit)
        is_plane = len(parts) == 1
        # A contact sensor refers to one geom or one body, so several geoms need a body of their own.
        body = spec.worldbody if is_plane else spec.worldbody.add_body(name=name)
        for number, part in enumerate(parts):
            geom = body.add_geom(
                **{"name": name if is_plane else f"{name}{number}", "contype": bit, "conaffinity": 0,
                   "priority": 0, "mass": 0, "rgba": [*_GREY, float(bit == FOOT)]} | part
            )  # fmt: skip
            visible += [geom] if bit == FOOT else []
        kind = mujoco.mjtObj.mjOBJ_GEOM if is_plane else mujoco.mjtObj.mjOBJ_BODY
        spec.add_sensor(
            name=f"{name}_load", type=mujoco.mjtSensor.mjSENS_CONTACT, objtype=kind, objname=name,
            intprm=[_FORCE, _NET_FORCE, 1], datatype=mujoco.mjtDataType.mjDATATYPE_REAL,
        )  # fmt: skip
    return visible


def _make_parts(spec: mujoco.MjSpec, world: World, bit: int) -> list[dict[str, Any]]:
    """Return the geom attributes of one layer of the ground, which has the contact bit `bit`."""
    if isinstance(world, Rough):
        return _make_rough(spec, world)
    if isinstance(world, Steps):
        edges = FIRST_STEP_M + world.spacing_m * np.arange(world.count)
        x = [-_FAR_M, *edges.tolist(), _FAR_M]
        levels = (world.rise_m * np.arange(len(x) - 1)).tolist()
        return [_box((x[i], x[i + 1]), (-_FAR_M, _FAR_M), z) for i, z in enumerate(levels)]
    if isinstance(world, Patches) and bit == FOOT:
        return _make_tiles(world, float(spec.default.geom.friction[0]))
    return [{"type": mujoco.mjtGeom.mjGEOM_PLANE, "size": [0, 0, 0.05]}]


def _make_rough(spec: mujoco.MjSpec, world: Rough) -> list[dict[str, Any]]:
    """Return a height field, which both layers share, and four level boxes around it."""
    heights, x, y = world.height_field
    low, high = float(heights.min()), float(heights.max())
    if spec.hfield("rough") is None:
        spec.add_hfield(
            name="rough", nrow=heights.shape[0], ncol=heights.shape[1],
            size=[(x[1] - x[0]) / 2, (y[1] - y[0]) / 2, high - low, _DEEP_M],
            userdata=((heights - low) / (high - low)).ravel().tolist(),
        )  # fmt: skip
    field = {
        "type": mujoco.mjtGeom.mjGEOM_HFIELD, "hfieldname": "rough",
        "pos": [(x[0] + x[1]) / 2, (y[0] + y[1]) / 2, low],
    }  # fmt: skip
    wide, beside = (-_FAR_M, _FAR_M), ((-_FAR_M, y[0]), (y[1], _FAR_M))
    ends = ((-_FAR_M, x[0]), (x[1], _FAR_M))
    return [field, *(_box(wide, side) for side in beside), *(_box(end, y) for end in ends)]


def _make_tiles(world: Patches, friction: float) -> list[dict[str, Any]]:
    """Return tiles whose colour shows their friction; slippery tiles are bluer."""
    *edges, factors = world.factors()
    x, y = ([-_FAR_M, *inner[1:-1].tolist(), _FAR_M] for inner in edges)
    parts = []
    for (i, j), factor in np.ndenumerate(factors):
        grip = (factor - world.least) / ((world.greatest - world.least) or 1.0)
        parts.append(
            _box((x[i], x[i + 1]), (y[j], y[j + 1]))
            | {
                "friction": [float(factor) * friction, 0, 0], "priority": TILE,
                "rgba": [0.45 + 0.3 * grip, 0.65 + 0.1 * grip, 0.95 - 0.25 * grip, 1.0],
            }
        )  # fmt: skip
    return parts


def _box(x: tuple[float, float], y: tuple[float, float], top_m: float = 0.0) -> dict[str, Any]:
    """Return a box that spans the ranges `x` and `y`, with its top at the height `top_m`."""
    return {
        "type": mujoco.mjtGeom.mjGEOM_BOX,
        "size": [(x[1] - x[0]) / 2, (y[1] - y[0]) / 2, _DEEP_M],
        "pos": [(x[0] + x[1]) / 2, (y[0] + y[1]) / 2, top_m - _DEEP_M],
    }


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


def clearances_m(world: World, positions_m: Any, matrices: Any, half_axes_m: Any) -> Array:
    """Return the height of each ellipsoid above the ground.

    On uneven ground, this is the height above the tangent plane of the ground below the centre of the
    ellipsoid.

    Args:
        world: the ground.
        positions_m: centres, m, (..., 3).
        matrices: rotation matrices in row-major order, (..., 9).
        half_axes_m: half axes, m, (..., 3).

    Returns:
        Heights, m, shape (...); negative below the ground.
    """
    if world.level:
        lowest: Array = positions_m[..., 2] - _reach_m(matrices[..., 6:], half_axes_m)
        return lowest
    heights, normals = world.surface(positions_m[..., 0], positions_m[..., 1])
    rows = zip(np.split(normals, 3, axis=-1), np.split(matrices, 3, axis=-1), strict=True)
    directions = sum(normal * row for normal, row in rows)
    above: Array = positions_m[..., 2] - heights - _reach_m(directions, half_axes_m) / normals[..., 2]
    return above


@compiled
def _reach_m(directions: Array, half_axes_m: Array) -> Array:
    """Return the distance from the centres of ellipsoids to their tangent planes, m, (...).

    Args:
        directions: unit normals of the planes, in the frames of the ellipsoids, (..., 3).
        half_axes_m: half axes, m, (..., 3).
    """
    reach = directions * half_axes_m
    x, y, z = reach[..., 0], reach[..., 1], reach[..., 2]
    return np.sqrt(x * x + y * y + z * z)
