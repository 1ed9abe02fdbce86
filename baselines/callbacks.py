"""Training callbacks for the `callback` entry of rl_zoo3 hyperparameter files."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common.callbacks import BaseCallback

from caterpillar_env.errors import CaterpillarError


class InitialDuty(BaseCallback):
    """Sets the share of time for which an untrained policy powers each spring.

    Without it, a new policy powers each spring at random for half of the time. Springs need seconds to
    cool, so all of them would stay hot, the robot would not move, and the policy would learn nothing.

    Args:
        duty: share of the time, in (0, 1).

    Raises:
        CaterpillarError: `duty` is out of range.
    """

    def __init__(self, duty: float) -> None:
        super().__init__()
        if not 0 < duty < 1:
            raise CaterpillarError(f"duty = {duty} must be between 0 and 1")
        self._duty = duty

    def _on_training_start(self) -> None:
        if self.model.num_timesteps:
            return
        policy: Any = self.model.policy
        with torch.no_grad():
            if isinstance(self.model.action_space, spaces.MultiBinary):
                policy.action_net.bias.fill_(float(np.log(self._duty / (1.0 - self._duty))))
                return
            # Timing mode: the actions are the on and off times of each pair, centred in the period.
            pairs = spaces.flatdim(self.model.action_space) // 2
            bias = torch.tensor([-self._duty, self._duty]).repeat(pairs)
            if hasattr(self.model, "weights"):  # ARS: a linear policy without output function
                policy.action_net[-1].bias.copy_(bias)
                self.model.weights = torch.nn.utils.parameters_to_vector(policy.parameters()).detach()
            elif hasattr(policy, "actor"):  # SAC, TQC: the output function is tanh
                policy.actor.mu.bias.copy_(torch.atanh(bias))
            else:
                policy.action_net.bias.copy_(bias)

    def _on_step(self) -> bool:
        return True
