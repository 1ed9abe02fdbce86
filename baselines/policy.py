"""Trained policies and the robots that they control."""

from __future__ import annotations

import os
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from sb3_contrib import ARS, TQC
from stable_baselines3 import A2C, PPO, SAC
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.vec_env import VecNormalize

from baselines.config import TrainConfig, Training
from baselines.vec_env import CaterpillarVecEnv
from caterpillar_env.env import CaterpillarEnv
from caterpillar_env.errors import CaterpillarError
from caterpillar_env.files import write_json
from caterpillar_env.morphology import Morphology
from caterpillar_env.physics import Physics
from caterpillar_env.robot import Outcomes, digest_of
from caterpillar_env.task import OnInterval

ALGORITHMS: dict[str, type[BaseAlgorithm]] = {
    "ppo": PPO, "a2c": A2C, "sac": SAC, "tqc": TQC, "ars": ARS,
}  # fmt: skip
Which = Literal["best", "last"]


def make_env(config: TrainConfig, **kwargs: Any) -> CaterpillarEnv:
    """Make the evaluation environment, with one robot and no randomization."""
    settings = config.env_kwargs() | kwargs
    return CaterpillarEnv(config.morphology, action_mode=config.mode, **settings)


class RandomActor:
    """Policy that samples every action uniformly from the action space."""

    def __init__(self, space: spaces.Space[Any], seed: int) -> None:
        self._space = space
        space.seed(seed)

    def predict(self, observation: Any, deterministic: bool = False) -> tuple[NDArray[Any], None]:
        """Return one action per observation, and None as the state."""
        return np.array([self._space.sample() for _ in observation]), None


@dataclass(frozen=True)
class Policy:
    """A policy and the observation normalization that it was trained with."""

    actor: BaseAlgorithm | RandomActor
    normalizer: VecNormalize | None

    @classmethod
    def load(cls, path: Path, config: TrainConfig) -> Policy:
        """Load a policy from the .zip file that `save` wrote. Both of its files can run any code.

        Raises:
            CaterpillarError: the file cannot be read.
        """
        statistics, normalizer = _statistics(path), None
        try:
            if not path.is_file():
                raise OSError("there is no such file")
            model = ALGORITHMS[config.algorithm].load(path, device="cpu")
            if statistics.is_file():
                env = CaterpillarVecEnv(config.env_id, 1, **config.env_kwargs())
                normalizer = VecNormalize.load(str(statistics), env)
                normalizer.training = False
        except Exception as error:  # damaged archives and pickles raise errors of many kinds
            raise CaterpillarError(
                f"cannot read the policy {path}: {type(error).__name__}: {error}"
            ) from None
        return cls(model, normalizer)

    def save(self, path: Path) -> None:
        """Write `NAME.zip` and, if observations are normalized, `NAME_vecnormalize.pkl`."""
        partial = path.with_name(f".{path.name}.partial")
        if self.normalizer is not None:
            self.normalizer.save(str(partial))
            os.replace(partial, _statistics(path))
        if isinstance(self.actor, BaseAlgorithm):
            self.actor.save(partial)
            os.replace(partial, path)

    def crawl(
        self,
        env: CaterpillarEnv,
        seed: int,
        morphology: Morphology,
        on_interval: OnInterval | None = None,
    ) -> Outcomes:
        """Run one episode with the most likely actions, in an environment from `make_env`."""
        env.on_interval = on_interval
        observation, _ = env.reset(seed=seed, options={"morphology": morphology})
        ended = False
        while not ended:
            batch: Any = observation[None]
            if self.normalizer is not None:
                batch = self.normalizer.normalize_obs(batch)
            action, _ = self.actor.predict(batch, deterministic=True)
            observation, _, terminated, truncated, _ = env.step(action[0])
            ended = terminated or truncated
        return Outcomes.of(env.crawl.progress())


def _statistics(path: Path) -> Path:
    return path.with_name(f"{path.stem}_vecnormalize.pkl")


@dataclass(frozen=True)
class TrainedRobot:
    """A body controlled by a policy. Like `Robot`, it implements `AnyRobot`."""

    policy: Policy
    config: TrainConfig  #: configuration of the training run
    morphology: Morphology
    physics: Physics
    fitness_m: float | None = None  #: recorded distance, m

    @classmethod
    def load(cls, folder: Path, which: Which = "best") -> TrainedRobot:
        """Load the best or the last policy of a training run, with the body of its evaluation.

        Raises:
            CaterpillarError: the folder contains no training run, or no such policy yet.
        """
        training = Training.read(folder)
        history = training.history
        evaluation = history.best
        if which == "last" and history.evaluations:
            evaluation = history.evaluations[-1]
        if evaluation is None:
            raise CaterpillarError(
                f"{folder} contains no {which} policy: no policy was evaluated yet, or none crawled "
                "forwards without failing (in that case use --which last)"
            )
        config = training.config
        policy = Policy.load(folder / f"{which}.zip", config)
        return cls(policy, config, training.body(evaluation), config.physics, evaluation.distance_m)

    def simulate(
        self,
        timestep_s: float | None = None,
        *,
        on_interval: OnInterval | None = None,
        seed: int | None = None,
    ) -> Outcomes:
        """Run one episode.

        Args:
            timestep_s: timestep of the physics, s; by default that of `physics`.
            on_interval: see `CaterpillarEnv`.
            seed: seed of the episode; by default the seed of the training run.
        """
        physics = self.physics if timestep_s is None else replace(self.physics, timestep_s=timestep_s)
        env = make_env(self.config, physics=physics)
        seed = self.config.seed if seed is None else seed
        return self.policy.crawl(env, seed, self.morphology, on_interval)

    @property
    def digest(self) -> str:
        """Digest that identifies the robot; see `AnyRobot`."""
        return digest_of(self.to_dict())

    def to_dict(self) -> dict[str, Any]:
        """Return the robot as plain JSON, without the policy weights."""
        return {
            "fitness_m": self.fitness_m,
            "morphology": self.morphology.to_dict(),
            "training": self.config.to_dict(),
        }

    def save(self, path: Path) -> None:
        """Write `to_dict` to a JSON file, and the policy to a .zip file beside it."""
        write_json(path, self.to_dict())
        self.policy.save(path.with_suffix(".zip"))
