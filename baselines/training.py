"""Reinforcement learning at a budget of simulated seconds, training and evaluation both counted."""

from __future__ import annotations

import csv
import json
import os
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal, NamedTuple, get_args

import numpy as np
import torch
import yaml
from numpy.typing import NDArray
from sb3_contrib import ARS, TQC
from stable_baselines3 import A2C, PPO, SAC
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

from baselines.vec_env import CaterpillarVecEnv
from caterpillar_env.errors import CaterpillarError
from caterpillar_env.model import Physics
from caterpillar_env.morphology import Morphology
from caterpillar_env.task import EPISODE_S

AlgorithmName = Literal["ppo", "a2c", "sac", "tqc", "ars"]
Mode = Literal["timing", "switch"]
ENVIRONMENTS: dict[str, str] = {"timing": "CaterpillarSMA-v0", "switch": "CaterpillarSMASwitch-v0"}
ALGORITHMS: dict[str, type[BaseAlgorithm]] = {
    "ppo": PPO, "a2c": A2C, "sac": SAC, "tqc": TQC, "ars": ARS,
}  # fmt: skip
HYPERPARAMETERS = Path(__file__).with_name("hyperparams")


class TrainingError(CaterpillarError):
    """A training cannot start, go on or be read as asked."""


@dataclass(frozen=True)
class TrainConfig:
    """Everything that decides what a training computes.

    Raises:
        TrainingError: a value is out of range.
    """

    algorithm: AlgorithmName = "ppo"
    mode: Mode = "switch"  #: timing: a step is a gait period; switch: a step is 0.1 s
    seed: int = 0
    budget_s: float = 30_000.0  #: simulated seconds, of training and evaluation together
    evaluations: int = 20  #: of the deterministic policy, spread over the budget
    physics: dict[str, Any] = field(default_factory=dict)  #: fields of `Physics` other than default
    morphology: dict[str, float] | None = None  #: the body; nominal by default

    def __post_init__(self) -> None:
        for name, kind in (("algorithm", AlgorithmName), ("mode", Mode)):
            if getattr(self, name) not in get_args(kind):
                known = ", ".join(get_args(kind))
                raise TrainingError(f"{name} = {getattr(self, name)!r} must be one of {known}")
        if not 0 <= self.seed < 2**32:
            raise TrainingError(f"seed = {self.seed} must be a whole number from 0 to {2**32 - 1}")
        if not 0 < self.budget_s < np.inf:
            raise TrainingError(
                f"budget_s = {self.budget_s} must be a positive number of simulated seconds"
            )
        if self.evaluations < 1:
            raise TrainingError(f"evaluations = {self.evaluations} must be at least 1")
        if self.morphology is not None:
            Morphology.of(self.morphology)
        Physics.of(self.physics)
        hyperparameters(self)

    @property
    def env_id(self) -> str:
        """The environment's name."""
        return ENVIRONMENTS[self.mode]

    def environment(self, num_envs: int) -> CaterpillarVecEnv:
        """Robots to train or to evaluate on."""
        return CaterpillarVecEnv(self.env_id, num_envs, physics=self.physics, morphology=self.morphology)


def hyperparameters(config: TrainConfig) -> dict[str, Any]:
    """What `hyperparams/ALGORITHM.yml` says of the environment, in rl_zoo3's schema.

    Raises:
        TrainingError: it says nothing of it; the algorithm cannot choose such actions.
    """
    path = HYPERPARAMETERS / f"{config.algorithm}.yml"
    table = yaml.safe_load(path.read_text(encoding="utf-8"))
    if config.env_id not in table:
        modes = ", ".join(mode for mode, env_id in ENVIRONMENTS.items() if env_id in table)
        raise TrainingError(
            f"{config.algorithm} cannot learn in mode {config.mode!r}; it can in {modes}"
        )
    found: dict[str, Any] = table[config.env_id]
    return found


class Point(NamedTuple):
    """One evaluation of the deterministic policy."""

    simulated_s: float  #: spent so far, training and evaluation
    distance_m: float
    energy_j: float
    time_s: float  #: how long the robot went on
    failure: str


class TrainResult(NamedTuple):
    """What a training leaves in memory; the folder holds the same and more."""

    points: list[Point]
    best: Point | None  #: of policies whose robot did not fail, if there was one
    finished: bool


class _BudgetSpent(Exception):  # noqa: N818  an end, no error
    """The budget is spent."""


def train(
    config: TrainConfig, folder: Path, on_point: Callable[[Point], None] | None = None
) -> TrainResult:
    """Train a policy and keep it in a new folder.

    Writes `config.json`, `evaluations.csv`, and after every evaluation `last.zip` (the policy) with
    `last_vecnormalize.pkl` (the normalisation that it needs); the best so far as `best` likewise.
    A KeyboardInterrupt ends the training; what was kept stays. PyTorch runs on one thread, so that
    results do not depend on how many there are. All global generators are seeded.

    Args:
        config: what to compute.
        folder: made here; must not hold anything yet.
        on_point: told of every evaluation.

    Raises:
        TrainingError: the folder is not empty.
    """
    folder.mkdir(parents=True, exist_ok=True)
    if any(folder.iterdir()):
        raise TrainingError(f"{folder} is not empty; choose another with --out")
    (folder / "config.json").write_text(json.dumps(asdict(config), indent=2) + "\n", encoding="utf-8")
    settings = dict(hyperparameters(config))
    steps, policy = settings.pop("n_timesteps"), settings.pop("policy")
    normalize, num_envs = settings.pop("normalize", False), settings.pop("n_envs", 1)
    robots = config.environment(num_envs)
    env: Any = VecMonitor(robots)
    gamma = settings.get("gamma", 0.99)
    if normalize:
        env = VecNormalize(env, gamma=gamma)
    duty = settings.pop("initial_duty", None)
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    model = ALGORITHMS[config.algorithm](
        policy, env, seed=config.seed, device="cpu", verbose=0, **settings
    )
    if duty is not None:
        _start_with_duty(model, duty)
    keeper = _Keeper(config, folder, robots, env if normalize else None, on_point)
    finished = True
    try:
        # The budget ends it, not the number of steps.
        model.learn(int(max(steps, 10 * config.budget_s)), callback=keeper)
        keeper.evaluate()
    except _BudgetSpent:
        keeper.evaluate()
    except KeyboardInterrupt:
        finished = False
    finally:
        torch.set_num_threads(threads)
        keeper.close()
        env.close()
    return TrainResult(keeper.points, keeper.best, finished)


def _start_with_duty(model: Any, duty: float) -> None:
    """Let an untrained policy of switches power each spring for this share of the time.

    Half of the time, redrawn ten times a second, would keep springs, which take seconds to cool, hot for
    good: nothing would move, and nothing could be learned.
    """
    with torch.no_grad():
        model.policy.action_net.bias.fill_(float(np.log(duty / (1.0 - duty))))


class _Keeper(BaseCallback):
    """Evaluates now and then, keeps the policy, and stops when the budget is spent."""

    def __init__(
        self,
        config: TrainConfig,
        folder: Path,
        robots: CaterpillarVecEnv,
        normalizer: VecNormalize | None,
        on_point: Callable[[Point], None] | None,
    ) -> None:
        super().__init__()
        self._config, self._folder, self._robots = config, folder, robots
        self._normalizer, self._told = normalizer, on_point
        self._judge = config.environment(1)
        self._next_s = 0.0
        self.points: list[Point] = []
        self.best: Point | None = None
        self._kept: tuple[bool, float] = (False, -np.inf)
        # What a step of all robots, one evaluation now and one at the end may take.
        seconds = robots.num_envs * robots.get_attr("step_s")[0]
        self._reserve_s = seconds + 2 * EPISODE_S

    @property
    def spent_s(self) -> float:
        """Simulated seconds so far."""
        return self._robots.simulated_s + self._judge.simulated_s

    def _on_step(self) -> bool:
        if self.spent_s + self._reserve_s > self._config.budget_s:
            raise _BudgetSpent
        if self.spent_s >= self._next_s:
            self._next_s = self.spent_s + self._config.budget_s / self._config.evaluations
            self.evaluate()
        return True

    def close(self) -> None:
        """Free the robot that policies are judged by."""
        self._judge.close()

    def evaluate(self) -> None:
        """Let the policy of this moment crawl, and keep it."""
        self._judge.seed(self._config.seed)
        final = crawl(self.model, self._judge, self._normalizer)
        point = Point(
            self.spent_s, final["distance"], final["energy_j"], final["time_s"], final["failure"]
        )
        self.points.append(point)
        path = self._folder / "evaluations.csv"
        new = not path.exists()
        with path.open("a", newline="", encoding="utf-8") as file:
            writer = csv.writer(file)
            if new:
                writer.writerow(Point._fields)
            writer.writerow(point)
        self._save("last")
        # A policy whose robot falls is never better than one whose robot does not.
        score = (point.failure == "ok", point.distance_m)
        if score > self._kept:
            self._kept = score
            self.best = point if score[0] else None
            self._save("best")
        if self._told is not None:
            self._told(point)

    def _save(self, name: str) -> None:
        partial = self._folder / ".partial.zip"
        self.model.save(partial)
        if self._normalizer is not None:
            statistics = self._folder / ".partial.pkl"
            self._normalizer.save(str(statistics))
            os.replace(statistics, self._folder / f"{name}_vecnormalize.pkl")
        os.replace(partial, self._folder / f"{name}.zip")


def crawl(
    model: BaseAlgorithm,
    judge: CaterpillarVecEnv,
    normalizer: VecNormalize | None,
    on_step: Callable[[NDArray[Any]], None] | None = None,
) -> dict[str, Any]:
    """One episode of the deterministic policy; the info of its end.

    Args:
        model: the policy.
        judge: one robot.
        normalizer: of the observations that the policy was trained with.
        on_step: called after each step with the action, before the robot starts anew.
    """
    observation = judge.reset()
    while True:
        seen: Any = observation
        if normalizer is not None:
            seen = normalizer.normalize_obs(seen)
        action, _ = model.predict(seen, deterministic=True)
        observation, _, dones, infos = judge.step(action)
        if on_step is not None:
            on_step(action)
        if dones[0]:
            return infos[0]


def load(folder: Path, which: str = "best") -> tuple[TrainConfig, BaseAlgorithm, VecNormalize | None]:
    """A trained policy with the normalisation that it needs.

    Raises:
        TrainingError: the folder holds no training, or none that was evaluated.
    """
    try:
        config = TrainConfig(**json.loads((folder / "config.json").read_text(encoding="utf-8")))
        model = ALGORITHMS[config.algorithm].load(folder / f"{which}.zip", device="cpu")
    except OSError as error:
        raise TrainingError(f"{folder} holds no trained policy: {error}") from None
    except (TypeError, ValueError, KeyError) as error:
        raise TrainingError(f"{folder} cannot be read: {error}") from None
    statistics = folder / f"{which}_vecnormalize.pkl"
    if not statistics.exists():
        return config, model, None
    normalizer = VecNormalize.load(str(statistics), config.environment(1))
    normalizer.training = False
    return config, model, normalizer
