"""The paper's genetic algorithm (Saunders 2009, sections II and IV)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from caterpillar_env.arrays import Array
from caterpillar_env.errors import check_choice
from evolution.optimizers.base import OptimizerError, check_told
from evolution.priors.distributions import Distribution

Crossover = Literal["uniform", "one-point", "two-point"]


@dataclass(frozen=True)
class GaConfig:
    """Settings of the genetic algorithm.

    The paper gives the population and the hall of fame, which is neither crossed nor mutated; the other
    defaults are our readings.

    Raises:
        OptimizerError: a value is out of range.
    """

    population: int = 200  #: genomes of a generation, of random search too
    hall_of_fame: int = 10  #: best genomes carried over unchanged and not evaluated again
    crossover: Crossover = "uniform"  #: how the genes of two parents are mixed
    crossover_rate: float = 0.9  #: share of children with two parents; the others copy one
    mutation_rate: float = 0.05  #: chance of each gene to be drawn afresh; at 0.05 one of twenty is
    elites_breed: bool = False  #: whether the hall of fame takes part in the roulette too

    def __post_init__(self) -> None:
        if self.population < 2:
            raise OptimizerError(f"population = {self.population} must be at least 2")
        if not 0 <= self.hall_of_fame < self.population:
            raise OptimizerError(
                f"hall_of_fame = {self.hall_of_fame} must be from 0 to "
                f"population - 1 = {self.population - 1}"
            )
        for name in ("crossover_rate", "mutation_rate"):
            if not 0 <= getattr(self, name) <= 1:
                raise OptimizerError(f"{name} = {getattr(self, name)} must lie in [0, 1]")
        check_choice("crossover", self.crossover, Crossover, OptimizerError)


def roulette(fitness: Array, draws: int, rng: np.random.Generator) -> NDArray[np.intp]:
    """Indices drawn with probability directly proportional to fitness (Saunders 2009, section II).

    When no fitness is positive, every index is equally likely.

    Args:
        fitness: not negative and finite, (n,).
        draws: how many.
        rng: source of randomness.

    Raises:
        OptimizerError: negative, NaN or infinite fitness.
    """
    if not (np.isfinite(fitness).all() and (fitness >= 0).all()):
        raise OptimizerError("roulette selection needs fitness that is finite and not negative")
    peak = fitness.max(initial=0.0)
    weight = fitness / peak if peak > 0 else np.ones_like(fitness)  # no overflow, no underflow
    wheel = np.cumsum(weight)
    drawn: NDArray[np.intp] = np.searchsorted(wheel, rng.random(draws) * wheel[-1], side="right")
    # Rounding may point past the end; the last index with any weight is meant.
    last = int(np.flatnonzero(weight)[-1])
    return np.minimum(drawn, last, dtype=np.intp)


class GeneticAlgorithm:
    """Ask for genomes, evaluate them, tell their fitness; a generation a time.

    Args:
        initial: distributions of the genes of the first population.
        mutation: distributions that mutated genes are drawn from.
        config: settings.
        rng: the only source of randomness.
    """

    def __init__(
        self,
        initial: Sequence[Distribution],
        mutation: Sequence[Distribution],
        config: GaConfig,
        rng: np.random.Generator,
    ) -> None:
        self._initial, self._mutation = list(initial), list(mutation)
        self._config = config
        self._rng = rng
        self._elite_genomes = np.empty((0, len(self._initial)))
        self._elite_fitness = np.empty(0)
        self._asked: Array | None = None
        self._genomes: Array | None = None  # the last full population, best first
        self._fitness = np.empty(0)

    def ask(self) -> Array:
        """Genomes to evaluate: the whole first population, later all but the hall of fame, (P, n)."""
        if self._asked is None:
            if self._genomes is None:
                self._asked = self._draw(self._initial, self._config.population)
            else:
                self._asked = self._breed(self._config.population - self._config.hall_of_fame)
        return self._asked.copy()

    def tell(self, genomes: Array, fitness: Array) -> None:
        """Take the fitness of the genomes last asked for.

        Raises:
            OptimizerError: other genomes, or fitness of another shape, negative or not finite.
        """
        check_told(self._asked, genomes, fitness)
        everyone = np.concatenate([self._elite_genomes, genomes])
        scores = np.concatenate([self._elite_fitness, fitness])
        order = np.argsort(-scores, kind="stable")  # of equals the older stays in front
        self._genomes, self._fitness = everyone[order], scores[order]
        elites = self._config.hall_of_fame
        self._elite_genomes, self._elite_fitness = self._genomes[:elites], self._fitness[:elites]
        self._asked = None

    def _draw(self, distributions: Sequence[Distribution], count: int) -> Array:
        return np.stack([d.sample(self._rng, count) for d in distributions], axis=1)

    def _breed(self, count: int) -> Array:
        """Children of the rest, which the hall of fame joins only where it breeds, (count, n)."""
        assert self._genomes is not None
        first = 0 if self._config.elites_breed else self._config.hall_of_fame
        pool, fitness = self._genomes[first:], self._fitness[first:]
        mothers = pool[roulette(fitness, count, self._rng)]
        fathers = pool[roulette(fitness, count, self._rng)]
        children = np.where(self._from_father(count), fathers, mothers)
        mutated = self._rng.random(children.shape) < self._config.mutation_rate
        return np.where(mutated, self._draw(self._mutation, count), children)

    def _from_father(self, count: int) -> NDArray[np.bool_]:
        """Which genes come from the second parent, (count, n)."""
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
