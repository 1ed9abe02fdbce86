"""Render robots with springs coloured by temperature, contact marks and a ruler."""

from __future__ import annotations

import os
import warnings
from dataclasses import dataclass
from functools import cache
from importlib import import_module
from itertools import pairwise
from typing import Any

import gymnasium
import mujoco
import numpy as np
from mujoco.rendering.classic import gl_context
from numpy.typing import NDArray

from caterpillar_env.arrays import Array
from caterpillar_env.drawing.backend import INSTALL_DRAWING, choose_backend
from caterpillar_env.drawing.overlay import CONTACT_RGB, PATH_RGB, Readout, annotate, spring_rgb
from caterpillar_env.drawing.scenery import CAMERAS, RULER
from caterpillar_env.errors import CaterpillarError
from caterpillar_env.ground import clearances_m, half_axes_m, touching_geoms
from caterpillar_env.model import build_model
from caterpillar_env.morphology import Body, length_m, segments_of
from caterpillar_env.physics import Physics
from caterpillar_env.task import Crawl, label

Point = tuple[float, float, float]

#: Reason of an earlier rendering failure, or None. Retrying can crash the interpreter.
unavailable: str | None = None

_CONTACT_RGBA = np.array([*CONTACT_RGB, 0.85])
_PATH_RGBA = np.array([*PATH_RGB, 1.0])
_SPOT_RADIUS_M, _SPOT_BOTTOM_M, _SPOT_TOP_M = 0.005, 0.0004, 0.0008
_TOUCHING_M = 1e-4
_PATH_RADIUS_M, _PATH_HEIGHT_M = 0.0008, 0.001
_PATH_STEP_M = 0.002


class RenderingError(CaterpillarError):
    """No OpenGL backend works on this machine, or the requested size or camera is invalid."""


@dataclass(frozen=True)
class View:
    """Size and camera of an image.

    Raises:
        RenderingError: a size is not a positive integer, or the camera does not exist.
    """

    width: int = 640  #: pixels
    height: int = 480  #: pixels
    camera_name: str | None = "track"  #: one of `scenery.CAMERAS`, or None for a free camera
    camera_config: dict[str, Any] | None = None  #: attributes of the free camera

    def __post_init__(self) -> None:
        for name in ("width", "height"):
            value = getattr(self, name)
            if not isinstance(value, (int, np.integer)) or not 1 <= value <= 8192:
                raise RenderingError(f"{name} must be an integer from 1 to 8192 (pixels); got {value!r}")
        if self.camera_name is not None and self.camera_name not in CAMERAS:
            raise RenderingError(
                f"camera_name must be None or one of {', '.join(CAMERAS)}; got {self.camera_name!r}"
            )


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
        view: View | None = None,
        *,
        view_length_m: float | None = None,
    ) -> None:
        self.body = body
        self.model = model = build_model(body, physics)
        self._data = mujoco.MjData(model)
        self._spring = physics.spring
        self._view = view = view or View()
        if view_length_m is not None:
            model.cam_poscom0[:] *= view_length_m / length_m(segments_of(body, physics.num_segments))
        model.vis.global_.offwidth, model.vis.global_.offheight = view.width, view.height
        if view.camera_config is not None or view.camera_name is None:
            self._camera: str | mujoco.MjvCamera = mujoco.MjvCamera()
            mujoco.mjv_defaultFreeCamera(model, self._camera)
            for key, value in (view.camera_config or {}).items():
                setattr(self._camera, key, value)
        else:
            self._camera = view.camera_name
        self._option = mujoco.MjvOption()
        self._option.sitegroup[:] = 0  # hide the sites at the springs' ends
        names = [model.geom(i).name for i in range(model.ngeom)]
        self._feet = np.array([i for i, name in enumerate(names) if name.startswith("foot")])
        self._parts, self._half_axes = touching_geoms(model), half_axes_m(model)
        self._foot_rgba = model.geom_rgba[self._feet].copy()
        self._ruler = model.geom(RULER).id
        # Place the zero of the ruler at the initial centre of mass, so that it shows the distance.
        model.geom_pos[self._ruler, 0] += self.centre_of_mass(model.qpos0)[0]
        self.path: list[Array] = []  #: positions of the centre of mass, m, (3,) each
        self._canvas: mujoco.Renderer | None = None
        self._window: Any = None

    def centre_of_mass(self, qpos: Array) -> Array:
        """Return the centre of mass, m, (3,), in the pose `qpos` (nq,)."""
        self._data.qpos[:] = qpos
        mujoco.mj_forward(self.model, self._data)
        centre: Array = self._data.subtree_com[1].copy()
        return centre

    def draw(
        self, qpos: Array, temperature_c: Array, mode: str, readout: Readout | None = None
    ) -> NDArray[Any] | None:
        """Draw a pose.

        Args:
            qpos: MuJoCo generalized positions, (nq,).
            temperature_c: spring temperatures, degC, (springs,).
            mode: "rgb_array", "depth_array" or "human".
            readout: values to write on a colour image. The image then also shows a legend and the path
                of the centre of mass since `path` was cleared.

        Returns:
            An image (height, width, 3), uint8; in depth mode distances (height, width), m, float32;
            None in human mode.

        Raises:
            RenderingError: rendering is not possible on this machine.
        """
        centre = self.centre_of_mass(qpos)
        self._data.geom_xpos[self._ruler, 1] += centre[1]  # keep the ruler beside the robot
        above_m = clearances_m(
            self._data.geom_xpos[self._parts], self._data.geom_xmat[self._parts], self._half_axes
        )
        touching = self._parts[above_m < _TOUCHING_M]
        self.model.tendon_rgba[:, :3] = spring_rgb(self._spring, temperature_c)
        self.model.geom_rgba[self._feet] = self._foot_rgba
        self.model.geom_rgba[np.intersect1d(self._feet, touching), :3] = CONTACT_RGB
        if mode == "human":
            self._show()
            return None
        canvas = self._open_canvas()
        canvas.update_scene(self._data, self._camera, self._option)
        if mode == "depth_array":
            canvas.enable_depth_rendering()
            depth: NDArray[Any] = canvas.render()
            canvas.disable_depth_rendering()
            return depth
        canvas.scene.flags[mujoco.mjtRndFlag.mjRND_FOG] = True
        for x, y, _ in self._data.geom_xpos[touching]:
            ends = (x, y, _SPOT_BOTTOM_M), (x, y, _SPOT_TOP_M)
            _add_cylinder(canvas.scene, *ends, _SPOT_RADIUS_M, _CONTACT_RGBA)
        if readout is not None:
            if not self.path or np.hypot(*(centre - self.path[-1])[:2]) > _PATH_STEP_M:
                self.path.append(centre)
            for (x, y, _), (next_x, next_y, _) in pairwise([*self.path, centre]):
                ends = (x, y, _PATH_HEIGHT_M), (next_x, next_y, _PATH_HEIGHT_M)
                _add_cylinder(canvas.scene, *ends, _PATH_RADIUS_M, _PATH_RGBA)
        frame: NDArray[np.uint8] = canvas.render()
        return frame if readout is None else annotate(frame, readout, self._spring)

    def close(self) -> None:
        """Release the window and the rendering context."""
        if self._canvas is not None:
            self._canvas.close()
        if self._window is not None:
            self._window.close()
        self._canvas = self._window = None

    def _open_canvas(self) -> mujoco.Renderer:
        global unavailable
        backend = choose_backend()
        if unavailable is None and self._canvas is None:
            try:
                if backend == "disabled":
                    raise OSError("MUJOCO_GL disables it, or neither EGL nor OSMesa is installed")
                # MuJoCo selects the context class at import. Replace it by that of the chosen backend.
                if backend in ("egl", "osmesa"):
                    gl_context.GLContext = import_module(f"mujoco.{backend}").GLContext
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")  # GLFW warns before it fails
                    self._canvas = mujoco.Renderer(self.model, self._view.height, self._view.width)
            except Exception as error:  # the type depends on the backend
                unavailable = f"{backend}: {_first_line(error)}"
        if self._canvas is None:
            fix = INSTALL_DRAWING
            if backend not in ("egl", "osmesa", "disabled"):
                fix = "to draw without a display, export MUJOCO_GL=egl"
            raise RenderingError(f"cannot draw ({unavailable}); {fix}; see also `caterpillar doctor`")
        return self._canvas

    def _show(self) -> None:
        if self._window is None:
            import glfw
            from gymnasium.envs.mujoco.mujoco_rendering import MujocoRenderer

            if not glfw.init():
                raise RenderingError(
                    f"cannot open a window on display {os.environ.get('DISPLAY', '')!r}; draw with "
                    'render_mode="rgb_array" instead'
                )
            view = self._view
            camera: dict[str, Any] = {"camera_id": -1, "default_cam_config": view.camera_config}
            if isinstance(self._camera, str):
                camera = {"camera_name": self._camera}
            self._window = MujocoRenderer(
                self.model, self._data, width=view.width, height=view.height, **camera
            )
        self._window.render("human")


class Pictures:
    """Renders the rows of a `Crawl`. Each row gets its own renderer when it is first drawn.

    Args:
        crawl: simulation of the robots.
        view: size and camera.
        overlay: whether colour images show time, distance, energy and path.
    """

    def __init__(self, crawl: Crawl, view: View, *, overlay: bool) -> None:
        self._crawl, self._view, self._overlay = crawl, view, overlay
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

    def draw(self, row: int, mode: str) -> NDArray[Any] | None:
        """Draw the current state of a row; see `RobotRenderer.draw`.

        If rendering is not possible on this machine, warn once and return None.
        """
        simulation, rows = self._crawl.simulation, np.array([row])
        now = self._crawl.progress(rows)
        readout = Readout(now.time_s[0], now.distance_m[0], now.energy_j[0], label(now.failure[0]))
        (temperature_c,) = simulation.state(rows).temperature_c
        try:
            return self.renderer(row).draw(
                simulation.qpos(row), temperature_c, mode, readout if self._overlay else None
            )
        except RenderingError as error:
            warn_once(str(error))
            return None

    def restart(self, row: int) -> None:
        """Clear the path of a row at the start of an episode."""
        if row in self._renderers:
            self._renderers[row].path.clear()

    def close(self) -> None:
        """Release all windows and rendering contexts."""
        for renderer in self._renderers.values():
            renderer.close()
        self._renderers.clear()


@cache
def warn_once(text: str) -> None:
    """Log a warning once per text."""
    gymnasium.logger.warn(text)


def _add_cylinder(
    scene: mujoco.MjvScene, start: Point, end: Point, radius_m: float, rgba: Array
) -> None:
    if scene.ngeom == scene.maxgeom:
        return
    geom, kind, zeros = scene.geoms[scene.ngeom], mujoco.mjtGeom.mjGEOM_CYLINDER, np.zeros(3)
    mujoco.mjv_initGeom(geom, kind, zeros, zeros, np.eye(3).ravel(), rgba)
    mujoco.mjv_connector(geom, kind, radius_m, np.array(start), np.array(end))
    scene.ngeom += 1


def _first_line(error: Exception) -> str:
    return (str(error).strip().splitlines() or [type(error).__name__])[0]
