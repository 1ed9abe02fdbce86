"""A soft caterpillar robot driven by shape-memory-alloy springs, as Gymnasium environments.

Importing this package registers `CaterpillarSMA-v0` (one step is one gait period) and
`CaterpillarSMASwitch-v0` (one step switches every spring on or off), each with a native vector
environment for `gymnasium.make_vec`. Variants in other worlds have `Slope`, `Steps`, `Rough` or
`Patches` in the name, such as `CaterpillarSMA-Rough-v0`.
"""

from importlib import import_module as _import_module
from typing import Any

import gymnasium as _gymnasium

from caterpillar_env.errors import CaterpillarError

for _name, _mode in (("CaterpillarSMA", "timing"), ("CaterpillarSMASwitch", "switch")):
    for _world in ("", "Slope", "Steps", "Rough", "Patches"):
        _id = f"{_name}-{_world}-v0" if _world else f"{_name}-v0"
        if _id not in _gymnasium.registry:
            # No step limit: the environment itself truncates after 30 s, for any length of a step.
            _gymnasium.register(
                id=_id,
                entry_point="caterpillar_env.env:CaterpillarEnv",
                vector_entry_point="caterpillar_env.vector_env:CaterpillarVectorEnv",
                kwargs={"action_mode": _mode} | ({"world": _world.lower()} if _world else {}),
            )

_LAZY = {
    "CaterpillarEnv": "env",
    "CaterpillarVectorEnv": "vector_env",
    "Failure": "task",
    "GaitTimings": "gait",
    "Morphology": "morphology",
    "Outcomes": "robot",
    "PARAMETERS": "morphology",
    "Physics": "physics",
    "Robot": "robot",
    "SmaSpring": "sma",
    "World": "worlds",
    "simulate": "robot",
    "wave_robot": "robot",
}
__all__ = ["CaterpillarError", *_LAZY]


def __getattr__(name: str) -> Any:
    """Import a public name on first access, so that registering the environments stays fast."""
    if name not in _LAZY:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(_import_module(f"{__name__}.{_LAZY[name]}"), name)
