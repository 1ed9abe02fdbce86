"""The ask/tell interface: optimizers propose genomes in [0, 1]^n and receive their fitness."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from caterpillar_env.arrays import Array
from caterpillar_env.errors import CaterpillarError

MAX_POPULATION = 1_000_000  #: largest number of genomes in a generation


class Optimizer(Protocol):
    """Interface of an optimizer that can drive a run.

    The same fitness values must lead to the same genomes, because a run is resumed by replaying its
    recorded fitness: take all randomness from a seeded generator.
    """

    def ask(self) -> Array:
        """Return the genomes to evaluate next, in [0, 1], shape (P, n). P may change between calls."""
        ...

    def tell(self, genomes: Array, fitness: Array) -> None:
        """Receive the fitness, (P,), of the genomes that `ask` returned. Higher is better."""
        ...


class GenerationalOptimizer:
    """Base class that checks the order of calls. Subclasses implement `_propose` and `_learn`."""

    def __init__(self) -> None:
        self._asked: Array | None = None

    def ask(self) -> Array:
        """Return the genomes to evaluate, (P, n). They stay the same until `tell` is called."""
        if self._asked is None:
            self._asked = self._propose()
        return self._asked.copy()

    def tell(self, genomes: Array, fitness: Array) -> None:
        """Receive the fitness, (P,), of the genomes that `ask` returned. Higher is better.

        Raises:
            CaterpillarError: the genomes differ from those that `ask` returned, or the fitness has the
                wrong shape or non-finite values.
        """
        if self._asked is None or not np.array_equal(genomes, self._asked):
            raise CaterpillarError("tell needs exactly the genomes that ask returned, in the same order")
        if fitness.shape != (len(genomes),):
            raise CaterpillarError(f"fitness must have shape ({len(genomes)},); got {fitness.shape}")
        if not np.isfinite(fitness).all():
            raise CaterpillarError("fitness must be finite; assign a finite value to failures too")
        self._learn(genomes, fitness)
        self._asked = None

    def _propose(self) -> Array:
        """Return the genomes of the next generation, (P, n)."""
        raise NotImplementedError

    def _learn(self, genomes: Array, fitness: Array) -> None:
        """Update the state with a generation and its fitness."""
