"""Random search: genomes drawn independently, or spread evenly by a Sobol' sequence."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np
from scipy.stats import qmc

from caterpillar_env.arrays import Array
from caterpillar_env.errors import check_choice
from evolution.optimizers.base import OptimizerError, check_told
from evolution.priors.distributions import Distribution

Sampling = Literal["independent", "sobol"]


class RandomSearch:
    """Ask for genomes; what is told makes no difference.

    Args:
        distributions: of each gene.
        population: genomes asked for at a time; makes no difference to which are drawn.
        sampling: "independent", or "sobol" for a scrambled sequence (Owen 1998).
        rng: the only source of randomness.

    Raises:
        OptimizerError: a value is out of range.
    """

    def __init__(
        self,
        distributions: Sequence[Distribution],
        population: int,
        sampling: Sampling,
        rng: np.random.Generator,
    ) -> None:
        if population < 1:
            raise OptimizerError(f"population = {population} must be at least 1")
        check_choice("sampling", sampling, Sampling, OptimizerError)
        self._distributions = list(distributions)
        self._population = population
        self._rng = rng
        self._sobol = qmc.Sobol(len(self._distributions), rng=rng) if sampling == "sobol" else None
        self._asked: Array | None = None

    def ask(self) -> Array:
        """The next genomes, (population, n)."""
        if self._asked is None:
            shape = (self._population, len(self._distributions))
            shares = self._rng.random(shape) if self._sobol is None else self._points()
            columns = [d.quantile(shares[:, i]) for i, d in enumerate(self._distributions)]
            self._asked = np.stack(columns, axis=1)
        return self._asked.copy()

    def _points(self) -> Array:
        assert self._sobol is not None
        # One by one: SciPy warns of numbers of points that are no power of two, and is right
        # for integration, which this is not.
        points: Array = np.concatenate([self._sobol.random(1) for _ in range(self._population)])
        return points

    def tell(self, genomes: Array, fitness: Array) -> None:
        """Take the fitness of the genomes last asked for.

        Raises:
            OptimizerError: other genomes, or fitness of another shape.
        """
        check_told(self._asked, genomes, fitness)
        self._asked = None
