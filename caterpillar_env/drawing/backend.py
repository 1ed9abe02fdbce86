"""The OpenGL backend of off-screen pictures."""

from __future__ import annotations

import ctypes
import os
import subprocess
import sys

#: Installation advice for machines without an off-screen OpenGL backend.
INSTALL_DRAWING = "install EGL (Debian: apt install libegl1 libgl1-mesa-dri) or OSMesa (libosmesa6)"


def has_display() -> bool:
    """Return whether a window can be opened."""
    return sys.platform != "linux" or bool(
        os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    )


def choose_backend() -> str:
    """Return the name of the backend to draw with: "glfw", "egl", "osmesa" or "disabled".

    The environment variable MUJOCO_GL takes precedence. The default is GLFW with a display; without one
    it is EGL if it works, else OSMesa.
    """
    given = os.environ.get("MUJOCO_GL", "").lower().strip()
    if given or has_display():
        return given or "glfw"
    egl, osmesa = _has_library("libEGL.so.1"), _has_library("libOSMesa.so.8")
    if egl and (not osmesa or _egl_works()):
        return "egl"
    return "osmesa" if osmesa else "disabled"


def _has_library(name: str) -> bool:
    try:
        ctypes.CDLL(name)
    except OSError:
        return False
    return True


def _egl_works() -> bool:
    """Return whether EGL finds a driver.

    This runs in a subprocess, because a process in which EGL has failed cannot switch to OSMesa.
    """
    code = "from mujoco.egl import GLContext; GLContext(1, 1)"
    environment = {**os.environ, "MUJOCO_GL": "egl"}
    return not subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, check=False
    ).returncode
