"""CMA-ES (Hansen 2016) on [0, 1]^n, from pycma, with restarts (Auger and Hansen 2005)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from caterpillar_env.arrays import Array
from caterpillar_env.errors import check_fields
from evolution.optimizers.base import MAX_POPULATION, GenerationalOptimizer
from evolution.priors.distributions import Distribution, Gaussian, draw

if TYPE_CHECKING:
    import cma


@dataclass(frozen=True)
class CmaConfig:
    """Settings of CMA-ES.

    Raises:
        CaterpillarError: a value is out of range.
    """

    cma_population: int | None = None  #: genomes per generation; default for n genes: 4 + 3 ln n
    cma_sigma: float = 0.3  #: initial step size, as a share of the range; a narrower prior reduces it
    cma_restarts: bool = True  #: whether to restart with twice the population after convergence

    def __post_init__(self) -> None:
        check_fields(self, {"cma_population": (4, MAX_POPULATION), "cma_sigma": (1e-9, 1.0)})


class CmaEs(GenerationalOptimizer):
    """CMA-ES with an ask/tell interface.

    The search starts at the peak of each gene's distribution. The initial step size of a gene is the
    standard deviation of this distribution, but at most `cma_sigma`. Genes with a uniform distribution
    start at 0.5, with the step size `cma_sigma`. Restarts begin at a random draw from the distributions.
    pycma transforms the genes so that every genome lies within the bounds. Circular genes are not
    bounded; they wrap around from 1 to 0.

    Args:
        distributions: distribution of each gene.
        config: settings of CMA-ES.
        rng: the only source of randomness.
        circular: whether each gene is circular; by default, none is.
    """

    def __init__(
        self,
        distributions: Sequence[Distribution],
        config: CmaConfig,
        rng: np.random.Generator,
        circular: Sequence[bool] | None = None,
    ) -> None:
        super().__init__()
        self._circular = np.array(circular or [False] * len(distributions))
        self._points: list[Array] = []  # points that pycma proposed last, before wrapping
        self._distributions = list(distributions)
        self._config = config
        self._rng = rng
        peaks = [d.mu if isinstance(d, Gaussian) else 0.5 for d in self._distributions]
        self._strategy = self._make_strategy(np.array(peaks), config.cma_population)
        self._is_flat = False  # whether all fitness values of the last generation are equal

    @property
    def centre(self) -> Array:
        """The mean of the search distribution, (n,)."""
        return self._wrap(np.array(self._strategy.result.xfavorite))

    def _propose(self) -> Array:
        # Equal fitness, for example if every robot fails, does not mean convergence.
        if self._config.cma_restarts and not self._is_flat and self._strategy.stop():
            (start,) = draw(self._distributions, self._rng, 1)
            self._strategy = self._make_strategy(start, 2 * self._strategy.popsize)
        self._points = self._strategy.ask()
        return self._wrap(np.array(self._points))

    def _learn(self, genomes: Array, fitness: Array) -> None:
        self._strategy.tell(self._points, (-fitness).tolist())  # pycma minimizes
        self._is_flat = bool(np.ptp(fitness) == 0)

    def _wrap(self, points: Array) -> Array:
        """Return the genomes, in [0, 1], for points in the space of pycma."""
        wrapped: Array = np.where(self._circular, points % 1.0, np.clip(points, 0.0, 1.0))
        return wrapped

    def _make_strategy(self, start: Array, population: int | None) -> cma.CMAEvolutionStrategy:
        import cma  # slow to import, because it imports Matplotlib

        sigma = self._config.cma_sigma
        widths = [min(d.sigma, sigma) if isinstance(d, Gaussian) else sigma for d in self._distributions]
        options = {
            "bounds": [[None if c else bound for c in self._circular] for bound in (0.0, 1.0)],
            "CMA_stds": [width / sigma for width in widths],
            "randn": lambda *shape: self._rng.standard_normal(shape),
            "seed": np.nan,  # keeps pycma from seeding NumPy's global generator
            "verbose": -9,
            "verb_log": 0,
            "signals_filename": "",  # pycma would read options from a file in the working folder
            "tolflatfitness": 20,
        }
        if population is not None:
            options["popsize"] = population
        # pycma's transformation to the bounds is flat at 0 and 1, and the identity from 0.05 to 0.95.
        start = np.where(self._circular, start, np.clip(start, 0.05, 0.95))
        return cma.CMAEvolutionStrategy(start, sigma, options)
