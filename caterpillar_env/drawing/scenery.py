"""Light, ground texture, ruler and cameras for rendering. They do not affect the physics."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import lru_cache
from typing import Any, Literal

import mujoco
import numpy as np

from caterpillar_env.arrays import Array
from caterpillar_env.morphology import Morphology, length_m

#: Cameras that follow the robot, with an oblique view, a side view and a top view.
Camera = Literal["track", "side", "top"]
RULER = "ruler"

_RULER_CM = (-50, 150)
_RULER_WIDTH_CM = 1.6
_RULER_Y_M = -0.045
_PIXELS_PER_CM = 32
_SKY, _HORIZON = [0.80, 0.87, 0.93], [0.93, 0.95, 0.96]

#: Camera positions relative to the centre of mass, in body lengths, and camera x and y axes.
_VIEWS: dict[Camera, tuple[list[float], list[float]]] = {
    "track": ([0.0, -1.55, 0.85], [1, 0, 0, 0, 0.48, 0.877]),
    "side": ([0.0, -1.75, 0.42], [1, 0, 0, 0, 0.233, 0.972]),
    "top": ([0.0, 0.0, 2.0], [1, 0, 0, 0, 1, 0]),
}


def add_scenery(spec: mujoco.MjSpec, ground: Sequence[mujoco.MjsGeom], *, level: bool) -> None:
    """Add light, sky, a ground texture with 2 cm squares, and on level ground a ruler along x."""
    spec.visual.headlight.ambient = [0.45, 0.45, 0.45]
    spec.visual.headlight.diffuse = [0.25, 0.25, 0.25]
    spec.visual.map.znear = 0.02
    spec.visual.map.fogstart, spec.visual.map.fogend = 1.2, 3.5
    spec.visual.rgba.fog = [*_HORIZON, 1.0]
    spec.visual.quality.shadowsize = 1024
    spec.visual.quality.offsamples = 0  # antialiasing would double the drawing time
    spec.visual.quality.numslices, spec.visual.quality.numstacks = 14, 9
    spec.stat.extent, spec.stat.center = 0.3, [0, 0, 0.02]
    spec.add_texture(
        name="sky", type=mujoco.mjtTexture.mjTEXTURE_SKYBOX, width=64, height=64,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT, rgb1=_SKY, rgb2=_HORIZON,
    )  # fmt: skip
    spec.add_texture(
        name="squares", type=mujoco.mjtTexture.mjTEXTURE_2D, width=128, height=128,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER, rgb1=[0.70, 0.73, 0.72], rgb2=[0.76, 0.79, 0.78],
    )  # fmt: skip
    # On an infinite plane the squares are twice as large as `texrepeat` specifies.
    _add_material(spec, "squares", specular=0.0, texuniform=True, texrepeat=[50, 50])
    spec.add_material(name="tile", specular=0.0)
    for geom in ground:  # the colour of a tile shows its friction
        geom.material = "tile" if level and len(ground) > 1 else "squares"
    spec.worldbody.add_light(
        pos=[0, -0.3, 1.0], dir=[0, 0.3, -1], type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        castshadow=True, diffuse=[0.45, 0.45, 0.45],
    )  # fmt: skip
    if level:
        _add_ruler(spec)


def add_cameras(
    head: mujoco.MjsBody,
    segments: Sequence[Morphology],
    up: tuple[float, float, float],
    make: Callable[..., Any],
) -> None:
    """Add the cameras by calling `make`, at distances that keep the whole body in view.

    The cameras are rotated from z to the direction `up`, so that images show how steep a slope is.
    """
    turn = rotation_to(up)
    long_m = length_m(tuple(segments), len(segments))
    middle_m = segments[0].segment_length_m / 4 - long_m / 2
    for name, (position, axes) in _VIEWS.items():
        x, y, z = turn @ position
        make(
            head.add_camera,
            {
                "name": name, "mode": mujoco.mjtCamLight.mjCAMLIGHT_TRACKCOM, "fovy": 40,
                "xyaxes": (np.reshape(axes, (2, 3)) @ turn.T).ravel().tolist(),
            },
            pos=[middle_m + x * long_m, y * long_m, z * long_m],
        )  # fmt: skip


def rotation_to(up: tuple[float, float, float]) -> Array:
    """Return the matrix of the smallest rotation from z to a unit vector, (3, 3)."""
    x, y, z = up
    cross = np.array([[0.0, 0.0, x], [0.0, 0.0, y], [-x, -y, 0.0]])
    rotation: Array = np.eye(3) + cross + cross @ cross / (1.0 + z)
    return rotation


def remove_ruler_picture(spec: mujoco.MjSpec) -> None:
    """Replace the ruler's image by 1 cm squares, because MJCF cannot store the image."""
    first, last = _RULER_CM
    texture = spec.texture(RULER)
    if texture is None:  # uneven ground
        return
    texture.data, texture.width, texture.height = b"", 64, 64
    texture.builtin = mujoco.mjtBuiltin.mjBUILTIN_CHECKER
    texture.rgb1, texture.rgb2 = [0.98, 0.96, 0.84], [0.35, 0.35, 0.33]
    spec.material(RULER).texrepeat = [(last - first) / 2, 1]


def _add_material(spec: mujoco.MjSpec, texture: str, **kwargs: Any) -> None:
    material = spec.add_material(name=texture, **kwargs)
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = texture


def _add_ruler(spec: mujoco.MjSpec) -> None:
    """Add the ruler. The renderer moves the zero mark to the initial centre of mass of the robot."""
    first, last = _RULER_CM
    width, height, pixels = _ruler_picture()
    texture = spec.add_texture(
        name=RULER, type=mujoco.mjtTexture.mjTEXTURE_2D, width=width, height=height, nchannel=3,
    )  # fmt: skip
    texture.data = pixels
    _add_material(spec, RULER, specular=0.0)
    spec.worldbody.add_geom(
        name=RULER, type=mujoco.mjtGeom.mjGEOM_PLANE, material=RULER, contype=0, conaffinity=0,
        size=[(last - first) / 200, _RULER_WIDTH_CM / 200, 0.05],
        pos=[(first + last) / 200, _RULER_Y_M, 0.0003],
    )  # fmt: skip


@lru_cache(maxsize=1)
def _ruler_picture() -> tuple[int, int, bytes]:
    """Return width, height and RGB bytes of the ruler, with ticks every 1 cm and labels every 5 cm."""
    from PIL import Image, ImageDraw, ImageFont  # not needed without scenery

    first, last = _RULER_CM
    width, height = (last - first) * _PIXELS_PER_CM, round(_RULER_WIDTH_CM * _PIXELS_PER_CM)
    image = Image.new("RGB", (width, height), (250, 244, 214))
    draw = ImageDraw.Draw(image)
    font = ImageFont.load_default(0.55 * height)
    ink = (40, 40, 40)
    draw.rectangle((0, 0, width - 1, height - 1), outline=ink)
    for cm in range(first + 1, last):
        x = (cm - first) * _PIXELS_PER_CM
        fifth = cm % 5 == 0
        draw.line((x, 0, x, height * (0.4 if fifth else 0.22)), fill=ink, width=3 if fifth else 2)
        if fifth:
            draw.text((x, 0.94 * height), f"{cm} cm", fill=ink, font=font, anchor="ms")
    return width, height, image.tobytes()
