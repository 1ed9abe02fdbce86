"""Arguments of the environments: settings of episodes, bodies and reset options."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from typing import Any, Literal

import numpy as np

from caterpillar_env.errors import CaterpillarError, check_choice
from caterpillar_env.morphology import Morphology
from caterpillar_env.physics import Physics
from caterpillar_env.randomization import Randomization

ActionMode = Literal["timing", "phase", "switch"]


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
    randomization: Randomization | None
    terminate_on_failure: bool

    def __post_init__(self) -> None:
        check_choice("action_mode", self.action_mode, ActionMode)
        if not isinstance(self.action_repeat, int) or self.action_repeat < 1:
            raise CaterpillarError(
                "action_repeat must be a whole number of gait periods, or of control intervals in "
                f"switch mode, 1 or more; got {self.action_repeat!r}"
            )
        if self.action_mode == "switch" and not self.symmetric:
            raise CaterpillarError(
                "symmetric = False needs action_mode 'timing' or 'phase'; in switch mode, an action "
                "always has a value for each spring"
            )
        for name in (
            "forward_reward_weight", "ctrl_cost_weight", "failure_cost", "reset_noise_scale"
        ):  # fmt: skip
            value = getattr(self, name)
            if not (isinstance(value, (int, float, np.number)) and 0 <= value < np.inf):
                raise CaterpillarError(f"{name} must be finite and not negative; got {value!r}")
        if self.randomization is not None:
            self.randomization.check(self.physics)

    @classmethod
    def of(cls, arguments: Mapping[str, Any]) -> EpisodeConfig:
        """Create the settings from the keyword arguments of an environment."""
        chosen: dict[str, Any] = {f.name: arguments.get(f.name) for f in fields(cls)}
        chosen["physics"] = Physics.of(chosen["physics"])
        chosen["randomization"] = Randomization.of(chosen["randomization"])
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
    if not isinstance(value, (Morphology, Mapping, Sequence)):
        value = np.atleast_1d(value)
    if isinstance(value, (Morphology, Mapping)) or (len(value) and np.isscalar(value[0])):
        return [Morphology.of(value)] * num_envs
    if len(value) != num_envs:
        raise CaterpillarError(
            f"morphology must be one body for all robots, a list of {num_envs} bodies, or an array of "
            f"shape ({num_envs}, 8); got {len(value)}"
        )
    return [Morphology.of(v) for v in value]


def check_options(options: Mapping[str, Any] | None, known: tuple[str, ...]) -> dict[str, Any]:
    """Return the reset options as a new dict.

    Raises:
        CaterpillarError: a key is not in `known`.
    """
    chosen = dict(options or {})
    if unknown := sorted(set(chosen) - set(known)):
        raise CaterpillarError(f"reset options are {', '.join(known)}; got {unknown}")
    return chosen
