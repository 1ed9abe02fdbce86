"""The paper's genetic algorithm (Saunders 2009, sections II and IV)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from caterpillar_env.arrays import Array
from caterpillar_env.errors import CaterpillarError, check_fields
from evolution.optimizers.base import MAX_POPULATION, GenerationalOptimizer
from evolution.priors.distributions import Distribution, draw

Crossover = Literal["uniform", "one-point", "two-point"]

_BOUNDS = {
    "population": (2, MAX_POPULATION), "hall_of_fame": (0, MAX_POPULATION),
    "crossover_rate": (0.0, 1.0), "mutation_rate": (0.0, 1.0),
}  # fmt: skip


@dataclass(frozen=True)
class GaConfig:
    """Settings of the genetic algorithm.

    The paper gives the sizes of the population and of the hall of fame, whose genomes are neither
    crossed nor mutated. The other defaults are our interpretation.

    Raises:
        CaterpillarError: a value is out of range.
    """

    population: int = 200  #: genomes per generation, for random search too
    hall_of_fame: int = 10  #: number of best genomes to keep without another evaluation
    crossover: Crossover = "uniform"  #: how the genes of two parents are combined
    crossover_rate: float = 0.9  #: fraction of children with two parents; the others copy one parent
    mutation_rate: float = 0.05  #: probability that a gene is redrawn; 0.05 is one gene in twenty
    elites_breed: bool = False  #: whether the hall of fame takes part in parent selection too

    def __post_init__(self) -> None:
        check_fields(self, _BOUNDS)

    @property
    def elites(self) -> int:
        """Effective size of the hall of fame: half of the population if `hall_of_fame` is too large."""
        return self.hall_of_fame if self.hall_of_fame < self.population else self.population // 2


def roulette(fitness: Array, draws: int, rng: np.random.Generator) -> NDArray[np.intp]:
    """Draw indices with probability proportional to fitness (Saunders 2009, section II).

    If no fitness is positive, all indices are equally likely.

    Args:
        fitness: finite values that are not negative, (n,).
        draws: number of indices to draw.
        rng: source of randomness.

    Raises:
        CaterpillarError: a fitness value is negative or not finite.
    """
    if not (np.isfinite(fitness).all() and (fitness >= 0).all()):
        raise CaterpillarError("roulette selection needs fitness that is finite and not negative")
    peak = fitness.max(initial=0.0)
    weight = fitness / peak if peak > 0 else np.ones_like(fitness)  # avoids overflow and underflow
    wheel = np.cumsum(weight)
    index: NDArray[np.intp] = np.searchsorted(wheel, rng.random(draws) * wheel[-1], side="right")
    # Rounding may produce an index past the last one with a positive weight.
    last = int(np.flatnonzero(weight)[-1])
    return np.minimum(index, last, dtype=np.intp)


class GeneticAlgorithm(GenerationalOptimizer):
    """Genetic algorithm with roulette selection, crossover, mutation and a hall of fame.

    Mutation redraws a gene from its distribution. The first generation is a full population. Later
    generations exclude the genomes of the hall of fame, because their fitness is known.

    Args:
        initial: distribution of each gene in the first population.
        mutation: distribution of each gene for mutations.
        config: settings of the genetic algorithm.
        rng: the only source of randomness.
    """

    def __init__(
        self,
        initial: Sequence[Distribution],
        mutation: Sequence[Distribution],
        config: GaConfig,
        rng: np.random.Generator,
    ) -> None:
        super().__init__()
        self._initial, self._mutation = list(initial), list(mutation)
        self._config = config
        self._rng = rng
        self._genomes = np.empty((0, len(self._initial)))  # the last population, best first
        self._fitness = np.empty(0)

    def _propose(self) -> Array:
        if not len(self._genomes):
            return draw(self._initial, self._rng, self._config.population)
        return self._breed(self._config.population - self._config.elites)

    def _learn(self, genomes: Array, fitness: Array) -> None:
        elites = self._config.elites
        population = np.concatenate([self._genomes[:elites], genomes])
        scores = np.concatenate([self._fitness[:elites], fitness])
        order = np.argsort(-scores, kind="stable")  # ties go to the older genome
        self._genomes, self._fitness = population[order], scores[order]

    def _breed(self, count: int) -> Array:
        """Return children, (count, n). The elites are parents only if `elites_breed` is set."""
        first = 0 if self._config.elites_breed else self._config.elites
        pool, fitness = self._genomes[first:], self._fitness[first:]
        weight = fitness - min(fitness.min(), 0.0)  # an objective may be negative, but weights may not
        mothers = pool[roulette(weight, count, self._rng)]
        fathers = pool[roulette(weight, count, self._rng)]
        children = np.where(self._crossover_mask(count), fathers, mothers)
        mutated = self._rng.random(children.shape) < self._config.mutation_rate
        return np.where(mutated, draw(self._mutation, self._rng, count), children)

    def _crossover_mask(self, count: int) -> NDArray[np.bool_]:
        """Return a mask, (count, n), of the genes that come from the second parent."""
        num_genes = len(self._initial)
        crossed = self._rng.random(count) < self._config.crossover_rate
        if self._config.crossover == "uniform":
            mask = self._rng.random((count, num_genes)) < 0.5
        else:
            points = 1 if self._config.crossover == "one-point" else 2
            cuts = self._rng.integers(1, num_genes, size=(count, points))
            passed = np.arange(num_genes)[None, :, None] >= cuts[:, None, :]
            mask = passed.sum(axis=2) % 2 == 1
        return mask & crossed[:, None]
