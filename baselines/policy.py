"""Trained policies: what is kept of them, and robots that crawl by them."""

from __future__ import annotations

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

from baselines.config import TrainConfig, TrainingError, hyperparameters
from baselines.records import Record, best_of, evaluations
from baselines.vec_env import CaterpillarVecEnv
from caterpillar_env.env import CaterpillarEnv
from caterpillar_env.files import write_json
from caterpillar_env.morphology import Morphology
from caterpillar_env.physics import Physics
from caterpillar_env.robot import Outcomes, digest_of
from caterpillar_env.task import OnInterval

ALGORITHMS: dict[str, type[BaseAlgorithm]] = {
    "ppo": PPO, "a2c": A2C, "sac": SAC, "tqc": TQC, "ars": ARS,
}  # fmt: skip
Which = Literal["best", "last"]


def settings(config: TrainConfig, **other: Any) -> dict[str, Any]:
    """Arguments of the environment that a policy was trained for, and is judged in."""
    return {"physics": config.physics, **hyperparameters(config).env_kwargs, **other}


def judge(config: TrainConfig, **other: Any) -> CaterpillarEnv:
    """Make the environment in which policies are evaluated, without randomization."""
    return CaterpillarEnv(action_mode=config.mode, **settings(config, **other))


class AtRandom:
    """Chooses every action evenly from the space."""

    def __init__(self, space: spaces.Space[Any], seed: int) -> None:
        self._space = space
        space.seed(seed)

    def predict(self, observation: Any, deterministic: bool = False) -> tuple[NDArray[Any], None]:
        """An action for each observation."""
        return np.array([self._space.sample() for _ in observation]), None


@dataclass(frozen=True)
class Policy:
    """A policy with the normalisation of observations that it was trained with."""

    actor: BaseAlgorithm | AtRandom
    normalizer: VecNormalize | None

    def crawl(
        self,
        robot: CaterpillarEnv,
        seed: int,
        morphology: Morphology,
        *,
        deterministic: bool = True,
        on_interval: OnInterval | None = None,
    ) -> Outcomes:
        """One episode of a single robot.

        Args:
            robot: see `judge`.
            seed: of the episode.
            morphology: the body.
            deterministic: whether the likeliest action is taken, not a drawn one.
            on_interval: see `Crawl.run`.
        """
        robot.on_interval = on_interval
        seen, _ = robot.reset(seed=seed, options={"morphology": morphology})
        ended = False
        while not ended:
            batch: Any = seen[None]
            if self.normalizer is not None:
                batch = self.normalizer.normalize_obs(batch)
            action, _ = self.actor.predict(batch, deterministic=deterministic)
            seen, _, terminated, truncated, _ = robot.step(action[0])
            ended = terminated or truncated
        return Outcomes.of(robot.crawl.progress())


def load(folder: Path, which: Which = "best") -> Policy:
    """A policy of a training.

    Raises:
        TrainingError: the folder holds no training, or none that was evaluated.
    """
    config = Record.load(folder).config
    try:
        model = ALGORITHMS[config.algorithm].load(folder / f"{which}.zip", device="cpu")
    except (OSError, ValueError) as error:
        raise TrainingError(f"{folder} holds no policy that can be read: {error}") from None
    statistics = folder / f"{which}_vecnormalize.pkl"
    if not statistics.exists():
        return Policy(model, None)
    normalizer = VecNormalize.load(
        str(statistics), CaterpillarVecEnv(config.env_id, 1, **settings(config))
    )
    normalizer.training = False
    return Policy(model, normalizer)


@dataclass(frozen=True)
class TrainedRobot:
    """A body that crawls by a policy, in some physics: what `Robot` is to a genome."""

    policy: Policy
    config: TrainConfig
    morphology: Morphology
    physics: Physics
    fitness_m: float | None = None  #: as recorded

    @classmethod
    def load(cls, folder: Path, which: Which = "best") -> TrainedRobot:
        """The robot of a training, with the body that the policy was judged in.

        Raises:
            TrainingError: the folder holds no training, or none that was evaluated.
        """
        config = Record.load(folder).config
        rows = evaluations(folder)
        if not rows:
            raise TrainingError(
                f"{folder} holds no policy that was evaluated: wait for its training, or train anew"
            )
        farthest = best_of(rows) or max(rows, key=lambda row: row.distance_m)
        row = rows[-1] if which == "last" else farthest
        return cls(load(folder, which), config, row.morphology, config.physics, row.distance_m)

    def simulate(
        self,
        timestep_s: float | None = None,
        *,
        seed: int | None = None,
        deterministic: bool = True,
        on_interval: OnInterval | None = None,
    ) -> Outcomes:
        """Let it crawl for an episode, at its own timestep or another.

        Args:
            timestep_s: of the physics, s.
            seed: of the episode; the training's by default.
            deterministic: see `Policy.crawl`.
            on_interval: see `Crawl.run`.
        """
        physics = self.physics if timestep_s is None else replace(self.physics, timestep_s=timestep_s)
        return self.policy.crawl(
            judge(self.config, physics=physics), self.config.seed if seed is None else seed,
            self.morphology, deterministic=deterministic, on_interval=on_interval,
        )  # fmt: skip

    @property
    def digest(self) -> str:
        """Tells it from any other robot: of what `to_dict` says, and how far it got with its policy."""
        return digest_of(self.to_dict())

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON, without the policy itself."""
        body, asked = self.morphology.to_dict(), self.config.to_dict()
        return {"fitness_m": self.fitness_m, "morphology": body, "training": asked}

    def save(self, path: Path) -> None:
        """Write `to_dict` as JSON, and beside it the policy (.zip) and the normalisation (.pkl)."""
        write_json(path, self.to_dict())
        if isinstance(self.policy.actor, BaseAlgorithm):
            self.policy.actor.save(path.with_suffix(".zip"))
        if self.policy.normalizer is not None:
            self.policy.normalizer.save(str(path.with_suffix(".pkl")))
