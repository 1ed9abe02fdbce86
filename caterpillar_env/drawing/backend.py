"""Which library draws. MuJoCo reads MUJOCO_GL when it is imported, so this must not import MuJoCo."""

from __future__ import annotations

import ctypes
import os
import sys

#: What mends most of what keeps a machine from drawing.
INSTALL_DRAWING = "install EGL (Debian: apt install libegl1 libgl1-mesa-dri) or OSMesa (libosmesa6)"


def has_display() -> bool:
    """Whether a window can be opened."""
    return sys.platform != "linux" or bool(
        os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    )


def choose() -> None:
    """Set MUJOCO_GL where there is no display and nobody has set it: to what draws off-screen.

    MuJoCo does not import with a backend whose library is missing, and cannot change it afterwards.
    """
    if has_display() or "MUJOCO_GL" in os.environ:
        return
    egl, osmesa = _library("libEGL.so.1"), _library("libOSMesa.so.8")
    # To try EGL takes 30 ms: only where there is a choice.
    if egl and not (osmesa and not _works(egl)):
        os.environ["MUJOCO_GL"] = "egl"
    else:
        os.environ["MUJOCO_GL"] = "osmesa" if osmesa else "disabled"


def _library(name: str) -> ctypes.CDLL | None:
    try:
        return ctypes.CDLL(name)
    except OSError:
        return None


def _works(egl: ctypes.CDLL) -> bool:
    """Whether any device of EGL can be drawn with, as MuJoCo does: without a display."""
    devices, count = (ctypes.c_void_p * 16)(), ctypes.c_int()
    pointer = ctypes.c_void_p
    egl.eglGetProcAddress.restype = pointer
    egl.eglInitialize.argtypes = [pointer, pointer, pointer]
    addresses = [
        egl.eglGetProcAddress(name) for name in (b"eglQueryDevicesEXT", b"eglGetPlatformDisplayEXT")
    ]
    if not all(addresses):
        return False
    query = ctypes.CFUNCTYPE(ctypes.c_uint, ctypes.c_int, pointer, pointer)(addresses[0])
    display = ctypes.CFUNCTYPE(pointer, ctypes.c_uint, pointer, pointer)(addresses[1])
    if not query(len(devices), ctypes.byref(devices), ctypes.byref(count)):
        return False
    on_a_device = 0x313F  # EGL_PLATFORM_DEVICE_EXT
    found = (display(on_a_device, device, None) for device in devices[: count.value])
    return any(one and egl.eglInitialize(one, None, None) for one in found)
