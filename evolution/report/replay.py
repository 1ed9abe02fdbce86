"""A recorded robot as JSON, for the 3D replay of a page (`replay.js`): its shapes and its poses."""

from __future__ import annotations

import base64
import math
from typing import Any

import mujoco
import numpy as np
from numpy.typing import NDArray

from caterpillar_env.arrays import Array
from caterpillar_env.drawing.overlay import spring_rgb
from caterpillar_env.drawing.scenery import rotation_to
from caterpillar_env.drawing.video import Recording
from caterpillar_env.ground import TOUCHING_M, clearances_m, half_axes_m, touching_geoms
from caterpillar_env.model import ELEMENTS_PER_SEGMENT, build_model
from caterpillar_env.physics import SMA_STEP_S
from caterpillar_env.worlds import World

_STRIDE = 2  # thermal steps from one frame to the next
_MAX_BYTES = 600_000  # size of the arrays before base64; robots of many segments get fewer frames
_CELL_M = 0.005  # grid spacing of uneven ground
_COLOURS = 64  # number of spring colours, from ambient temperature to the cut-off


def encode(recording: Recording) -> dict[str, Any]:
    """Return the data that `replay.js` draws, ready for JSON.

    Arrays are in base64, little-endian, with a row per frame. Positions are in m.
    """
    robot = recording.robot
    model, world = build_model(robot.morphology, robot.physics), robot.physics.world
    elements = ELEMENTS_PER_SEGMENT * robot.physics.num_segments
    spring = robot.physics.spring
    steps = len(recording.qpos)
    row_bytes = 14 * elements + model.ntendon + len(touching_geoms(model)) + 12
    stride = max(_STRIDE, math.ceil(steps * row_bytes / _MAX_BYTES))
    frames = np.arange(steps - 1, -1, -stride)[::-1]  # the last pose is always shown
    poses, touches, centres_m = _locate(model, world, elements, recording.qpos[frames])
    scale_m = float(np.abs(poses[..., :3]).max()) / 32767
    poses[..., :3] /= scale_m
    poses[..., 3:] *= 32767
    share = (recording.temperature_c[frames] - spring.ambient_c) / (spring.cut_off_c - spring.ambient_c)
    heat = np.clip(np.round((_COLOURS - 1) * share), 0, _COLOURS - 1)
    palette_c = np.linspace(spring.ambient_c, spring.cut_off_c, _COLOURS)
    (start_m,) = _locate(model, world, elements, model.qpos0[None])[2]
    return {
        "length_m": recording.body_length_m,
        "start_m": start_m[0],
        "duration_s": recording.duration_s,
        "interval_s": stride * SMA_STEP_S,
        "elements": elements,
        "upright": rotation_to(world.up).tolist(),  # from a frame with vertical z to the ground's frame
        "ground": None if world.level else _sample(world, centres_m, recording.body_length_m),
        "shapes": [
            _shape(model, geom)
            for geom in range(model.ngeom)
            if 0 < model.geom_bodyid[geom] <= elements  # not the ground
        ],
        "springs": [[_point(model, site) for site in ends] for ends in model.wrap_objid.reshape(-1, 2)],
        "palette": [_hex(rgb) for rgb in spring_rgb(spring, palette_c)],
        "ambient_c": spring.ambient_c,
        "cut_off_c": spring.cut_off_c,
        "scale_m": scale_m,
        "poses": _base64(np.round(poses), "<i2"),  # position / scale_m and quaternion * 32767
        "heat": _base64(heat, "u1"),  # index into the palette, for each spring
        "touches": _base64(touches, "u1"),  # for each foot and shell, in the order of the shapes
        "track": _base64(np.column_stack([centres_m[:, :2], recording.energy_j[frames]]), "<f4"),
    }


def _locate(
    model: mujoco.MjModel, world: World, elements: int, qpos: Array
) -> tuple[Array, NDArray[np.bool_], Array]:
    """Return poses of elements, contacts of parts, and centres of mass in K frames.

    Poses are positions (m) and quaternions, (K, elements, 7). Contacts are True where a part touches the
    ground, (K, parts). Centres of mass are in m, (K, 3).
    """
    data = mujoco.MjData(model)
    parts, half_axes = touching_geoms(model), half_axes_m(model)
    poses = np.empty((len(qpos), elements, 7))
    above_m, centres_m = np.empty((len(qpos), len(parts))), np.empty((len(qpos), 3))
    for frame, position in enumerate(qpos):
        data.qpos[:] = position
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        poses[frame] = np.hstack([data.xpos, data.xquat])[1 : 1 + elements]
        centres, turns = data.geom_xpos[parts], data.geom_xmat[parts]
        above_m[frame] = clearances_m(world, centres, turns, half_axes)
        centres_m[frame] = data.subtree_com[1]
    return poses, above_m < TOUCHING_M, centres_m


def _sample(world: World, centres_m: Array, length_m: float) -> dict[str, Any]:
    """Return the heights of uneven ground around the path of a robot, on a square grid."""
    low, high = (limit(centres_m[:, :2], axis=0) for limit in (np.min, np.max))
    x, y = (
        np.arange(low[axis] - 1.5 * length_m, high[axis] + 1.5 * length_m + _CELL_M, _CELL_M)
        for axis in range(2)
    )
    heights, _ = world.surface(*np.meshgrid(x, y))
    return {
        "x_m": x[0], "y_m": y[0], "cell_m": _CELL_M, "columns": len(x),
        "heights_um": _base64(np.round(1e6 * heights), "<i4"),
    }  # fmt: skip


def _shape(model: mujoco.MjModel, geom: int) -> dict[str, Any]:
    """Describe an ellipsoid with its half axes (columns of a 3x3 matrix), or a capsule with its ends."""
    *rgb, opacity = model.geom_rgba[geom].tolist()
    size = np.where(model.geom_size[geom] > 0, model.geom_size[geom], model.geom_size[geom, 0])
    flat, centre = np.empty(9), model.geom_pos[geom]
    mujoco.mju_quat2Mat(flat, model.geom_quat[geom])
    matrix = flat.reshape(3, 3)
    shape = {
        "element": int(model.geom_bodyid[geom]) - 1, "colour": [round(255 * c) for c in rgb],
        "opacity": opacity, "touching": bool(model.geom_conaffinity[geom]),
    }  # fmt: skip
    if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_CAPSULE:
        along = size[1] * matrix[:, 2]
        return shape | {"ends": [_round(centre - along), _round(centre + along)], "radius": size[0]}
    return shape | {"centre": _round(centre), "axes": [_round(row) for row in matrix * size]}


def _point(model: mujoco.MjModel, site: int) -> list[float]:
    """Return the element of a site, and the site's position in the element."""
    return [int(model.site_bodyid[site]) - 1, *_round(model.site_pos[site])]


def _round(values: Array) -> list[float]:
    rounded: list[float] = np.round(values, 6).tolist()
    return rounded


def _hex(rgb: Array) -> str:
    return "#" + bytes(np.round(255 * rgb).astype(np.uint8)).hex()


def _base64(values: Array | NDArray[np.bool_], kind: str) -> str:
    return base64.b64encode(values.astype(kind).tobytes()).decode()
