"""A soft caterpillar robot driven by shape-memory-alloy springs, as Gymnasium environments.

Importing this package registers `CaterpillarSMA-v0` (one step is one gait period) and
`CaterpillarSMASwitch-v0` (one step switches every spring on or off), each with a native vector
environment for `gymnasium.make_vec`.
"""

import ctypes
import os
import sys
from typing import Any


def _choose_drawing_backend() -> None:
    """Set MUJOCO_GL, which MuJoCo reads when it is imported: off-screen where there is no display.

    MuJoCo does not import with a backend whose library is missing, and cannot change it afterwards.
    """
    display = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    if sys.platform != "linux" or display or "MUJOCO_GL" in os.environ:
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


_choose_drawing_backend()

import gymnasium as _gymnasium

from caterpillar_env.errors import (
    CaterpillarError,
    MorphologyError,
    PhysicsError,
    SimulationError,
    TimingError,
)

__all__ = [
    "CaterpillarEnv",
    "CaterpillarError",
    "CaterpillarVectorEnv",
    "GaitTimings",
    "Morphology",
    "MorphologyError",
    "Physics",
    "PhysicsError",
    "SimulationError",
    "SmaSpring",
    "TimingError",
]

for _id, _mode in (("CaterpillarSMA-v0", "timing"), ("CaterpillarSMASwitch-v0", "switch")):
    if _id not in _gymnasium.registry:
        # No step limit here: the environment ends its own 30 s, whatever the length of a step.
        _gymnasium.register(
            id=_id,
            entry_point="caterpillar_env.env:CaterpillarEnv",
            vector_entry_point="caterpillar_env.vector_env:CaterpillarVectorEnv",
            kwargs={"action_mode": _mode},
        )

_LAZY = {
    "CaterpillarEnv": "env",
    "CaterpillarVectorEnv": "vector_env",
    "GaitTimings": "gait",
    "Morphology": "morphology",
    "Physics": "model",
    "SmaSpring": "sma",
}


def __getattr__(name: str) -> Any:
    """Import the public classes when they are first asked for, so that registering stays quick."""
    if name not in _LAZY:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from importlib import import_module

    return getattr(import_module(f"{__name__}.{_LAZY[name]}"), name)
