"""Trained policies and the robots that they control."""

from __future__ import annotations

import hashlib
import io
import zipfile
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, Literal

import numpy as np
import stable_baselines3
import torch
from numpy.typing import NDArray
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.noise import NormalActionNoise
from stable_baselines3.common.vec_env import VecMonitor, unwrap_vec_wrapper

from baselines.config import (
    TrainConfig,
    Training,
    hyperparameters,
    is_evaluated_as_recorded,
    make_configuration,
    read_settings,
)
from baselines.interface import Interface
from baselines.vec_env import CaterpillarVecEnv
from caterpillar_env.env import CaterpillarEnv
from caterpillar_env.errors import CaterpillarError, check_number
from caterpillar_env.files import COPY, digest_of, read, with_digest, write_bytes, write_json
from caterpillar_env.morphology import NAMES, Morphology
from caterpillar_env.physics import Physics
from caterpillar_env.robot import Outcomes
from caterpillar_env.task import OnInterval

Which = Literal["best", "last"]
FORMAT = "caterpillar-policy-1"  #: format of a robot with a policy, in JSON
_LARGEST_WEIGHT = 1e9  # so that actions are finite
_LARGEST_HEADER = 10_000  # header of an array in a file, bytes; NumPy also refuses larger headers


def make_env(config: TrainConfig, **kwargs: Any) -> CaterpillarEnv:
    """Make the evaluation environment, with one robot and no randomization."""
    settings = config.env_kwargs() | kwargs
    return CaterpillarEnv(config.morphology, **settings)


def make_training_env(config: TrainConfig, threads: int = 0) -> CaterpillarVecEnv:
    """Make the training environment. `threads` is the number of simulation threads; 0 uses all cores."""
    return CaterpillarVecEnv(
        config.env_id, hyperparameters(config).n_envs, threads=threads, morphology=config.morphology,
        randomization=config.randomize, **config.env_kwargs(),
    )  # fmt: skip


def make_model(config: TrainConfig, robots: CaterpillarVecEnv) -> BaseAlgorithm:
    """Make the algorithm with an untrained policy, and wrap its environment."""
    learning = hyperparameters(config)
    env = VecMonitor(Interface(robots, **learning.interface))
    arguments = dict(learning.model)
    if arguments.pop("noise_type", None):
        deviation = np.full(env.action_space.shape or (), arguments.pop("noise_std"))
        arguments["action_noise"] = NormalActionNoise(np.zeros_like(deviation), deviation)
    algorithm: type[BaseAlgorithm] = getattr(stable_baselines3, config.algorithm.upper())
    return algorithm(env=env, seed=config.seed, device="cpu", verbose=0, **arguments)


@dataclass(frozen=True)
class Policy:
    """A policy and its interface to the robots."""

    actor: BaseAlgorithm
    interface: Interface

    @classmethod
    def of(cls, model: BaseAlgorithm) -> Policy:
        """Return the policy of an algorithm. It changes as the algorithm learns."""
        env = model.get_env()
        interface = None if env is None else unwrap_vec_wrapper(env, Interface)
        assert isinstance(interface, Interface)
        return cls(model, interface)

    @classmethod
    def load(cls, path: Path, config: TrainConfig) -> Policy:
        """Load a policy from the .npz file that `save` wrote. The file holds arrays only, and no code.

        Actions are bit-identical to those of the saved policy.

        Raises:
            CaterpillarError: the file cannot be read, or holds the arrays of another policy.
        """
        acts = ("policy_kwargs.", "interface.")
        kept = tuple(entry for entry in config.override if entry.startswith(acts))
        acting = replace(config, override=kept)  # drop the others: a large buffer would need much memory
        policy = cls.of(make_model(acting, make_training_env(acting, threads=1)))
        expected = policy._arrays()
        try:
            arrays = _read_arrays(path, expected)
        except Exception as error:  # damaged archives raise errors of many kinds
            why = str(error) if isinstance(error, (CaterpillarError, OSError)) else "it is damaged"
            raise CaterpillarError(
                f"cannot read the policy {path}: {why}; restore a copy of it, or train it again"
            ) from None
        weights = {name: torch.from_numpy(array) for name, array in arrays.items()}
        policy.actor.policy.load_state_dict(weights)
        return policy

    def save(self, path: Path) -> None:
        """Write the weights as arrays to a .npz file.

        Raises:
            CaterpillarError: the file cannot be written.
        """
        content = io.BytesIO()
        np.savez(content, allow_pickle=False, **self._arrays())
        write_bytes(path, content.getvalue(), COPY)

    def _arrays(self) -> dict[str, NDArray[Any]]:
        """Return the content of a file: the weights by name."""
        return {name: weight.numpy() for name, weight in self.actor.policy.state_dict().items()}

    @property
    def digest(self) -> str:
        """Hash of the weights."""
        found = hashlib.sha256()
        for name, array in sorted(self._arrays().items()):
            found.update(name.encode() + array.tobytes())
        return found.hexdigest()

    def act(self, observations: Any) -> NDArray[Any]:
        """Return the deterministic actions of the policy for observations of the environment, (R, n)."""
        seen = self.interface.observe(observations)
        return self.interface.act(self.actor.predict(seen, deterministic=True)[0], observations)

    def crawl(
        self,
        env: CaterpillarEnv,
        seed: int,
        morphology: Morphology,
        on_interval: OnInterval | None = None,
    ) -> Outcomes:
        """Run one episode with the deterministic policy, in an environment from `make_env`."""
        env.on_interval = on_interval
        observation, _ = env.reset(seed=seed, options={"morphology": morphology})
        ended = False
        while not ended:
            observation, _, terminated, truncated, _ = env.step(self.act(observation[None])[0])
            ended = terminated or truncated
        return Outcomes.of(env.crawl.progress())


def _read_arrays(path: Path, expected: Mapping[str, NDArray[Any]]) -> dict[str, NDArray[Any]]:
    """Read arrays with the names, shapes and types of `expected`.

    Raises:
        CaterpillarError: the file is missing, or its arrays differ or have invalid values.
        Exception: the file is damaged.
    """
    if not path.is_file():
        raise CaterpillarError("there is no such file")
    with zipfile.ZipFile(path) as archive:  # check sizes before anything is read
        sizes = {info.filename.removesuffix(".npy"): info.file_size for info in archive.infolist()}
    if sizes.keys() != expected.keys() or any(
        sizes[name] > array.nbytes + _LARGEST_HEADER for name, array in expected.items()
    ):
        raise CaterpillarError("it holds the arrays of another policy")
    with np.load(path, allow_pickle=False) as file:
        arrays = {name: file[name] for name in expected}
    for name, array in arrays.items():
        if (array.shape, array.dtype) != (expected[name].shape, expected[name].dtype):
            raise CaterpillarError(
                f"{name} must be {expected[name].dtype} of shape {expected[name].shape}; got "
                f"{array.dtype} of shape {array.shape}"
            )
        if not np.isfinite(array).all() or np.abs(array).max(initial=0.0) > _LARGEST_WEIGHT:
            raise CaterpillarError(f"{name} has values that are not finite or are too large")
    return arrays


@dataclass(frozen=True)
class TrainedRobot:
    """A body controlled by a policy. Like `Robot`, it implements `AnyRobot`."""

    policy: Policy
    config: TrainConfig  #: configuration of the training run
    morphology: Morphology
    physics: Physics
    fitness_m: float | None = None  #: recorded distance, m; 0 for a robot that failed

    @classmethod
    def load(cls, path: Path, which: Which = "best") -> TrainedRobot:
        """Load a policy and the body with which it was evaluated.

        Args:
            path: folder of a training run, or a JSON file that `save` wrote.
            which: policy of a training run: the best one, or the last one.

        Raises:
            CaterpillarError: the path has neither a training run nor a robot, or the training run has no
                such policy yet.
        """
        if path.is_file() or path.suffix == ".json":
            advice = "give the folder of a training run, or the JSON file of a robot with a policy"
            if which != "best":
                raise CaterpillarError(
                    f"{path} has only one policy; for the last policy, give the folder of a training run"
                )
            return read(path, lambda data: cls._from_dict(data, path.with_suffix(".npz")), advice)
        folder, training = path, Training.read(path)
        history = training.history
        evaluation = history.best
        if which == "last" and history.evaluations:
            evaluation = history.evaluations[-1]
        if evaluation is None:
            why = "no policy has been evaluated yet"
            if history.evaluations:
                why = "no policy crawled forwards without failing; use --which last"
            raise CaterpillarError(f"{folder} contains no {which} policy: {why}")
        config = training.config
        _check_settings(str(folder), history.configuration, config)
        policy = Policy.load(folder / f"{which}.npz", config)
        return cls(policy, config, training.body(evaluation), config.physics, evaluation.fitness_m)

    @classmethod
    def _from_dict(cls, data: Any, weights: Path) -> TrainedRobot:
        """Make a robot from `to_dict` and the file of its weights."""
        if not isinstance(data, dict) or data.get("format") != FORMAT:
            raise CaterpillarError(f'not a robot with a policy: expected JSON with "format": "{FORMAT}"')
        try:
            configuration, fitness_m, digest = dict(data["training"]), data["fitness_m"], data["weights"]
            body = Morphology(**{name: data["morphology"][name] for name in NAMES})
            physics = Physics.of(data["physics"])
        except (LookupError, TypeError, ValueError) as error:
            raise CaterpillarError(f"a field is missing or invalid: {error}") from None
        config = read_settings(configuration)
        if fitness_m is not None:
            fitness_m = check_number("fitness_m", fitness_m)
        _check_settings("it", configuration, config)
        policy = Policy.load(weights, config)
        if policy.digest != digest:
            raise CaterpillarError(
                f"{weights} has other weights; restore the file that belongs to this robot"
            )
        return cls(policy, config, body, physics, fitness_m)

    def simulate(self, *, on_interval: OnInterval | None = None) -> Outcomes:
        """Run one episode. For `on_interval`, see `CaterpillarEnv`."""
        env = make_env(self.config, physics=self.physics)
        return self.policy.crawl(env, self.config.seed, self.morphology, on_interval)

    def with_physics(self, **changes: Any) -> TrainedRobot:
        """Return a copy of the robot with changed fields of `Physics`."""
        return replace(self, physics=replace(self.physics, **changes))

    @property
    def digest(self) -> str:
        """Digest that identifies the robot; see `AnyRobot`."""
        return digest_of(self.to_dict())

    def to_dict(self) -> dict[str, Any]:
        """Return the robot as plain JSON, with a hash of the policy's weights."""
        return {
            "format": FORMAT,
            "fitness_m": self.fitness_m,
            "morphology": self.morphology.to_dict(),
            "physics": self.physics.to_dict(),
            "training": make_configuration(self.config),
            "weights": self.policy.digest,
        }

    def save(self, path: Path) -> None:
        """Write a JSON file for `load`, and the policy to a .npz file beside it."""
        self.policy.save(path.with_suffix(".npz"))
        write_json(path, with_digest(self.to_dict()))


def _check_settings(who: str, configuration: Mapping[str, Any], config: TrainConfig) -> None:
    if not is_evaluated_as_recorded(configuration, config):
        raise CaterpillarError(
            f"{who} was trained with other settings of the policy or the environment than those in "
            "baselines/hyperparams; use the version of this package that trained it"
        )
