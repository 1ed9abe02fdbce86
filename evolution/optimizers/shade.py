"""SHADE: differential evolution with success-history adaptation (Tanabe and Fukunaga 2013)."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from caterpillar_env.arrays import Array
from caterpillar_env.errors import CaterpillarError, check_fields
from evolution.optimizers.base import MAX_POPULATION, GenerationalOptimizer
from evolution.priors.distributions import Distribution, draw

DRAWS = 2  #: size of the first generation relative to the population; the best genomes are kept
_MEMORY = 5  #: memory size: number of pairs of scale and crossover rate
_LARGEST_SHARE = 0.2  #: maximum of p; a target is drawn from the best share p of the population


@dataclass(frozen=True)
class ShadeConfig:
    """Settings of SHADE.

    Raises:
        CaterpillarError: a value is out of range.
    """

    shade_population: int = 30  #: genomes per generation
    #: candidates per genome; only the one with the largest predicted advance (K_5) is simulated
    shade_candidates: int = 1

    def __post_init__(self) -> None:
        check_fields(
            self, {"shade_population": (4, MAX_POPULATION), "shade_candidates": (1, MAX_POPULATION)}
        )


class Shade(GenerationalOptimizer):
    """SHADE with an ask/tell interface.

    For each genome x of the population, a trial genome is created by crossover of x and the mutant
    x + F (target - x) + F (a - b). The target is one of the best genomes, a is another genome of the
    population, and b is a third one or a genome from the archive of replaced genomes. The trial replaces
    x if its fitness is at least as high. The scale F and the crossover rate are sampled around values
    that recently improved genomes.

    With `shade_candidates` > 1, several candidates are generated for each genome of the first generation
    and for each trial, and `predict` chooses one of them.

    Args:
        distributions: distribution of each gene, for the first population.
        config: settings of SHADE.
        rng: the only source of randomness.
        circular: whether each gene is circular; by default, none is.
        predict: function that returns scores (P,) of genomes (P, n), to choose among candidates. Higher
            is better; a score that is not finite counts as the worst.

    Raises:
        CaterpillarError: there are several candidates and no `predict`.
    """

    def __init__(
        self,
        distributions: Sequence[Distribution],
        config: ShadeConfig,
        rng: np.random.Generator,
        circular: Sequence[bool] | None = None,
        predict: Callable[[Array], Array] | None = None,
    ) -> None:
        super().__init__()
        if config.shade_candidates > 1 and predict is None:
            raise CaterpillarError(
                f"shade_candidates = {config.shade_candidates} needs predict, which scores candidates"
            )
        self._distributions, self._rng = list(distributions), rng
        self._candidates, self._predict = config.shade_candidates, predict
        self._size = config.shade_population
        self._circular = np.array(circular or [False] * len(distributions))
        self._genomes = np.empty((0, len(distributions)))
        self._fitness = np.empty(0)
        self._former = np.empty((0, len(distributions)))  # archive of replaced genomes, at most `_size`
        self._memory = np.full((2, _MEMORY), 0.5)  # scales and crossover rates
        self._oldest = 0  # index of the memory entry to replace next
        self._used = np.empty((2, 0))  # scales and crossover rates of the last trials

    def _propose(self) -> Array:
        if not len(self._genomes):
            count = DRAWS * self._size
            drawn = draw(self._distributions, self._rng, self._candidates * count)
            candidates = drawn.reshape(self._candidates, count, -1)
            return candidates[self._choose(candidates), np.arange(count)]
        settings = np.array([self._draw_settings() for _ in range(self._candidates)])
        candidates = np.array([self._mix(*each) for each in settings])
        chosen, rows = self._choose(candidates), np.arange(self._size)
        self._used = settings[chosen, :, rows].T
        return candidates[chosen, rows]

    def _choose(self, candidates: Array) -> NDArray[np.intp]:
        """Return the index of the best candidate for each genome, (P,), from candidates (C, P, n)."""
        if self._predict is None:
            return np.zeros(candidates.shape[1], dtype=np.intp)
        predicted = self._predict(candidates.reshape(-1, candidates.shape[2]))
        scores = np.where(np.isfinite(predicted), predicted, -np.inf)
        best: NDArray[np.intp] = scores.reshape(candidates.shape[:2]).argmax(axis=0)
        return best

    def _mix(self, scale: Array, rate: Array) -> Array:
        """Return a trial for each genome, (N, n), from its scale and crossover rate, (N,)."""
        x = self._genomes
        ahead, other = self._draw_differences()
        mutants = x + scale[:, None] * (ahead + other)
        bounced = np.where(mutants < 0, x / 2, np.where(mutants > 1, (1 + x) / 2, mutants))
        mutants = np.where(self._circular, mutants % 1.0, bounced)
        mixed = self._rng.random(x.shape) < rate[:, None]
        mixed[np.arange(self._size), self._rng.integers(x.shape[1], size=self._size)] = True
        return np.where(mixed, mutants, x)

    def _learn(self, genomes: Array, fitness: Array) -> None:
        if not len(self._genomes):
            best = np.argsort(-fitness, kind="stable")[: self._size]
            self._genomes, self._fitness = genomes[best], fitness[best]
            return
        gain = fitness - self._fitness
        former = np.concatenate([self._former, self._genomes[gain > 0]])
        kept = self._rng.permutation(len(former))[: self._size]
        self._former = former[np.sort(kept)]
        if (gain > 0).any():
            used, weight = self._used[:, gain > 0], gain[gain > 0]
            # The Lehmer mean favours large values, which counters early convergence. For the crossover
            # rate, it is the mean of L-SHADE (2014); SHADE (2013) uses the arithmetic mean.
            self._memory[:, self._oldest] = (weight * used**2).sum(1) / (weight * used).sum(1)
            self._oldest = (self._oldest + 1) % _MEMORY
        better = gain >= 0
        self._genomes = np.where(better[:, None], genomes, self._genomes)
        self._fitness = np.where(better, fitness, self._fitness)

    def _draw_settings(self) -> Array:
        """Return the scale and the crossover rate of each trial, (2, N)."""
        scales, rates = self._memory[:, self._rng.integers(_MEMORY, size=self._size)]
        tails = self._rng.random(self._size)
        # Draw from a Cauchy distribution around the remembered scale, truncated at 0.
        lowest = 0.5 - np.arctan(scales / 0.1) / np.pi
        tails = lowest + (1 - lowest) * tails
        drawn = scales + 0.1 * np.tan(np.pi * (tails - 0.5))
        return np.stack([np.clip(drawn, 1e-3, 1.0), np.clip(self._rng.normal(rates, 0.1), 1e-3, 1.0)])

    def _draw_differences(self) -> tuple[Array, Array]:
        """Return target - x and a - b of the mutant of each genome x, (N, n) each; see `Shade`."""
        n, x, number = self._size, self._genomes, np.arange(self._size)
        order = np.argsort(-self._fitness, kind="stable")
        shares = self._rng.uniform(min(2 / n, _LARGEST_SHARE), _LARGEST_SHARE, n)
        num_best = np.maximum((shares * n).astype(int), 1)
        targets = order[(self._rng.random(n) * num_best).astype(int)]
        one = self._rng.integers(n - 1, size=n)
        one += one >= number  # not the genome itself
        pool = np.concatenate([x, self._former])
        two = self._rng.integers(len(pool) - 2, size=n)
        for taken in np.sort([number, one], axis=0):  # neither the genome itself nor `one`
            two += two >= taken
        return self._subtract(x[targets], x), self._subtract(x[one], pool[two])

    def _subtract(self, a: Array, b: Array) -> Array:
        """Return a - b; for circular genes, along the shorter arc."""
        difference = a - b
        return np.where(self._circular, (difference + 0.5) % 1.0 - 0.5, difference)
