"""Random search: independent draws, or a low-discrepancy Sobol' sequence."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal

import numpy as np

from caterpillar_env.arrays import Array
from evolution.optimizers.base import GenerationalOptimizer
from evolution.priors.distributions import Distribution

Sampling = Literal["independent", "sobol"]


class RandomSearch(GenerationalOptimizer):
    """Draws genomes from the distributions of the genes; the fitness is ignored.

    Args:
        distributions: distribution of each gene.
        population: number of genomes per generation. The sequence of genomes does not depend on it.
        sampling: "independent", or "sobol" for a scrambled Sobol' sequence (Owen 1998).
        rng: the only source of randomness.
    """

    def __init__(
        self,
        distributions: Sequence[Distribution],
        population: int,
        sampling: Sampling,
        rng: np.random.Generator,
    ) -> None:
        super().__init__()
        self._distributions = list(distributions)
        self._population = population
        self._rng = rng
        self._sobol = None
        if sampling == "sobol":
            from scipy.stats import qmc  # slow to import

            self._sobol = qmc.Sobol(len(self._distributions), rng=rng)

    def _propose(self) -> Array:
        if self._sobol is None:
            shares = self._rng.random((self._population, len(self._distributions)))
        else:
            # Draw one point at a time, because SciPy warns if the number of points is not a power of
            # two. Such a number would reduce the accuracy of numerical integration only.
            shares = np.concatenate([self._sobol.random(1) for _ in range(self._population)])
        columns = [d.quantile(shares[:, i]) for i, d in enumerate(self._distributions)]
        return np.stack(columns, axis=1)
