"""Pictures of a robot: springs coloured by temperature, seen by a camera that follows it."""

from __future__ import annotations

import os
import sys
from typing import Any

import mujoco
import numpy as np
from gymnasium.envs.mujoco.mujoco_rendering import MujocoRenderer
from numpy.typing import NDArray

from caterpillar_env.sma import SmaSpring

Array = NDArray[np.float64]

_COLD = np.array([0.25, 0.45, 0.85])
_WARM = np.array([0.95, 0.85, 0.30])
_HOT = np.array([0.90, 0.15, 0.10])


def has_display() -> bool:
    """Whether a window can be opened."""
    return sys.platform != "linux" or bool(
        os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    )


def spring_colours(spring: SmaSpring, temperature_c: Array) -> NDArray[np.float64]:
    """Blue at ambient, yellow where austenite forms (As), red at the cut-off: (n,) to (n, 4)."""
    share = np.interp(
        temperature_c, [spring.ambient_c, spring.austenite_start_c, spring.cut_off_c], [0.0, 0.5, 1.0]
    )[:, None]
    colour = np.where(
        share < 0.5, _COLD + 2 * share * (_WARM - _COLD), _WARM + (2 * share - 1) * (_HOT - _WARM)
    )
    return np.concatenate([colour, np.ones_like(share)], axis=1)


class RobotRenderer:
    """Draws one robot; make a new one when the body changes.

    Args:
        model: the robot; its tendon colours are changed.
        data: a pose of it, whose derived fields are computed here.
        spring: gives the temperatures' meaning.
        width: of a frame, pixels.
        height: of a frame, pixels.
        camera_name: a camera of the model, or None for a free one.
        camera_config: attributes of the free camera.
    """

    def __init__(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        spring: SmaSpring,
        width: int = 640,
        height: int = 480,
        camera_name: str | None = "track",
        camera_config: dict[str, Any] | None = None,
    ) -> None:
        self._model, self._data, self._spring = model, data, spring
        camera: dict[str, Any] = {"camera_name": camera_name}
        if camera_config is not None:
            camera = {"camera_id": -1, "default_cam_config": camera_config}
        self._renderer = MujocoRenderer(model, data, width=width, height=height, **camera)

    def draw(self, qpos: Array, temperature_c: Array, mode: str) -> NDArray[Any] | None:
        """Draw a pose, qpos (nq,), with springs at temperature_c (springs,), in a render mode."""
        self._data.qpos[:] = qpos
        mujoco.mj_forward(self._model, self._data)
        self._model.tendon_rgba[:] = spring_colours(self._spring, temperature_c)
        frame: NDArray[Any] | None = self._renderer.render(mode)
        return frame

    def close(self) -> None:
        """Free the window or the drawing context."""
        self._renderer.close()  # type: ignore[no-untyped-call]
