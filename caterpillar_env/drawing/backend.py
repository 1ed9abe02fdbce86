"""Choice of the OpenGL backend for off-screen rendering."""

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
    """Return the name of the rendering backend: "glfw", "egl", "osmesa" or "disabled".

    The environment variable MUJOCO_GL takes precedence. Otherwise the backend is GLFW if a display is
    available, EGL if it works, or OSMesa.
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

    The test runs in a subprocess, because a process cannot switch to OSMesa after EGL has failed.
    """
    code = "from mujoco.egl import GLContext; GLContext(1, 1)"
    environment = {**os.environ, "MUJOCO_GL": "egl"}
    return not subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, check=False
    ).returncode
