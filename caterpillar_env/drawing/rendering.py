"""Render robots with springs coloured by temperature, contact marks and a ruler."""

from __future__ import annotations

import os
import warnings
from dataclasses import dataclass
from importlib import import_module

import gymnasium
import mujoco
import numpy as np
from mujoco.rendering.classic import gl_context
from numpy.typing import NDArray

from caterpillar_env.arrays import Array
from caterpillar_env.drawing.overlay import spring_rgb
from caterpillar_env.drawing.scenery import RULER, Camera
from caterpillar_env.errors import CaterpillarError, check_fields
from caterpillar_env.ground import TOUCHING_M, clearances_m, half_axes_m, touching_geoms
from caterpillar_env.model import build_model
from caterpillar_env.morphology import Body, length_m
from caterpillar_env.physics import Physics
from caterpillar_env.task import Crawl

#: Reason for an earlier rendering failure, or None. Retrying can crash the interpreter.
unavailable: str | None = None

_ADVICE = (
    "install EGL (Debian: apt install libegl1 libgl1 libgl1-mesa-dri), or install OSMesa (libosmesa6) "
    "and export MUJOCO_GL=osmesa; see also `caterpillar doctor`"
)
_CONTACT_RGBA = np.array([1.0, 0.55, 0.05, 0.85])
_SPOT_SIZE_M, _SPOT_HEIGHT_M = np.array([0.005, 0.0002, 0.0]), 0.0006  # radius, half height


class RenderingError(CaterpillarError):
    """Rendering is not possible, for example because no OpenGL backend works on this machine."""


def choose_backend() -> str:
    """Return the OpenGL backend: MUJOCO_GL if set, else "glfw" with a display and "egl" without."""
    has_display = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    given = os.environ.get("MUJOCO_GL", "").lower().strip()
    return given or ("glfw" if has_display else "egl")


@dataclass(frozen=True)
class View:
    """Size and camera of an image.

    Raises:
        CaterpillarError: a size is not an integer from 1 to 8192, or the camera does not exist.
    """

    width: int = 640  #: pixels
    height: int = 480  #: pixels
    camera_name: Camera = "track"  #: all cameras follow the robot

    def __post_init__(self) -> None:
        check_fields(self, {"width": (1, 8192), "height": (1, 8192)})


class RobotRenderer:
    """Renders a robot with a fixed body.

    Args:
        body: body of the robot.
        physics: physics of the robot.
        view: size and camera.
        view_length_m: body length that must fit in the image; by default the length of `body`.
    """

    def __init__(
        self,
        body: Body,
        physics: Physics,
        view: View,
        *,
        view_length_m: float | None = None,
    ) -> None:
        self.body = body
        self.model = model = build_model(body, physics)
        self._data = mujoco.MjData(model)
        self._spring = physics.spring
        self._view = view
        if view_length_m is not None:
            model.cam_poscom0[:] *= view_length_m / length_m(body, physics.num_segments)
        model.vis.global_.offwidth, model.vis.global_.offheight = view.width, view.height
        self._option = mujoco.MjvOption()
        self._option.sitegroup[:] = 0  # hide the sites at the springs' ends
        self._parts, self._half_axes = touching_geoms(model), half_axes_m(model)
        self._world = physics.world
        self._ruler = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_GEOM, RULER)  # -1 on uneven ground
        if self._ruler >= 0:
            # Place the ruler's zero at the initial centre of mass, so that it shows the distance.
            model.geom_pos[self._ruler, 0] += self.centre_of_mass(model.qpos0)[0]
        self._canvas: mujoco.Renderer | None = None

    def centre_of_mass(self, qpos: Array) -> Array:
        """Return the centre of mass, m, (3,), in the pose `qpos` (nq,)."""
        self._data.qpos[:] = qpos
        mujoco.mj_forward(self.model, self._data)
        centre: Array = self._data.subtree_com[1].copy()
        return centre

    def draw(self, qpos: Array, temperature_c: Array) -> NDArray[np.uint8]:
        """Return an image of a pose, shape (height, width, 3).

        Args:
            qpos: MuJoCo generalized positions, (nq,).
            temperature_c: spring temperatures, degC, (springs,).

        Raises:
            RenderingError: rendering is not possible on this machine.
        """
        centre = self.centre_of_mass(qpos)
        if self._ruler >= 0:
            self._data.geom_xpos[self._ruler, 1] += centre[1]  # keep the ruler beside the robot
        self.model.tendon_rgba[:, :3] = spring_rgb(self._spring, temperature_c)
        canvas = self._open_canvas()
        canvas.update_scene(self._data, self._view.camera_name, self._option)
        canvas.scene.flags[mujoco.mjtRndFlag.mjRND_FOG] = True
        centres, turns = self._data.geom_xpos[self._parts], self._data.geom_xmat[self._parts]
        above_m = clearances_m(self._world, centres, turns, self._half_axes)
        spots = centres[above_m < TOUCHING_M]
        spots[:, 2] = self._world.surface(spots[:, 0], spots[:, 1])[0] + _SPOT_HEIGHT_M
        for spot in spots:
            _add_spot(canvas.scene, spot)
        frame: NDArray[np.uint8] = canvas.render()
        return frame

    def close(self) -> None:
        """Release the rendering context."""
        if self._canvas is not None:
            self._canvas.close()
        self._canvas = None

    def _open_canvas(self) -> mujoco.Renderer:
        global unavailable
        backend = choose_backend()
        if unavailable is None and self._canvas is None:
            try:
                if backend in ("disable", "disabled", "off", "false", "0"):
                    raise OSError("unset MUJOCO_GL, which disables rendering")
                # MuJoCo selects the context class at import. Replace it by the class of the backend.
                if backend in ("egl", "osmesa"):
                    gl_context.GLContext = import_module(f"mujoco.{backend}").GLContext
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")  # GLFW warns before it fails
                    self._canvas = mujoco.Renderer(self.model, self._view.height, self._view.width)
            except Exception as error:  # the type depends on the backend
                first_line = (str(error).strip() or type(error).__name__).splitlines()[0]
                unavailable = f"{backend}: {first_line}"
        if self._canvas is None:
            raise RenderingError(f"cannot draw ({unavailable}); {_ADVICE}")
        return self._canvas


class Pictures:
    """Renders the rows of a `Crawl`. Each row gets its own renderer when it is first drawn.

    Args:
        crawl: simulation of the robots.
        view: size and camera.
    """

    def __init__(self, crawl: Crawl, view: View) -> None:
        self._crawl, self._view = crawl, view
        self._renderers: dict[int, RobotRenderer] = {}

    def renderer(self, row: int) -> RobotRenderer:
        """Return the renderer for the current body of a row."""
        simulation = self._crawl.simulation
        renderer, body = self._renderers.get(row), simulation.bodies[row]
        if renderer is not None and renderer.body != body:
            renderer.close()
            renderer = None
        if renderer is None:
            renderer = self._renderers[row] = RobotRenderer(body, simulation.physics, self._view)
        return renderer

    def draw(self, row: int) -> NDArray[np.uint8] | None:
        """Return an image of a row, or warn and return None if this machine cannot draw."""
        simulation = self._crawl.simulation
        (temperature_c,) = simulation.state(np.array([row])).temperature_c
        try:
            return self.renderer(row).draw(simulation.qpos(row), temperature_c)
        except RenderingError as error:
            gymnasium.logger.warn(str(error))  # Python shows the same warning once
            return None

    def close(self) -> None:
        """Release all rendering contexts."""
        for renderer in self._renderers.values():
            renderer.close()
        self._renderers.clear()


def _add_spot(scene: mujoco.MjvScene, position: Array) -> None:
    """Mark a contact with the ground."""
    if scene.ngeom < scene.maxgeom:
        mujoco.mjv_initGeom(
            scene.geoms[scene.ngeom], mujoco.mjtGeom.mjGEOM_CYLINDER, _SPOT_SIZE_M,
            position, np.eye(3).ravel(), _CONTACT_RGBA,
        )  # fmt: skip
        scene.ngeom += 1
