"""Pictures of a robot: springs coloured by temperature, feet that touch the ground marked, a ruler."""

from __future__ import annotations

import os
import warnings
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache
from itertools import pairwise
from typing import Any, TypeVar

import glfw
import gymnasium
import mujoco
import numpy as np
from gymnasium.envs.mujoco.mujoco_rendering import MujocoRenderer
from numpy.typing import NDArray

from caterpillar_env.arrays import Array
from caterpillar_env.drawing.backend import INSTALL_DRAWING
from caterpillar_env.drawing.overlay import CONTACT_RGB, PATH_RGB, Readout, annotate, spring_rgb
from caterpillar_env.drawing.scenery import CAMERAS, RULER
from caterpillar_env.errors import CaterpillarError
from caterpillar_env.ground import clearances_m, half_axes_m, touching_geoms
from caterpillar_env.sma import SmaSpring

T = TypeVar("T")

#: What kept the first picture from being drawn; to try a broken backend again may end the process.
_why_not: str | None = None

_CONTACT_RGBA = np.array([*CONTACT_RGB, 0.85])
_PATH_RGBA = np.array([*PATH_RGB, 1.0])
_CONTACT_SIZE_M = np.array([0.005, 0.0002, 0.0])  # radius and half thickness of the spot
_TOUCHING_M = 1e-4
_PATH_WIDTH_M = 0.0008
_PATH_STEP_M = 0.002


class RenderingError(CaterpillarError):
    """Nothing can be drawn here, or not as asked."""


def drawn(draw: Callable[[], T]) -> T | None:
    """What `draw` gives; None where this machine cannot draw, which is warned of once."""
    try:
        return draw()
    except RenderingError as error:
        _warn(str(error))
        return None


@cache
def _warn(text: str) -> None:
    gymnasium.logger.warn(text)


@dataclass(frozen=True)
class View:
    """What a picture shows.

    Raises:
        RenderingError: a size that is no positive whole number, or a camera that does not exist.
    """

    width: int = 640  #: pixels
    height: int = 480  #: pixels
    camera_name: str | None = "track"  #: one of `scenery.CAMERAS`; None for a free one
    camera_config: dict[str, Any] | None = None  #: attributes of the free camera

    def __post_init__(self) -> None:
        for name in ("width", "height"):
            value = getattr(self, name)
            if not isinstance(value, (int, np.integer)) or not 1 <= value <= 8192:
                raise RenderingError(f"{name} must be a number of pixels from 1 to 8192; got {value!r}")
        if self.camera_name is not None and self.camera_name not in CAMERAS:
            raise RenderingError(
                f"camera_name must be None or one of {', '.join(CAMERAS)}; got {self.camera_name!r}"
            )


def _mend() -> str:
    if os.environ.get("MUJOCO_GL", "disabled") in ("disabled", "osmesa", "egl"):
        return f"{INSTALL_DRAWING}; `caterpillar doctor` tells more"
    return "to draw without a display, export MUJOCO_GL=egl; `caterpillar doctor` tells more"


class RobotRenderer:
    """Draws one robot; make a new one when the body changes.

    Args:
        model: the robot with scenery; its colours and the ruler's place are changed.
        data: a pose of it, whose derived fields are computed here.
        spring: gives the temperatures' meaning.
        view: size and camera.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        spring: SmaSpring,
        view: View | None = None,
    ) -> None:
        self._model, self._data, self._spring = model, data, spring
        self._view = view = view or View()
        model.vis.global_.offwidth, model.vis.global_.offheight = view.width, view.height
        if view.camera_config is not None or view.camera_name is None:
            self._camera: str | mujoco.MjvCamera = mujoco.MjvCamera()
            mujoco.mjv_defaultFreeCamera(model, self._camera)
            for key, value in (view.camera_config or {}).items():
                if np.ndim(value):
                    getattr(self._camera, key)[:] = value
                else:
                    setattr(self._camera, key, value)
        else:
            self._camera = view.camera_name
        self._option = mujoco.MjvOption()
        self._option.sitegroup[:] = 0  # the springs show their ends
        names = [model.geom(i).name for i in range(model.ngeom)]
        self._feet = np.array([i for i, name in enumerate(names) if name.startswith("foot")])
        self._parts, self._half_axes = touching_geoms(model), half_axes_m(model)
        self._foot_rgba = model.geom_rgba[self._feet].copy()
        self._ruler = model.geom(RULER).id
        # Its zero is where the centre of mass starts: it then reads the distance.
        model.geom_pos[self._ruler, 0] += self.centre_of_mass(model.qpos0)[0]
        self._path: list[Array] = []
        self._picture: mujoco.Renderer | None = None
        self._window: MujocoRenderer | None = None

    def centre_of_mass(self, qpos: Array) -> Array:
        """Of the whole robot in a pose qpos (nq,): x, y and z in m, (3,)."""
        self._data.qpos[:] = qpos
        mujoco.mj_forward(self._model, self._data)
        middle: Array = self._data.subtree_com[1].copy()
        return middle

    def forget_path(self) -> None:
        """Begin the path anew: another episode."""
        self._path = []

    def draw(
        self, qpos: Array, temperature_c: Array, mode: str, readout: Readout | None = None
    ) -> NDArray[Any] | None:
        """Draw a pose.

        Args:
            qpos: MuJoCo generalised positions, (nq,).
            temperature_c: of the springs, (springs,).
            mode: "rgb_array", "depth_array" or "human".
            readout: written on a colour picture, with a legend and the path of the centre of mass
                through all poses that were drawn so.

        Returns:
            (height, width, 3) uint8; in depth mode (height, width) float32, m along the view; None for a
            window.

        Raises:
            RenderingError: no way of drawing works on this machine.
        """
        middle = self.centre_of_mass(qpos)
        self._data.geom_xpos[self._ruler, 1] += middle[1]  # it stays beside a robot that veers
        touching = self._touching()
        self._model.tendon_rgba[:, :3] = spring_rgb(self._spring, temperature_c)
        self._model.geom_rgba[self._feet] = self._foot_rgba
        self._model.geom_rgba[np.intersect1d(self._feet, touching), :3] = CONTACT_RGB
        if mode == "human":
            self._show()
            return None
        picture = self._ready()
        picture.update_scene(self._data, self._camera, self._option)
        if mode == "depth_array":
            picture.enable_depth_rendering()
            depth: NDArray[Any] = picture.render()
            picture.disable_depth_rendering()
            return depth
        picture.scene.flags[mujoco.mjtRndFlag.mjRND_FOG] = True
        for position in self._data.geom_xpos[touching]:
            self._add_spot(picture.scene, position)
        if readout is not None:
            if not self._path or np.hypot(*(middle - self._path[-1])[:2]) > _PATH_STEP_M:
                self._path.append(middle)
            self._add_path(picture.scene, [*self._path, middle])
        frame: NDArray[np.uint8] = picture.render()
        return frame if readout is None else annotate(frame, readout, self._spring)

    def close(self) -> None:
        """Free the window or the drawing context."""
        if self._picture is not None:
            self._picture.close()
        if self._window is not None:
            self._window.close()  # type: ignore[no-untyped-call]
        self._picture = self._window = None

    def _touching(self) -> NDArray[np.intp]:
        """Feet and shells that touch the ground, (n,). Straight at the start they only just do."""
        above_m = clearances_m(
            self._data.geom_xpos[self._parts], self._data.geom_xmat[self._parts], self._half_axes
        )
        touching: NDArray[np.intp] = self._parts[above_m < _TOUCHING_M]
        return touching

    def _ready(self) -> mujoco.Renderer:
        global _why_not
        if _why_not is None and self._picture is None:
            try:
                with warnings.catch_warnings():
                    warnings.simplefilter("ignore")  # of GLFW, before it fails
                    self._picture = mujoco.Renderer(self._model, self._view.height, self._view.width)
            except Exception as error:  # whatever the drawing backend raises
                _why_not = f"MUJOCO_GL={os.environ.get('MUJOCO_GL', '')}: {_first_line(error)}"
        if self._picture is None:
            raise RenderingError(f"cannot draw ({_why_not}); {_mend()}")
        return self._picture

    def _show(self) -> None:
        if self._window is None:
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
                self._model, self._data, width=view.width, height=view.height, **camera
            )
        self._window.render("human")

    @staticmethod
    def _add_spot(scene: mujoco.MjvScene, position: Array) -> None:
        scene.ngeom += 1
        mujoco.mjv_initGeom(
            scene.geoms[scene.ngeom - 1], mujoco.mjtGeom.mjGEOM_CYLINDER, _CONTACT_SIZE_M,
            np.array([position[0], position[1], 0.0006]), np.eye(3).ravel(), _CONTACT_RGBA,
        )  # fmt: skip

    @staticmethod
    def _add_path(scene: mujoco.MjvScene, path: list[Array]) -> None:
        nothing = np.zeros(3)
        for start, end in pairwise(path):
            if scene.ngeom == scene.maxgeom:
                return
            geom = scene.geoms[scene.ngeom]
            mujoco.mjv_initGeom(
                geom, mujoco.mjtGeom.mjGEOM_CYLINDER, nothing, nothing, np.eye(3).ravel(), _PATH_RGBA
            )
            mujoco.mjv_connector(
                geom, mujoco.mjtGeom.mjGEOM_CYLINDER, _PATH_WIDTH_M,
                np.array([*start[:2], 0.001]), np.array([*end[:2], 0.001]),
            )  # fmt: skip
            scene.ngeom += 1


def _first_line(error: Exception) -> str:
    text = str(error).strip()
    return text.splitlines()[0] if text else type(error).__name__
