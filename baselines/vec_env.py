"""Our vector environment as stable-baselines3's `VecEnv`: one batch of robots on all cores.

stable-baselines3 does not take Gymnasium's vector environments. It wants rows that reset themselves
within the step that ends them, the last observation in `terminal_observation`, and truncation told
apart in `TimeLimit.truncated`.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvObs, VecEnvStepReturn

import caterpillar_env  # noqa: F401  registers the environments
from caterpillar_env.errors import CaterpillarError

#: What is told of an episode that ended, besides what stable-baselines3 asks for.
EPISODE_INFO = ("distance", "energy_j", "time_s", "failure")


class CaterpillarVecEnv(VecEnv):
    """`num_envs` robots.

    Args:
        env_id: `CaterpillarSMA-v0` or `CaterpillarSMASwitch-v0`.
        num_envs: how many.
        threads: threads to step on; 0 means all cores.
        **kwargs: as for the environment.
    """

    def __init__(self, env_id: str, num_envs: int, *, threads: int = 0, **kwargs: Any) -> None:
        self._env: Any = gymnasium.make_vec(
            env_id, num_envs=num_envs, threads=threads, autoreset_mode=AutoresetMode.SAME_STEP, **kwargs
        )
        self.render_mode = self._env.unwrapped.render_mode
        self._actions: NDArray[Any] | None = None
        super().__init__(num_envs, self._env.single_observation_space, self._env.single_action_space)
        self.metadata = {**self.metadata, "render_fps": self._env.metadata["render_fps"]}

    @property
    def step_s(self) -> float:
        """Simulated length of a step, s."""
        return float(self._env.unwrapped.step_s)

    @property
    def episode_s(self) -> float:
        """Simulated length of an episode, s."""
        return float(self._env.unwrapped.episode_s)

    @property
    def simulated_s(self) -> float:
        """Simulated seconds that all rows have been stepped for, since the environment was made."""
        return float(self._env.unwrapped.simulated_s)

    def seed_rows(self, seeds: Sequence[int]) -> None:
        """Seed each row's next reset; `seed` counts on from one number."""
        self._seeds = list(seeds)

    def reset(self) -> VecEnvObs:
        """Start all rows anew, with the seeds and options that were set."""
        seeds = self._seeds if any(seed is not None for seed in self._seeds) else None
        if any(options != self._options[0] for options in self._options):
            raise CaterpillarError(
                "options must be the same for all rows; give bodies as a list: "
                'set_options({"morphology": [...]})'
            )
        options = self._options[0] or None
        observations, _ = self._env.reset(seed=seeds, options=options)
        self.reset_infos = [{} for _ in range(self.num_envs)]
        self._reset_seeds()
        self._reset_options()
        return np.asarray(observations)

    def step_async(self, actions: NDArray[Any]) -> None:
        """Note the actions; `step_wait` makes the step."""
        self._actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        """Step all rows; those whose episode ends start another one at once."""
        observations, rewards, terminated, truncated, info = self._env.step(self._actions)
        dones = terminated | truncated
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for row in np.flatnonzero(dones):
            final = info["final_info"]
            infos[row] = {key: final[key][row] for key in EPISODE_INFO}
            infos[row]["terminal_observation"] = info["final_obs"][row]
            infos[row]["TimeLimit.truncated"] = bool(truncated[row])
        return observations, rewards.astype(np.float32), dones, infos

    def close(self) -> None:
        """Free what is drawn with."""
        self._env.close()

    def get_images(self) -> Sequence[NDArray[np.uint8] | None]:
        """A picture of each row."""
        frames = self._env.render()
        return [None] * self.num_envs if frames is None else list(frames)

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """An attribute of the vector environment, once for each row asked for."""
        source = self if attr_name == "render_mode" else self._env.unwrapped
        value = getattr(source, attr_name)
        return [value for _ in self._rows(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Rows are one environment: an attribute of all of them, or none."""
        if len(list(self._rows(indices))) != self.num_envs:
            raise CaterpillarError(f"{attr_name} can only be set for all {self.num_envs} rows at once")
        setattr(self._env.unwrapped, attr_name, value)

    def env_method(
        self, method_name: str, *args: Any, indices: VecEnvIndices = None, **kwargs: Any
    ) -> list[Any]:
        """Call a method of the vector environment once; its result for each row asked for."""
        result = getattr(self._env.unwrapped, method_name)(*args, **kwargs)
        return [result for _ in self._rows(indices)]

    def env_is_wrapped(
        self, wrapper_class: type[gymnasium.Wrapper[Any, Any, Any, Any]], indices: VecEnvIndices = None
    ) -> list[bool]:
        """No row is wrapped: there is one environment for all."""
        return [False for _ in self._rows(indices)]

    def _rows(self, indices: VecEnvIndices) -> Iterable[int]:
        return self._get_indices(indices)
