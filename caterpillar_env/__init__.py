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
    """Set MUJOCO_GL, which MuJoCo reads when it is imported: off-screen where there is no display."""
    display = os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")
    if sys.platform != "linux" or display or "MUJOCO_GL" in os.environ:
        return
    for backend, library in (("egl", "libEGL.so.1"), ("osmesa", "libOSMesa.so.8")):
        try:
            ctypes.CDLL(library)
        except OSError:
            continue  # MuJoCo would not even import with a backend that is missing
        os.environ["MUJOCO_GL"] = backend
        return


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
