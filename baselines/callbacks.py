"""What happens beside learning; usable from rl_zoo3's files too (`callback:`)."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from gymnasium import spaces
from stable_baselines3.common.callbacks import BaseCallback

from caterpillar_env.errors import CaterpillarError


class InitialDuty(BaseCallback):
    """Let an untrained policy power each spring for this share of the time.

    A fresh policy powers springs half of the time, at random. As they cool within seconds only, they
    would stay hot for good: nothing would move, and nothing could be learned.

    Args:
        duty: share of the time, in (0, 1).
    """

    def __init__(self, duty: float) -> None:
        super().__init__()
        if not 0 < duty < 1:
            raise CaterpillarError(f"duty = {duty} must lie between 0 and 1")
        self._duty = duty

    def _on_training_start(self) -> None:
        if self.model.num_timesteps:
            return
        policy: Any = self.model.policy
        with torch.no_grad():
            if isinstance(self.model.action_space, spaces.MultiBinary):
                policy.action_net.bias.fill_(float(np.log(self._duty / (1.0 - self._duty))))
                return
            # Timings: on and off of each pair in turn, about the middle of the period.
            pairs = spaces.flatdim(self.model.action_space) // 2
            middle = torch.tensor([-self._duty, self._duty]).repeat(pairs)
            if hasattr(self.model, "weights"):  # ARS: linear, without an output function
                policy.action_net[-1].bias.copy_(middle)
                self.model.weights = torch.nn.utils.parameters_to_vector(policy.parameters()).detach()
            elif hasattr(policy, "actor"):  # SAC, TQC: through a hyperbolic tangent
                policy.actor.mu.bias.copy_(torch.atanh(middle))
            else:
                policy.action_net.bias.copy_(middle)

    def _on_step(self) -> bool:
        return True
