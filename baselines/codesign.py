"""Co-design: CMA-ES proposes bodies, one policy that sees its body crawls in all of them."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.vec_env import VecEnv

from baselines.config import POPULATION, TrainConfig, TrainingError
from baselines.vec_env import CaterpillarVecEnv
from caterpillar_env.morphology import NAMES, Morphology
from evolution.config import RunConfig
from evolution.optimizers.cma_es import CmaConfig, CmaEs

FROZEN_SHARE = 0.2  #: of the budget, at its end, in which the body stays


class CoDesign(BaseCallback):
    """Gives robots new bodies before each rollout, and tells CMA-ES afterwards how far they got.

    A rollout is one episode of every robot. A body's fitness is the mean distance of its robots' first
    episodes, drawn actions and all; one that failed counts 0.

    Args:
        config: of the training; its `design` says what prior bodies come from.
        robots: that learn, a multiple of `POPULATION`.
        share_spent: how much of the budget is spent.

    Raises:
        TrainingError: the number of robots does not fit.
    """

    def __init__(
        self, config: TrainConfig, robots: CaterpillarVecEnv, share_spent: Callable[[], float]
    ) -> None:
        super().__init__()
        if robots.num_envs % POPULATION:
            raise TrainingError(
                f"n_envs = {robots.num_envs} must be a multiple of {POPULATION}, the number of "
                "bodies tried at a time"
            )
        prior = RunConfig(
            prior="preprocessed" if config.design == "preprocessed" else "uniform",
            physics=config.physics,
        )
        genes = len(NAMES)
        self._strategy = CmaEs(
            prior.distributions()[:genes],
            CmaConfig(cma_population=POPULATION, cma_restarts=False),
            np.random.default_rng(config.seed),
        )
        self._robots, self._share_spent = robots, share_spent
        self._genomes = np.empty((0, genes))
        self._first: list[float | None] = []
        self._frozen = False

    @property
    def favourite(self) -> Morphology:
        """The body at the centre of CMA-ES's search."""
        return Morphology.from_unit(self._strategy.centre)

    def _on_rollout_start(self) -> None:
        model: Any = self.model
        steps = round(self._robots.episode_s / self._robots.step_s)
        if model.n_steps != steps:
            raise TrainingError(
                f"n_steps = {model.n_steps} must be {steps}, an episode of "
                f"{self._robots.episode_s:g} s, where the body is evolved"
            )
        self._tell()
        if self._frozen:
            return
        if self._share_spent() >= 1.0 - FROZEN_SHARE:
            self._frozen = True
            bodies = [self.favourite] * self._robots.num_envs
        else:
            self._genomes = self._strategy.ask()
            each = self._robots.num_envs // POPULATION
            bodies = [Morphology.from_unit(g) for g in self._genomes for _ in range(each)]
            self._first = [None] * self._robots.num_envs
        env: VecEnv = self.training_env
        env.set_options({"morphology": bodies})
        model._last_obs = env.reset()
        model._last_episode_starts = np.ones(self._robots.num_envs, dtype=bool)

    def _on_step(self) -> bool:
        if self._first:
            for row, (done, info) in enumerate(
                zip(self.locals["dones"], self.locals["infos"], strict=True)
            ):
                if done and self._first[row] is None:
                    self._first[row] = info["distance"] if info["failure"] == "ok" else 0.0
        return True

    def _tell(self) -> None:
        if not self._first:
            return
        crawled = np.maximum(np.array(self._first, dtype=float), 0.0)
        self._strategy.tell(self._genomes, crawled.reshape(POPULATION, -1).mean(axis=1))
        self._first = []
