"""Training within a budget of simulated seconds. Evaluations count towards the budget."""

from __future__ import annotations

import importlib
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.base_class import BaseAlgorithm
from stable_baselines3.common.callbacks import BaseCallback

from baselines import checkpoint
from baselines.callbacks import restart
from baselines.codesign import CoDesign
from baselines.config import TrainConfig, Training, hyperparameters, is_same, make_configuration
from baselines.policy import Policy, make_env, make_model, make_training_env
from baselines.vec_env import CaterpillarVecEnv
from caterpillar_env.errors import CaterpillarError
from caterpillar_env.files import make_folder
from caterpillar_env.task import EPISODE_S
from evolution.run.history import History
from evolution.run.journal import Journal
from evolution.run.loop import warn_of_versions

_PACKAGES = ("stable-baselines3", "torch", "gymnasium")
OnEvaluation = Callable[[History], None]
OnSpent = Callable[[float], None]


class _BudgetSpent(Exception):  # noqa: N818  it signals a normal end
    """Signals that the budget is spent."""


def train(
    config: TrainConfig,
    folder: Path,
    *,
    on_evaluation: OnEvaluation | None = None,
    on_progress: OnSpent | None = None,
    threads: int = 0,
) -> Training:
    """Train a policy and record the training run in a new folder.

    The folder gets a journal, the last policy (`last.npz`) and the best policy (`best.npz`), which
    belongs to `History.best`. Until the training is finished, the folder also has a checkpoint. A
    KeyboardInterrupt stops the training; `resume` continues it. PyTorch runs on one thread and
    all global generators are seeded, so a repeated or resumed training run gives identical results.

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
    _find_reserve(config, robots)  # if this fails, no folder is made
    with _one_thread():
        model = make_model(config, robots)
        make_folder(folder, "; to continue a training run, use `caterpillar rl resume`")
        with Journal.create(folder, make_configuration(config)) as journal:
            history = History(journal)
            _run(_Recorder(config, robots, history, on_evaluation, on_progress), model)
    return Training(config, history)


def resume(
    folder: Path,
    *,
    on_evaluation: OnEvaluation | None = None,
    on_progress: OnSpent | None = None,
    on_warning: Callable[[str], None] | None = None,
    threads: int = 0,
) -> Training:
    """Continue a training run from its last evaluation, as if it had not been stopped.

    Args:
        folder: folder of the training run. A finished one is returned as it is.
        on_evaluation: see `train`.
        on_progress: see `train`.
        on_warning: called with warnings about changed versions, which may alter the result.
        threads: see `train`.

    Raises:
        CaterpillarError: the folder has no training run, no intact checkpoint or no best policy, or the
            hyperparameters have changed.
    """
    recorded = Training.read(folder)
    config, known = recorded
    if known.finished:
        return recorded
    if not is_same(known.configuration, config):
        raise CaterpillarError(
            f"{folder} was trained with other hyperparameters than those in baselines/hyperparams; use "
            "the version of this package that began it, or train again in another folder"
        )
    if on_warning is not None:
        warn_of_versions(known, on_warning, _PACKAGES)
    with _one_thread(), Journal(folder) as journal:
        history = History(journal)
        for _ in known.generations:
            history.complete()
        robots = make_training_env(config, threads)
        recorder = _Recorder(config, robots, history, on_evaluation, on_progress)
        _run(recorder, make_model(config, robots))
    return Training(config, history)


@contextmanager
def _one_thread() -> Iterator[None]:
    """Let PyTorch use one thread, because its rounding depends on the number of threads."""
    threads = torch.get_num_threads()
    torch.set_num_threads(1)
    try:
        yield
    finally:
        torch.set_num_threads(threads)


def _run(recorder: _Recorder, model: BaseAlgorithm) -> None:
    """Train until the budget is spent or the user interrupts."""
    config, robots, history = recorder.config, recorder.robots, recorder.history
    try:
        history.begin(_PACKAGES)
        callbacks = [recorder, *map(_make_callback, hyperparameters(config).callback)]
        if recorder.designs is not None:
            callbacks.append(recorder.designs)
        over = bool(history.generations) and recorder.restore(model)
        try:
            # `learn` may spend less time than asked, because robots that fail simulate less than a step.
            while not over:
                steps = max(int((config.budget_s - recorder.spent_s) / robots.vector_env.step_s), 1)
                model.learn(steps, callback=callbacks, reset_num_timesteps=not model.num_timesteps)
        except _BudgetSpent:
            recorder.evaluate(last=True)
        history.finish()
        checkpoint.remove(history.folder)
    except KeyboardInterrupt:
        pass
    finally:
        robots.close()


def _find_reserve(config: TrainConfig, robots: CaterpillarVecEnv) -> float:
    """Return the maximum simulated seconds of one step of all robots and two evaluations.

    Raises:
        CaterpillarError: the budget is smaller.
    """
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
        on_evaluation: OnEvaluation | None,
        on_progress: OnSpent | None,
    ) -> None:
        super().__init__()
        self.config, self.robots, self.history = config, robots, history
        self._on_evaluation, self._on_progress = on_evaluation, on_progress
        self._reserve_s = _find_reserve(config, robots)
        self._env = make_env(config)
        self._counted_s = 0.0  # simulated in this session until the last evaluation
        self._restored = False
        self.designs: CoDesign | None = None
        if config.design != "fixed":
            self.designs = CoDesign(config, robots, lambda: self.spent_s / config.budget_s)

    @property
    def spent_s(self) -> float:
        """Simulated seconds of training and evaluation so far, including earlier sessions."""
        return self.history.simulated_s + self._since_s()

    def _since_s(self) -> float:
        """Return the simulated seconds since the last evaluation, rounded so that resuming is exact."""
        crawls = self.robots.vector_env.crawl, self._env.crawl
        return round(sum(crawl.simulation.simulated_s for crawl in crawls) - self._counted_s, 6)

    def restore(self, model: BaseAlgorithm) -> bool:
        """Restore a new algorithm and the co-design. Return whether the budget was already spent."""
        more = checkpoint.load(self.history.folder, len(self.history.generations) - 1, model)
        if self.designs is not None:
            self.designs.restore(more)
        self._save(Policy.of(model))  # in case the process was killed before it saved the policy
        best = self.history.folder / "best.npz"
        if self.history.best is not None and not best.exists():
            raise CaterpillarError(
                f"{best} is missing; restore a copy of it, or train again in another folder"
            )
        self._restored = True
        return bool(more["last"])

    def _on_rollout_start(self) -> None:
        due = self._since_s() >= self.config.budget_s / self.config.evaluations
        if due or not self.history.generations:
            self.evaluate()
        elif not self._restored:
            return
        self._restored = False
        # The rest of the run depends only on the checkpoint and the number of the evaluation.
        seeds = np.random.SeedSequence([self.config.seed, len(self.history.generations)])
        seed, *row_seeds = seeds.generate_state(1 + self.robots.num_envs).tolist()
        self.model.set_random_seed(seed)
        self.robots.seed_rows(row_seeds)  # the default, seed + i for row i, repeats rows of other seeds
        restart(self.model)

    def _on_step(self) -> bool:
        if self._on_progress is not None:
            self._on_progress(self.spent_s)
        if self.spent_s + self._reserve_s > self.config.budget_s:
            raise _BudgetSpent
        return True

    def evaluate(self, *, last: bool = False) -> None:
        """Run one episode of the deterministic policy. Record the outcome, the policy and a checkpoint.

        Args:
            last: whether this is the final evaluation of the training run.
        """
        config, history = self.config, self.history
        body, genome = config.morphology, config.morphology.to_unit()
        if self.designs is not None:
            body, genome = self.designs.mean_body, self.designs.mean_genome
        number, policy = len(history.generations), Policy.of(self.model)
        outcome = policy.crawl(self._env, config.seed, body)
        since_s = self._since_s()
        self._counted_s += since_s
        more = {} if self.designs is None else self.designs.state()
        checkpoint.save(history.folder, number, self.model, more | {"last": last})
        if not history.count_recorded(genome[None]):  # already recorded if a session was killed below
            history.append(genome[None], outcome._replace(simulated_s=np.array([since_s])))
        history.complete()
        self._save(policy)
        checkpoint.remove(history.folder, keep=number)
        if self._on_evaluation is not None:
            self._on_evaluation(history)

    def _save(self, policy: Policy) -> None:
        """Write the policy of the last evaluation to `last.npz`, and to `best.npz` if it is the best."""
        history = self.history
        policy.save(history.folder / "last.npz")
        if history.best is history.evaluations[-1]:
            policy.save(history.folder / "best.npz")
