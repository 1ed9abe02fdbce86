"""Training within a budget of simulated seconds. Evaluations count towards the budget."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.callbacks import BaseCallback

from baselines.codesign import CoDesign
from baselines.config import TrainConfig, Training, hyperparameters, make_configuration
from baselines.policy import Policy, make_env, make_model, make_training_env
from baselines.vec_env import CaterpillarVecEnv
from caterpillar_env.errors import CaterpillarError
from caterpillar_env.files import make_folder
from caterpillar_env.task import EPISODE_S
from evolution.run.history import History
from evolution.run.journal import Journal

_PACKAGES = ("stable-baselines3", "sb3-contrib", "torch", "gymnasium")


class _BudgetSpent(Exception):  # noqa: N818  it signals a normal end
    """Signals that the budget is spent."""


def train(
    config: TrainConfig,
    folder: Path,
    *,
    on_evaluation: Callable[[History], None] | None = None,
    on_progress: Callable[[float], None] | None = None,
    threads: int = 0,
) -> Training:
    """Train a policy and record the training run in a new folder.

    The folder gets a journal, the last policy (`last.npz`), and the best policy (`best.npz`), which
    belongs to `History.best`. A KeyboardInterrupt ends the training and keeps these files. Training
    cannot be resumed. PyTorch runs on one thread and all global generators are seeded, so a repeated
    training run gives identical results.

    Args:
        config: configuration of the training run.
        folder: folder to create; it must be empty if it exists.
        on_evaluation: called after every evaluation.
        on_progress: called after every step with the simulated seconds spent so far.
        threads: number of simulation threads; 0 uses all cores. Results do not depend on it.

    Raises:
        CaterpillarError: the folder is not empty or cannot be written, or the budget is too small.
    """
    robots = make_training_env(config, threads)
    reserve_s = _check_budget(config, robots)
    make_folder(folder, "; training cannot be resumed")
    torch_threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        with Journal.create(folder, make_configuration(config)) as journal:
            history = History(journal)
            history.begin(_PACKAGES)
            recorder = _Recorder(config, robots, history, reserve_s, on_evaluation, on_progress)
            callbacks = [*map(_make_callback, hyperparameters(config).callback), recorder]
            if recorder.designs is not None:
                callbacks.insert(0, recorder.designs)
            model = make_model(config, robots)
            try:
                while True:  # robots that fail use fewer seconds than their steps would
                    steps = max(int((config.budget_s - recorder.spent_s) / robots.vector_env.step_s), 1)
                    model.learn(steps, callback=callbacks, reset_num_timesteps=not model.num_timesteps)
            except _BudgetSpent:
                recorder.evaluate()
                history.finish()
    except KeyboardInterrupt:
        pass
    finally:
        torch.set_num_threads(torch_threads)
        robots.close()
    return Training(config, history)


def _check_budget(config: TrainConfig, robots: CaterpillarVecEnv) -> float:
    """Return the maximum simulated seconds of one step of all robots and two evaluations."""
    count, budget_s = robots.num_envs, config.budget_s
    reserve_s = count * robots.vector_env.step_s + 2 * EPISODE_S
    if reserve_s > budget_s:
        raise CaterpillarError(
            f"budget_s = {budget_s:g} is too small: one step of {count} robots and two evaluations take "
            f"{reserve_s:g} simulated seconds"
        )
    return reserve_s


def _make_callback(entry: dict[str, dict[str, Any]]) -> BaseCallback:
    """Make a callback from a mapping from its class path to its arguments."""
    ((path, arguments),) = entry.items()
    module, name = path.rsplit(".", 1)
    callback: BaseCallback = getattr(importlib.import_module(module), name)(**arguments)
    return callback


class _Recorder(BaseCallback):
    """Evaluates and records the policy at intervals. Ends the training when the budget is spent."""

    def __init__(
        self,
        config: TrainConfig,
        robots: CaterpillarVecEnv,
        history: History,
        reserve_s: float,
        on_evaluation: Callable[[History], None] | None,
        on_progress: Callable[[float], None] | None,
    ) -> None:
        super().__init__()
        self._config, self._robots, self._history = config, robots, history
        self._reserve_s, self._on_evaluation, self._on_progress = reserve_s, on_evaluation, on_progress
        self._env = make_env(config)
        self._next_s = 0.0  # when the next evaluation is due
        self.designs: CoDesign | None = None
        if config.design != "fixed":
            self.designs = CoDesign(config, robots, lambda: self.spent_s / config.budget_s)

    @property
    def spent_s(self) -> float:
        """Simulated seconds of training and evaluation so far."""
        crawls = self._robots.vector_env.crawl, self._env.crawl
        return sum(crawl.simulation.simulated_s for crawl in crawls)

    def _on_step(self) -> bool:
        if self._on_progress is not None:
            self._on_progress(self.spent_s)
        if self.spent_s + self._reserve_s > self._config.budget_s:
            raise _BudgetSpent
        if self.spent_s >= self._next_s:
            self._next_s = self.spent_s + self._config.budget_s / self._config.evaluations
            self.evaluate()
        return True

    def evaluate(self) -> None:
        """Run one episode of the deterministic policy, record it, and save the policy."""
        body, genome = self._config.morphology, self._config.morphology.to_unit()
        if self.designs is not None:
            body, genome = self.designs.mean_body, self.designs.mean_genome
        policy = Policy.of(self.model)
        outcome = policy.crawl(self._env, self._config.seed, body)
        history = self._history
        since_s = np.array([self.spent_s - history.simulated_s])
        history.append(genome[None], outcome._replace(simulated_s=since_s))
        history.complete()
        latest = history.evaluations[-1]
        policy.save(history.folder / "last.npz")
        if history.best is latest:
            policy.save(history.folder / "best.npz")
        if self._on_evaluation is not None:
            self._on_evaluation(history)
