"""A soft caterpillar robot driven by shape-memory-alloy springs, as Gymnasium environments.

Importing this package registers `CaterpillarSMA-v0` (one step is one gait period) and
`CaterpillarSMASwitch-v0` (one step switches every spring on or off), each with a native vector
environment for `gymnasium.make_vec`. Variants in other worlds have `Slope`, `Steps`, `Rough` or
`Patches` in the name, such as `CaterpillarSMA-Rough-v0`.
"""

from importlib import import_module as _import_module
from typing import TYPE_CHECKING, Any

import gymnasium as _gymnasium

from caterpillar_env.errors import CaterpillarError

if TYPE_CHECKING:
    from caterpillar_env.env import CaterpillarEnv as CaterpillarEnv
    from caterpillar_env.gait import GaitTimings as GaitTimings
    from caterpillar_env.morphology import PARAMETERS as PARAMETERS
    from caterpillar_env.morphology import Morphology as Morphology
    from caterpillar_env.physics import Physics as Physics
    from caterpillar_env.robot import Outcomes as Outcomes
    from caterpillar_env.robot import Robot as Robot
    from caterpillar_env.robot import simulate as simulate
    from caterpillar_env.robot import wave_robot as wave_robot
    from caterpillar_env.sma import SmaSpring as SmaSpring
    from caterpillar_env.task import Failure as Failure
    from caterpillar_env.vector_env import CaterpillarVectorEnv as CaterpillarVectorEnv
    from caterpillar_env.worlds import World as World

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

_MODULES = {
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
__all__ = ["CaterpillarError", *_MODULES]


def __getattr__(name: str) -> Any:
    """Import a public name on first access, so that registering the environments stays fast."""
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(_import_module(f"{__name__}.{_MODULES[name]}"), name)
