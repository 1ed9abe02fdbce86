"""Choice of the OpenGL backend for off-screen rendering."""

from __future__ import annotations

import os

#: Advice for machines without an off-screen OpenGL backend.
INSTALL_DRAWING = (
    "install EGL (Debian: apt install libegl1 libgl1-mesa-dri), or install OSMesa (libosmesa6) and "
    "export MUJOCO_GL=osmesa"
)


def choose_backend() -> str:
    """Return the rendering backend: MUJOCO_GL if set, else "glfw" with a display and "egl" without."""
    given = os.environ.get("MUJOCO_GL", "").lower().strip()
    has_display = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    return given or ("glfw" if has_display else "egl")
