"""Distributions of one gene over [0, 1], from which it is initialised and mutated."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from scipy.special import ndtr, ndtri

from caterpillar_env.arrays import Array


class _Invertible:
    """Draws by inversion of the distribution function: one uniform a draw."""

    def quantile(self, share: Array) -> Array:
        """Where the distribution function reaches `share`, in [0, 1]."""
        raise NotImplementedError

    def sample(self, rng: np.random.Generator, size: int) -> Array:
        """`size` draws in [0, 1]."""
        return self.quantile(rng.random(size))


@dataclass(frozen=True)
class Uniform(_Invertible):
    """Every value equally likely."""

    def quantile(self, share: Array) -> Array:
        """Where the distribution function reaches `share`, in [0, 1]."""
        return share

    def density(self, x: Array) -> Array:
        """Probability density at x."""
        return np.where((x >= 0) & (x <= 1), 1.0, 0.0)


@dataclass(frozen=True)
class TruncatedGaussian(_Invertible):
    """The paper's clipped Gaussian: cut off at 0 and 1 and renormalised.

    Args:
        mu: peak, in [0, 1].
        sigma: width of the Gaussian before it is cut.
    """

    mu: float
    sigma: float

    @classmethod
    def with_floor(cls, mu: float, ratio: float = 3.0) -> TruncatedGaussian:
        """Peaked at `mu`, its least density over [0, 1] the `ratio`-th part of its greatest.

        Saunders 2009, section II: "no smaller than one third"; hence sigma = D / sqrt(2 ln 3), D the
        distance from mu to the farther bound.
        """
        return cls(mu, max(mu, 1.0 - mu) / math.sqrt(2.0 * math.log(ratio)))

    def quantile(self, share: Array) -> Array:
        """Where the distribution function reaches `share`, in [0, 1]."""
        low, high = ndtr(-self.mu / self.sigma), ndtr((1.0 - self.mu) / self.sigma)
        x: Array = self.mu + self.sigma * ndtri(low + (high - low) * share)
        return np.clip(x, 0.0, 1.0)

    def density(self, x: Array) -> Array:
        """Probability density at x."""
        mass = ndtr((1.0 - self.mu) / self.sigma) - ndtr(-self.mu / self.sigma)
        bell = np.exp(-0.5 * ((x - self.mu) / self.sigma) ** 2)
        inside = (x >= 0) & (x <= 1)
        return np.where(inside, bell / (mass * self.sigma * math.sqrt(2 * math.pi)), 0.0)


@dataclass(frozen=True)
class ClampedGaussian(_Invertible):
    """The other reading of the paper's "clipped": values beyond 0 and 1 are put on the bound.

    Args:
        mu: peak, in [0, 1].
        sigma: width of the Gaussian.
    """

    mu: float
    sigma: float

    def quantile(self, share: Array) -> Array:
        """Where the distribution function reaches `share`, in [0, 1]."""
        x: Array = self.mu + self.sigma * ndtri(share)
        return np.clip(x, 0.0, 1.0)

    def density(self, x: Array) -> Array:
        """Probability density between the bounds, which carry the rest of the probability."""
        bell = np.exp(-0.5 * ((x - self.mu) / self.sigma) ** 2)
        inside = (x > 0) & (x < 1)
        return np.where(inside, bell / (self.sigma * math.sqrt(2 * math.pi)), 0.0)


Distribution = Uniform | TruncatedGaussian | ClampedGaussian
