"""`CaterpillarVectorEnv` as a `VecEnv` of stable-baselines3.

stable-baselines3 does not accept Gymnasium vector environments. It requires that each
sub-environment (row) resets within the step that ends its episode, and the info keys
`terminal_observation` and `TimeLimit.truncated`.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, cast

import gymnasium
import numpy as np
from gymnasium.vector import AutoresetMode
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv
from stable_baselines3.common.vec_env.base_vec_env import VecEnvIndices, VecEnvObs, VecEnvStepReturn

from caterpillar_env.errors import CaterpillarError
from caterpillar_env.vector_env import CaterpillarVectorEnv

#: Info keys that are returned at the end of an episode.
EPISODE_INFO = ("distance", "energy_j", "time_s", "failure")


class CaterpillarVecEnv(VecEnv):
    """Adapter for a `CaterpillarVectorEnv` with `num_envs` robots, available as `vector_env`.

    Args:
        env_id: `CaterpillarSMA-v0` or `CaterpillarSMASwitch-v0`.
        num_envs: number of robots.
        threads: number of simulation threads; 0 uses all cores.
        **kwargs: arguments of `CaterpillarVectorEnv`, except `autoreset_mode`.
    """

    def __init__(self, env_id: str, num_envs: int, *, threads: int = 0, **kwargs: Any) -> None:
        env = gymnasium.make_vec(
            env_id, num_envs=num_envs, threads=threads, autoreset_mode=AutoresetMode.SAME_STEP, **kwargs
        )
        self.vector_env = cast(CaterpillarVectorEnv, env.unwrapped)
        self._actions: NDArray[Any] | None = None
        super().__init__(
            num_envs, self.vector_env.single_observation_space, self.vector_env.single_action_space
        )
        self.metadata = {**self.metadata, "render_fps": self.vector_env.metadata["render_fps"]}

    def seed_rows(self, seeds: Sequence[int]) -> None:
        """Set the seed of each row for the next reset. (`seed` takes a single number for all rows.)"""
        self._seeds = list(seeds)

    def reset(self) -> VecEnvObs:
        """Reset all rows with the current seeds and options.

        Raises:
            CaterpillarError: the options differ between rows.
        """
        if any(options != self._options[0] for options in self._options):
            raise CaterpillarError(
                "options must be the same for all environments; pass bodies as a list: "
                'set_options({"morphology": [...]})'
            )
        observations, _ = self.vector_env.reset(seed=self._seeds, options=self._options[0])
        self._reset_seeds()
        self._reset_options()
        return np.asarray(observations)

    def step_async(self, actions: NDArray[Any]) -> None:
        """Store the actions for `step_wait`."""
        self._actions = actions

    def step_wait(self) -> VecEnvStepReturn:
        """Step all rows. A row whose episode ends is reset and returns its first observation."""
        observations, rewards, terminated, truncated, info = self.vector_env.step(self._actions)
        dones = terminated | truncated
        infos: list[dict[str, Any]] = [{} for _ in range(self.num_envs)]
        for row in np.flatnonzero(dones):
            infos[row] = {key: info["final_info"][key][row] for key in EPISODE_INFO}
            infos[row]["terminal_observation"] = info["final_obs"][row]
            infos[row]["TimeLimit.truncated"] = bool(truncated[row])
        return observations, rewards.astype(np.float32), dones, infos

    def close(self) -> None:
        """Release the renderer."""
        self.vector_env.close()

    def get_images(self) -> Sequence[NDArray[np.uint8] | None]:
        """Return one image per environment."""
        frames = self.vector_env.render()
        return [None] * self.num_envs if frames is None else list(frames)

    def get_attr(self, attr_name: str, indices: VecEnvIndices = None) -> list[Any]:
        """Return an attribute of the vector environment, repeated for each requested row."""
        value = getattr(self.vector_env, attr_name)
        return [value for _ in self._get_indices(indices)]

    def set_attr(self, attr_name: str, value: Any, indices: VecEnvIndices = None) -> None:
        """Raise an error, because all rows share `vector_env`."""
        raise NotImplementedError(
            f"all environments belong to one vector environment: set vector_env.{attr_name}"
        )

    def env_method(
        self, method_name: str, *args: Any, indices: VecEnvIndices = None, **kwargs: Any
    ) -> list[Any]:
        """Raise an error, because all rows share `vector_env`."""
        raise NotImplementedError(
            f"all environments belong to one vector environment: use vector_env.{method_name}"
        )

    def env_is_wrapped(
        self, wrapper_class: type[gymnasium.Wrapper[Any, Any, Any, Any]], indices: VecEnvIndices = None
    ) -> list[bool]:
        """Return False for each requested row, because rows have no wrappers of their own."""
        return [False for _ in self._get_indices(indices)]
