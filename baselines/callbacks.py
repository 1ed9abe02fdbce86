"""Training callbacks for rl_zoo3 hyperparameter files, and a function that callbacks share."""

from __future__ import annotations

from typing import Any, cast

import numpy as np
import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback

from caterpillar_env.errors import CaterpillarError


def restart(model: BaseAlgorithm) -> None:
    """Reset the robots of an algorithm between two rollouts, and give it their first observations.

    stable-baselines3 has no method for this; `learn` sets these attributes when it begins.
    """
    env, learner = model.get_env(), cast(Any, model)
    assert env is not None
    learner._last_obs = env.reset()
    learner._last_episode_starts = np.ones(env.num_envs, dtype=bool)


class ZeroActions(BaseCallback):
    """Sets the output layer of an untrained TD3 actor to zero, so that its actions are zero.

    With `Interface` and the prior of the gait, the robot then starts with the gait at the prior's peak.
    """

    def _on_training_start(self) -> None:
        if not self.model.num_timesteps:
            model: Any = self.model
            for parameter in model.actor.mu[-2].parameters():
                torch.nn.init.zeros_(parameter)
            model.actor_target.load_state_dict(model.actor.state_dict())

    def _on_step(self) -> bool:
        return True


class RareFlips(BaseCallback):
    """Sets the probability of 1 in the actions of an untrained policy in switch mode.

    With `Interface` and the prior of the gait, an action of 1 inverts whether a spring is powered in the
    gait at the prior's peak.

    Args:
        probability: probability of 1, in (0, 1).

    Raises:
        CaterpillarError: `probability` is out of range.
    """

    def __init__(self, probability: float) -> None:
        super().__init__()
        if not 0 < probability < 1:
            raise CaterpillarError(f"probability = {probability} must be between 0 and 1 (exclusive)")
        self._logit = float(np.log(probability / (1.0 - probability)))

    def _on_training_start(self) -> None:
        if not self.model.num_timesteps:
            policy: Any = self.model.policy
            torch.nn.init.constant_(policy.action_net.bias, self._logit)

    def _on_step(self) -> bool:
        return True
