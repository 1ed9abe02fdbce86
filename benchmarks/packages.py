"""Optimizers of other packages with ask and tell, for `benchmarks.optimizers`."""

from __future__ import annotations

import queue
import tempfile
import threading
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from caterpillar_env.arrays import Array
from caterpillar_env.errors import CaterpillarError
from caterpillar_env.task import EPISODE_S
from evolution import RunConfig
from evolution.optimizers.base import Optimizer
from evolution.optimizers.ga import GeneticAlgorithm
from evolution.priors.distributions import Gaussian, draw

_POPULATION = 30
_EVALUATIONS = 600  #: slightly more than fit into the budget, for optimizers that plan ahead
_PRIOR_DRAWS = 1000  #: genomes from which WS-CMA-ES learns the prior
_CREEP = 0.05  #: standard deviation of a creep mutation, as a share of the range
_CREEP_RATE = 0.2  #: probability that a gene creeps


class Asked:
    """Ask/tell interface to a minimizer that calls a cost function, genomes (P, n) -> costs (P,).

    The function runs in a thread of its own, which ends with the process.
    """

    def __init__(self, minimize: Callable[[Callable[[Any], list[float]]], Any]) -> None:
        self._genomes: queue.Queue[Array] = queue.Queue()
        self._costs: queue.Queue[list[float]] = queue.Queue()
        self._thread = threading.Thread(target=minimize, args=(self._evaluate,), daemon=True)

    def _evaluate(self, genomes: Any) -> list[float]:
        self._genomes.put(np.clip(np.atleast_2d(np.asarray(genomes, dtype=float)), 0.0, 1.0))
        return self._costs.get()

    def ask(self) -> Array:
        """Return the genomes whose costs the minimizer asks for, (P, n)."""
        if not self._thread.ident:
            self._thread.start()
        while self._thread.is_alive():
            try:
                return self._genomes.get(timeout=1.0)
            except queue.Empty:
                continue
        raise CaterpillarError("the optimizer ended before the budget was spent")

    def tell(self, genomes: Array, fitness: Array) -> None:
        """Pass the costs of these genomes to the minimizer."""
        self._costs.put((-fitness).tolist())


def start(config: RunConfig) -> tuple[Array, Array]:
    """Return the peak and the width of each gene's prior, with which evolution strategies begin."""
    shapes = config.distributions()
    peaks = [d.mu if isinstance(d, Gaussian) else 0.5 for d in shapes]
    widths = [min(d.sigma, 0.3) if isinstance(d, Gaussian) else 0.3 for d in shapes]
    return np.clip(peaks, 0.05, 0.95), np.array(widths)


class LearningRate:
    """LRA-CMA-ES of cmaes: adapts its learning rate to noisy and multimodal functions."""

    def __init__(self, config: RunConfig) -> None:
        import cmaes

        peaks, widths = start(config)
        self._strategy = cmaes.CMA(
            peaks, 1.0, np.tile([0.0, 1.0], (len(peaks), 1)), cov=np.diag(widths**2),
            seed=config.seed, lr_adapt=True,
        )  # fmt: skip

    def ask(self) -> Array:
        """Return the genomes of a generation, (P, n)."""
        return np.array([self._strategy.ask() for _ in range(self._strategy.population_size)])

    def tell(self, genomes: Array, fitness: Array) -> None:
        """Receive their fitness, (P,)."""
        self._strategy.tell([(g, -f) for g, f in zip(genomes, fitness.tolist(), strict=True)])


class Creep(GeneticAlgorithm):
    """Genetic algorithm whose mutation moves a gene by a small step instead of redrawing it."""

    def __init__(self, config: RunConfig) -> None:
        rng, shapes = np.random.default_rng(config.seed), config.distributions()
        super().__init__(shapes, shapes, replace(config.ga, mutation_rate=0.0), rng)
        self._circular = [gene.circular for gene in config.encoding.genes]

    def _breed(self, count: int) -> Array:
        children = super()._breed(count)
        crept = children + _CREEP * self._rng.standard_normal(children.shape)
        crept = np.where(self._circular, crept % 1.0, np.clip(crept, 0.0, 1.0))
        return np.where(self._rng.random(children.shape) < _CREEP_RATE, crept, children)


class Centred:
    """Base class of optimizers whose circular genes are shifted so that the priors peak at 0.5."""

    def __init__(self, config: RunConfig) -> None:
        rows = zip(config.distributions(), config.encoding.genes, strict=True)
        peaks = [d.mu if gene.circular and isinstance(d, Gaussian) else 0.5 for d, gene in rows]
        self._shift = np.array(peaks) - 0.5

    def _from_genes(self, genomes: Array) -> Array:
        return np.where(self._shift == 0.0, genomes, (genomes - self._shift) % 1.0)

    def _to_genes(self, points: Array) -> Array:
        shifted = (points + self._shift) % 1.0
        return np.where(self._shift == 0.0, np.clip(points, 0.0, 1.0), shifted)


class WarmStart(Centred):
    """WS-CMA-ES of cmaes (Nomura et al. 2021): begins with a Gaussian fitted to the prior."""

    def __init__(self, config: RunConfig) -> None:
        import cmaes

        super().__init__(config)
        shapes = config.distributions()
        genomes = draw(shapes, np.random.default_rng(config.seed), _PRIOR_DRAWS)
        density = np.prod([d.density(x) for d, x in zip(shapes, genomes.T, strict=True)], axis=0)
        known = list(zip(self._from_genes(genomes), (-density).tolist(), strict=True))
        mean, sigma, covariance = cmaes.get_warm_start_mgd(known)
        self._strategy = cmaes.CMA(
            mean, sigma, np.tile([0.0, 1.0], (len(mean), 1)), cov=covariance, seed=config.seed
        )
        self._asked: list[Array] = []

    def ask(self) -> Array:
        """Return the genomes of a generation, (P, n)."""
        self._asked = [self._strategy.ask() for _ in range(self._strategy.population_size)]
        return self._to_genes(np.array(self._asked))

    def tell(self, genomes: Array, fitness: Array) -> None:
        """Receive their fitness, (P,)."""
        self._strategy.tell([(p, -f) for p, f in zip(self._asked, fitness.tolist(), strict=True)])


class PiBO(Centred):
    """piBO of SMAC (Hvarfner et al. 2022): Bayesian optimization that weights genomes by their prior.

    It simulates one robot at a time, to the end. The weight of the prior decays with the number of
    robots.
    """

    def __init__(self, config: RunConfig) -> None:
        import ConfigSpace
        import smac
        from smac.acquisition.function import EI, PriorAcquisitionFunction

        super().__init__(config)
        space = ConfigSpace.ConfigurationSpace(seed=config.seed)
        self._names = [f"gene{number:03d}" for number in range(len(self._shift))]
        rows = zip(self._names, config.distributions(), self._shift, strict=True)
        for name, shape, shift in rows:
            if isinstance(shape, Gaussian):
                space.add(
                    ConfigSpace.NormalFloatHyperparameter(
                        name, mu=shape.mu - shift, sigma=shape.sigma, lower=0.0, upper=1.0
                    )
                )
            else:
                space.add(ConfigSpace.UniformFloatHyperparameter(name, 0.0, 1.0))
        trials = round((config.budget_s or 0.0) / EPISODE_S)
        self._folder = tempfile.TemporaryDirectory()
        scenario = smac.Scenario(
            space, output_directory=Path(self._folder.name), seed=config.seed, deterministic=True,
            n_trials=_EVALUATIONS,
        )  # fmt: skip
        facade = smac.HyperparameterOptimizationFacade
        self._smac = facade(
            scenario, lambda config, seed: 0.0, logging_level=False,
            acquisition_function=PriorAcquisitionFunction(EI(log=True), decay_beta=trials / 10),
            initial_design=smac.initial_design.RandomInitialDesign(scenario, n_configs=_POPULATION),
        )  # fmt: skip
        self._trial: Any = None

    def ask(self) -> Array:
        """Return the next genome, (1, n)."""
        self._trial = self._smac.ask()
        point = np.array([[self._trial.config[name] for name in self._names]])
        return self._to_genes(point)

    def tell(self, genomes: Array, fitness: Array) -> None:
        """Receive its fitness, (1,)."""
        from smac.runhistory.dataclasses import TrialValue

        self._smac.tell(self._trial, TrialValue(cost=-float(fitness[0])), save=False)


def lq_surrogate(config: RunConfig) -> Asked:
    """Return lq-CMA-ES of pycma, with a linear-quadratic surrogate and restarts."""
    import cma

    peaks, widths = start(config)
    options = {
        "bounds": [0.0, 1.0], "CMA_stds": widths / 0.3, "seed": config.seed + 1, "verbose": -9,
        "verb_log": 0,
    }  # fmt: skip
    return Asked(
        lambda function: cma.fmin_lq_surr2(lambda x: function([x])[0], peaks, 0.3, options, restarts=100)
    )


def from_minion(name: str, config: RunConfig, first: Array, options: dict[str, Any]) -> Asked:
    """Return an optimizer of minionpy that begins with the genomes `first`, (P, n)."""
    import minionpy

    def minimize(function: Callable[[Any], list[float]]) -> None:
        bounds = [(0.0, 1.0)] * first.shape[1]
        maker = getattr(minionpy, name)
        maker(
            function, bounds, first.tolist(), maxevals=_EVALUATIONS, seed=config.seed, options=options
        ).optimize()

    return Asked(minimize)


def l_shade(config: RunConfig) -> Asked:
    """Return L-SHADE of minionpy: SHADE with a population that shrinks."""
    rng = np.random.default_rng(config.seed)
    first = draw(config.distributions(), rng, _POPULATION)
    return from_minion("LSHADE", config, first, {"population_size": _POPULATION})


def bipop(config: RunConfig) -> Asked:
    """Return BIPOP-aCMA-ES of minionpy: restarts with large and small populations."""
    return from_minion("BIPOP_aCMAES", config, start(config)[0][None], {"rel_initial_step": 0.15})


OTHERS: dict[str, Callable[[RunConfig], Optimizer]] = {
    "ga-creep": Creep,
    "bipop-cma-es": bipop,
    "lra-cma-es": LearningRate,
    "lq-cma-es": lq_surrogate,
    "l-shade": l_shade,
    "ws-cma-es": WarmStart,
    "pibo": PiBO,
}
