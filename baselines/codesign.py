"""Co-design of body and policy: CMA-ES proposes bodies, and one policy learns to control them all."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from stable_baselines3.common.callbacks import BaseCallback

from baselines.callbacks import restart
from baselines.config import POPULATION, TrainConfig
from baselines.vec_env import CaterpillarVecEnv
from caterpillar_env.arrays import Array
from caterpillar_env.errors import CaterpillarError
from caterpillar_env.morphology import NAMES, Morphology
from caterpillar_env.task import Failure
from evolution.config import RunConfig
from evolution.optimizers.cma_es import CmaConfig, CmaEs

FROZEN_SHARE = 0.2  #: final share of the budget during which the body no longer changes


class CoDesign(BaseCallback):
    """Sets new bodies before each rollout, and updates CMA-ES with their fitness after it.

    A rollout is one episode per robot. The fitness of a body is the mean distance of its robots in
    their first episode of the rollout, with the stochastic policy. A failure counts as 0.

    Args:
        config: configuration of the training run; `design` sets the prior of the bodies.
        robots: training environment; its number of robots must be a multiple of `POPULATION`.
        share_spent: function that returns the spent share of the budget.
    """

    def __init__(
        self, config: TrainConfig, robots: CaterpillarVecEnv, share_spent: Callable[[], float]
    ) -> None:
        super().__init__()
        prior = RunConfig(prior="body" if config.design == "body" else "uniform", physics=config.physics)
        self.optimizer = CmaEs(
            prior.distributions()[: len(NAMES)],
            CmaConfig(cma_population=POPULATION, cma_restarts=False),
            np.random.default_rng(config.seed),
        )
        self._robots, self._share_spent = robots, share_spent
        self._genomes = np.empty((0, len(NAMES)))
        self._first_m = np.empty(0)  # distance of each robot's first episode, NaN before its end
        self._frozen = False
        self._fitness: list[Array] = []  # the fitness of all bodies so far, by generation

    def state(self) -> dict[str, Any]:
        """Return the state for `restore`. Call it between two rollouts."""
        learned = [torch.from_numpy(fitness) for fitness in self._fitness]
        return {
            "fitness": learned,
            "first_m": torch.from_numpy(self._first_m.copy()),
            "frozen": self._frozen,
        }

    def restore(self, state: dict[str, Any]) -> None:
        """Continue from a state. CMA-ES is replayed."""
        for fitness in state["fitness"]:
            self._learn(self.optimizer.ask(), fitness.numpy())
        self._first_m = state["first_m"].numpy()
        if self._first_m.size:
            self._genomes = self.optimizer.ask()
        self._frozen = state["frozen"]
        if self._frozen:
            self._robots.set_options({"morphology": [self.mean_body] * self._robots.num_envs})

    def _learn(self, genomes: Array, fitness: Array) -> None:
        self.optimizer.tell(genomes, fitness)
        self._fitness.append(fitness)

    @property
    def mean_genome(self) -> Array:
        """Mean of the CMA-ES search distribution, (8,)."""
        return self.optimizer.centre

    @property
    def mean_body(self) -> Morphology:
        """Body encoded by `mean_genome`."""
        return Morphology.from_unit(self.mean_genome)

    def _on_rollout_start(self) -> None:
        model: Any = self.model
        steps = round(self._robots.vector_env.episode_s / self._robots.vector_env.step_s)
        if model.n_steps != steps:
            raise CaterpillarError(
                f"n_steps = {model.n_steps} must be {steps}, the steps of one episode of "
                f"{self._robots.vector_env.episode_s:g} s, for co-design"
            )
        if self._first_m.size:
            first_m = np.maximum(self._first_m, 0.0)
            self._learn(self._genomes, first_m.reshape(POPULATION, -1).mean(axis=1))
            self._first_m = np.empty(0)
        if self._frozen:
            return
        count = self._robots.num_envs
        if self._share_spent() >= 1.0 - FROZEN_SHARE:
            self._frozen = True
            bodies = [self.mean_body] * count
        else:
            self._genomes = self.optimizer.ask()
            genomes = np.repeat(self._genomes, count // POPULATION, axis=0)
            bodies = [Morphology.from_unit(genome) for genome in genomes]
            self._first_m = np.full(count, np.nan)
        self.training_env.set_options({"morphology": bodies})
        restart(self.model)

    def _on_step(self) -> bool:
        if self._first_m.size:
            for row in np.flatnonzero(np.isnan(self._first_m) & self.locals["dones"]):
                info = self.locals["infos"][row]
                self._first_m[row] = info["distance"] if info["failure"] == Failure.NONE else 0.0
        return True
