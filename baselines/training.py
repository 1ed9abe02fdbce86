"""Reinforcement learning at a budget of simulated seconds, training and evaluation both counted."""

from __future__ import annotations

import os
import shutil
import time
from collections.abc import Callable
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import torch
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecMonitor, VecNormalize

from baselines.codesign import CoDesign
from baselines.config import TrainConfig, TrainingError, hyperparameters
from baselines.policy import ALGORITHMS, Policy, judge, settings
from baselines.records import TENSORBOARD, Point, Record, append
from baselines.vec_env import CaterpillarVecEnv
from caterpillar_env.files import make_folder
from caterpillar_env.task import EPISODE_S, label
from evolution.run.records import fingerprint

_LEAST_ROLLOUTS = 5  #: that bodies are to evolve in


class TrainResult(NamedTuple):
    """What a training leaves in memory; the folder holds the same and more."""

    points: list[Point]
    best: Point | None  #: of policies whose robot did not fail, if there was one
    finished: bool


class _BudgetSpent(Exception):  # noqa: N818  an end, no error
    """The budget is spent."""


def train(
    config: TrainConfig,
    folder: Path,
    *,
    on_point: Callable[[Point], None] | None = None,
    on_progress: Callable[[float], None] | None = None,
    tensorboard: bool = False,
    threads: int = 0,
) -> TrainResult:
    """Train a policy and keep it in a new folder.

    Writes `training.json` (what was asked and under which versions), `evaluations.csv`, and after every
    evaluation `last.zip` (the policy) with `last_vecnormalize.pkl` (the normalisation that it needs);
    the best so far as `best` likewise. A KeyboardInterrupt ends the training; what was kept stays.
    PyTorch runs on one thread, so that results do not depend on how many there are, and all global
    generators are seeded: a training that is done anew has the same bits.

    Args:
        config: what to compute.
        folder: made here; must not hold anything yet.
        on_point: told of every evaluation.
        on_progress: told the simulated seconds spent so far, after every step.
        tensorboard: whether to log what the algorithm says of itself.
        threads: that robots are stepped on; 0 for all cores. Results do not depend on it.

    Raises:
        FileError: the folder is not empty or cannot be written.
        TrainingError: the budget is too little, or tensorboard is not installed.
    """
    learning = hyperparameters(config)
    began = time.perf_counter()
    robots = CaterpillarVecEnv(
        config.env_id, learning.n_envs, threads=threads, morphology=config.morphology,
        **settings(config, randomization=config.randomize),
    )  # fmt: skip
    reserve_s = _check_budget(config, robots)
    make_folder(folder, " (a training cannot be resumed: one that was stopped is done anew)")
    record = Record(config, learning.plain(), _versions(), finished=False, wall_s=None, simulated_s=0.0)
    record.save(folder)
    env: Any = VecMonitor(robots)
    if learning.normalize is not None:
        env = VecNormalize(env, **learning.normalize)
    normalizer = env if learning.normalize is not None else None
    keeper = _Keeper(config, folder, robots, normalizer, reserve_s, on_point, on_progress)
    callbacks: list[BaseCallback] = [*learning.callbacks, keeper]
    if config.design != "fixed":
        keeper.designs = CoDesign(config, robots, lambda: keeper.spent_s / config.budget_s)
        callbacks.insert(0, keeper.designs)
    before, finished = torch.get_num_threads(), True
    torch.set_num_threads(1)
    try:
        model = ALGORITHMS[config.algorithm](
            env=env, seed=config.seed, device="cpu", verbose=0,
            tensorboard_log=str(folder / TENSORBOARD) if tensorboard else None, **learning.model,
        )  # fmt: skip
        # Neighbouring seeds would else share the conditions of all rows but one.
        seeds = np.random.SeedSequence(config.seed).generate_state(robots.num_envs)
        robots.seed_rows(seeds.tolist())
        # The budget ends it: where robots fail, steps are shorter than they could be.
        while True:
            steps = max(int((config.budget_s - keeper.spent_s) / robots.step_s), 1)
            model.learn(steps, callback=callbacks, reset_num_timesteps=not model.num_timesteps)
    except _BudgetSpent:
        keeper.evaluate()
    except KeyboardInterrupt:
        finished = False
    except ImportError as error:
        shutil.rmtree(folder)  # nothing but its description
        raise TrainingError(f"{error}: pip install 'caterpillar-sma[tensorboard]'") from None
    finally:
        torch.set_num_threads(before)
        env.close()
    wall_s = time.perf_counter() - began
    record._replace(finished=finished, wall_s=wall_s, simulated_s=keeper.spent_s).save(folder)
    return TrainResult(keeper.points, keeper.best, finished)


def _check_budget(config: TrainConfig, robots: CaterpillarVecEnv) -> float:
    """What a step of all robots, one evaluation now and one at the end may take, s.

    Raises:
        TrainingError: the budget is less, or does not let bodies evolve.
    """
    reserve_s = robots.num_envs * robots.step_s + 2 * EPISODE_S
    if reserve_s > config.budget_s:
        raise TrainingError(
            f"budget_s = {config.budget_s:g} is too little: a step of all {robots.num_envs} robots and "
            f"two evaluations take {reserve_s:g} simulated seconds"
        )
    least_s = _LEAST_ROLLOUTS * robots.num_envs * EPISODE_S
    if config.design != "fixed" and config.budget_s < least_s:
        raise TrainingError(
            f"budget_s = {config.budget_s:g} is too little for bodies to evolve: {_LEAST_ROLLOUTS} "
            f"episodes of {robots.num_envs} robots take {least_s:g} simulated seconds"
        )
    return reserve_s


def _versions() -> dict[str, str]:
    packages = ("stable-baselines3", "sb3-contrib", "torch", "gymnasium")
    return fingerprint() | {name: version(name) for name in packages}


class _Keeper(BaseCallback):
    """Evaluates now and then, keeps the policy, and stops when the budget is spent."""

    def __init__(
        self,
        config: TrainConfig,
        folder: Path,
        robots: CaterpillarVecEnv,
        normalizer: VecNormalize | None,
        reserve_s: float,
        on_point: Callable[[Point], None] | None,
        on_progress: Callable[[float], None] | None,
    ) -> None:
        super().__init__()
        self._config, self._folder, self._robots = config, folder, robots
        self._normalizer, self._told, self._progress = normalizer, on_point, on_progress
        self._judge = judge(config)
        self._next_s = 0.0
        self.designs: CoDesign | None = None
        self.points: list[Point] = []
        self.best: Point | None = None
        self._kept: tuple[bool, float] = (False, -np.inf)
        self._reserve_s = reserve_s

    @property
    def spent_s(self) -> float:
        """Simulated seconds so far."""
        return self._robots.simulated_s + self._judge.crawl.simulation.simulated_s

    def _on_step(self) -> bool:
        if self._progress is not None:
            self._progress(self.spent_s)
        if self.spent_s + self._reserve_s > self._config.budget_s:
            raise _BudgetSpent
        if self.spent_s >= self._next_s:
            self._next_s = self.spent_s + self._config.budget_s / self._config.evaluations
            self.evaluate()
        return True

    def evaluate(self) -> None:
        """Let the policy of this moment crawl, and keep it."""
        body = self._config.morphology if self.designs is None else self.designs.favourite
        end = Policy(self.model, self._normalizer).crawl(self._judge, self._config.seed, body)
        point = Point(
            self.spent_s, float(end.distance_m[0]), float(end.energy_j[0]), float(end.simulated_s[0]),
            label(end.failure[0]), body,
        )  # fmt: skip
        self.points.append(point)
        # A policy whose robot falls is never better than one whose robot does not.
        score, kept = (point.failure == "ok", point.distance_m), ["last"]
        if score > self._kept:
            self._kept, self.best = score, point if score[0] else None
            kept.append("best")
        self._keep(point, kept)
        for name in ("distance_m", "energy_j", "time_s"):
            self.logger.record(f"evaluation/{name}", getattr(point, name))
        self.logger.record("time/simulated_s", point.simulated_s)
        if self._told is not None:
            self._told(point)

    def _keep(self, point: Point, names: list[str]) -> None:
        """Write the policy under these names, and the table's row: all but at once."""
        whole: dict[Path, Path] = {}
        for name in names:
            partial = self._folder / f".{name}.partial.zip"
            self.model.save(partial, exclude=["tensorboard_log"])
            whole[partial] = self._folder / f"{name}.zip"
            if self._normalizer is not None:
                statistics = self._folder / f".{name}.partial.pkl"
                self._normalizer.save(str(statistics))
                whole[statistics] = self._folder / f"{name}_vecnormalize.pkl"
        append(self._folder, point)
        for partial, path in whole.items():
            os.replace(partial, path)
