"""CMA-ES (Hansen 2016) by pycma in the box [0, 1]^n, restarted larger (Auger and Hansen 2005)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cma
import numpy as np

from caterpillar_env.arrays import Array
from evolution.optimizers.base import OptimizerError, check_told
from evolution.priors.distributions import Distribution, Uniform


@dataclass(frozen=True)
class CmaConfig:
    """Settings of CMA-ES.

    Raises:
        OptimizerError: a value is out of range.
    """

    cma_population: int | None = None  #: genomes a generation; None: pycma's own, 4 + 3 ln n
    cma_sigma: float = 0.3  #: first step size, as a share of the range; a narrower prior's is its own
    cma_restarts: bool = True  #: whether to start anew, with twice the population, once converged

    def __post_init__(self) -> None:
        if self.cma_population is not None and self.cma_population < 4:
            raise OptimizerError(
                f"cma_population = {self.cma_population} must be at least 4, or left out"
            )
        if not 0 < self.cma_sigma <= 1:
            raise OptimizerError(f"cma_sigma = {self.cma_sigma} must lie in (0, 1]")


class CmaEs:
    """Ask for genomes, evaluate them, tell their fitness; a generation a time.

    It starts at the peak of each gene's distribution with its width as step size; genes of uniform
    distribution start in the middle. A restart begins at a draw from the distributions. Bounds are kept
    by pycma's transformation of the genes, so that every genome lies in the box.

    Args:
        distributions: of each gene.
        config: settings.
        rng: the only source of randomness.
    """

    def __init__(
        self, distributions: Sequence[Distribution], config: CmaConfig, rng: np.random.Generator
    ) -> None:
        self._distributions = list(distributions)
        self._config = config
        self._rng = rng
        middles = [0.5 if isinstance(d, Uniform) else d.mu for d in self._distributions]
        self._strategy = self._started(np.array(middles), config.cma_population)
        self._asked: Array | None = None
        self._flat = False  # whether the last generation were all as fit

    @property
    def centre(self) -> Array:
        """The genome that the search is about, (n,)."""
        centre: Array = np.clip(np.array(self._strategy.result.xfavorite), 0.0, 1.0)
        return centre

    def ask(self) -> Array:
        """The genomes of a generation, (population, n)."""
        if self._asked is None:
            # A generation in which everybody fails has not converged.
            if self._config.cma_restarts and not self._flat and self._strategy.stop():
                start = np.array([d.sample(self._rng, 1)[0] for d in self._distributions])
                self._strategy = self._started(start, 2 * self._strategy.popsize)
            self._asked = np.clip(np.array(self._strategy.ask()), 0.0, 1.0)
        return self._asked.copy()

    def tell(self, genomes: Array, fitness: Array) -> None:
        """Take the fitness of the genomes last asked for.

        Raises:
            OptimizerError: other genomes, or fitness of another shape, negative or not finite.
        """
        check_told(self._asked, genomes, fitness)
        self._strategy.tell(list(genomes), (-fitness).tolist())  # pycma minimises
        self._flat = bool(np.ptp(fitness) == 0)
        self._asked = None

    def _started(self, start: Array, population: int | None) -> cma.CMAEvolutionStrategy:
        sigma = self._config.cma_sigma
        widths = [sigma if isinstance(d, Uniform) else min(d.sigma, sigma) for d in self._distributions]
        options = {
            "bounds": [0.0, 1.0],
            "CMA_stds": [width / sigma for width in widths],
            "randn": lambda *shape: self._rng.standard_normal(shape),
            "seed": np.nan,  # leaves NumPy's global generator alone
            "verbose": -9,
            "verb_log": 0,
            "tolflatfitness": 20,
        }
        if population is not None:
            options["popsize"] = population
        # The transformation maps the inner part of the box onto itself; its very edge has no inverse.
        return cma.CMAEvolutionStrategy(np.clip(start, 0.05, 0.95), sigma, options)
