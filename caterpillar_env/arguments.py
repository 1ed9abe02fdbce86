"""Arguments of the environments: settings of episodes, bodies and reset options."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any, Literal

import numpy as np

from caterpillar_env.errors import CaterpillarError, check_fields, check_number, show
from caterpillar_env.faults import Faults
from caterpillar_env.gait import MAX_STEPS
from caterpillar_env.morphology import Morphology
from caterpillar_env.physics import Physics
from caterpillar_env.randomization import Randomization
from caterpillar_env.worlds import World

ActionMode = Literal["timing", "phase", "switch"]

_BOUNDS = {
    "action_repeat": (1, MAX_STEPS),  # gait periods, or control intervals in switch mode
    "max_episode_steps": (1, MAX_STEPS),
    "forward_reward_weight": (0.0, 1e9),
    "ctrl_cost_weight": (0.0, 1e9),
    "failure_cost": (0.0, 1e9),
    "reset_noise_scale": (0.0, 1000.0),
    "goal_heading_rad": (-0.7, 0.7),  # within the limit of `Failure.VEERED`
}


@dataclass(frozen=True, kw_only=True)
class EpisodeConfig:
    """Settings of episodes. For their descriptions, see the arguments of `CaterpillarEnv`.

    Raises:
        CaterpillarError: a setting has the wrong type or is out of range.
    """

    physics: Physics
    action_mode: ActionMode
    symmetric: bool
    gait_period_s: float
    action_repeat: int
    episode_s: float
    max_episode_steps: int | None
    forward_reward_weight: float
    ctrl_cost_weight: float
    failure_cost: float
    reset_noise_scale: float
    goal_heading_rad: float
    randomization: Randomization | None
    faults: Faults | None
    terminate_on_failure: bool

    def __post_init__(self) -> None:
        check_fields(self, _BOUNDS)
        if self.action_mode == "switch" and not self.symmetric:
            raise CaterpillarError(
                "symmetric = False needs action_mode 'timing' or 'phase'; in switch mode, an action "
                "always has a value for each spring"
            )
        if self.randomization is not None:
            self.randomization.check(self.physics)
        if self.faults is not None and self.faults.springs > self.physics.num_springs:
            raise CaterpillarError(
                f"faults.springs = {self.faults.springs} must be at most the number of springs, "
                f"{self.physics.num_springs}"
            )

    @classmethod
    def of(cls, arguments: Mapping[str, Any]) -> EpisodeConfig:
        """Create the settings from the keyword arguments of an environment."""
        chosen: dict[str, Any] = {f.name: arguments.get(f.name) for f in fields(cls)}
        chosen["physics"] = Physics.of(chosen["physics"])
        if (world := arguments.get("world")) is not None:
            chosen["physics"] = replace(chosen["physics"], world=World.of(world))
        chosen["randomization"] = Randomization.of(chosen["randomization"])
        chosen["faults"] = Faults.of(chosen["faults"])
        return cls(**chosen)


def read_morphologies(value: Any, num_envs: int) -> list[Morphology]:
    """Return the bodies of `num_envs` robots.

    Args:
        value: one body for all robots (as for `Morphology.of`), a sequence of bodies, or an array of
            shape (num_envs, 8).
        num_envs: number of robots.

    Raises:
        CaterpillarError: a body is invalid, or the number of bodies is wrong.
    """
    check_number("num_envs", num_envs, 1, whole=True)
    if not isinstance(value, (Morphology, Mapping, Sequence)):
        try:
            value = np.atleast_1d(value)
        except ValueError:
            value = [value]
    if isinstance(value, (Morphology, Mapping)) or (len(value) and np.isscalar(value[0])):
        return [Morphology.of(value)] * num_envs
    if len(value) != num_envs:
        raise CaterpillarError(
            f"morphology must be one body for all robots, a list of {num_envs} bodies, or an array of "
            f"shape ({num_envs}, 8); got {len(value)} bodies"
        )
    return [Morphology.of(v) for v in value]


def check_options(options: Mapping[str, Any] | None, known: tuple[str, ...]) -> dict[str, Any]:
    """Return the reset options as a new dict.

    Raises:
        CaterpillarError: a key is not in `known`.
    """
    chosen = {} if options is None else options
    if not isinstance(chosen, Mapping) or set(chosen) - set(known):
        got = sorted(map(str, set(chosen) - set(known))) if isinstance(chosen, Mapping) else show(chosen)
        raise CaterpillarError(
            f"options of reset() must be a mapping with keys from {', '.join(known)}; got {got}"
        )
    return dict(chosen)


def check_render_mode(value: Any) -> None:
    """Raise a `CaterpillarError` unless `value` is a render mode of the environments."""
    if not (value is None or (isinstance(value, str) and value == "rgb_array")):
        raise CaterpillarError(f'render_mode must be None or "rgb_array"; got {show(value)}')
