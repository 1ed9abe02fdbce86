"""What optimizers have in common: ask for genomes in [0, 1], be told how fit they are."""

from __future__ import annotations

from typing import Protocol

import numpy as np

from caterpillar_env.arrays import Array
from caterpillar_env.errors import CaterpillarError


class OptimizerError(CaterpillarError):
    """An optimizer was configured or called wrongly."""


class Optimizer(Protocol):
    """Anything that asks and is told can drive a run, if the same answers lead to the same questions.

    All randomness must come from a generator that it was given, so that a run can be resumed by asking
    once more.
    """

    def ask(self) -> Array:
        """Genomes to evaluate, in [0, 1], shape (P, n); P may differ from one time to the next."""
        ...

    def tell(self, genomes: Array, fitness: Array) -> None:
        """Take the fitness, (P,), of the genomes last asked for; the greater the better."""
        ...


def check_told(asked: Array | None, genomes: Array, fitness: Array) -> None:
    """Whether `fitness` answers what was asked.

    Raises:
        OptimizerError: other genomes, fitness of another shape, negative or not finite.
    """
    if asked is None or not np.array_equal(genomes, asked):
        raise OptimizerError("tell takes exactly the genomes that ask gave, in their order")
    if fitness.shape != (len(genomes),):
        raise OptimizerError(f"fitness must have shape ({len(genomes)},); got {fitness.shape}")
    if not (np.isfinite(fitness).all() and (fitness >= 0).all()):
        raise OptimizerError("fitness must be finite and not negative; a failure needs a value too")
