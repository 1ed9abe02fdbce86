"""Distributions of one gene over [0, 1], for initialization and mutation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from scipy.special import ndtr, ndtri

from caterpillar_env.arrays import Array

Clipping = Literal["truncated", "clamped"]


class Distribution:
    """A distribution over [0, 1]. Each draw uses one uniform random number."""

    def quantile(self, share: Array) -> Array:
        """Return the quantiles (inverse cumulative distribution function) for `share` in [0, 1]."""
        raise NotImplementedError

    def density(self, x: Array) -> Array:
        """Return the probability density at x. It is 0 outside [0, 1]."""
        raise NotImplementedError

    def sample(self, rng: np.random.Generator, size: int) -> Array:
        """Draw `size` values in [0, 1]."""
        return self.quantile(rng.random(size))


def draw(distributions: Sequence[Distribution], rng: np.random.Generator, count: int) -> Array:
    """Draw genomes, (count, n), one gene after the other."""
    return np.stack([d.sample(rng, count) for d in distributions], axis=1)


@dataclass(frozen=True)
class Uniform(Distribution):
    """All values are equally likely."""

    def quantile(self, share: Array) -> Array:
        """See `Distribution.quantile`."""
        return share

    def density(self, x: Array) -> Array:
        """See `Distribution.density`."""
        return np.where((x >= 0) & (x <= 1), 1.0, 0.0)


@dataclass(frozen=True)
class Gaussian(Distribution):
    """Base class of Gaussians that are limited to [0, 1].

    Args:
        mu: position of the peak, in [0, 1].
        sigma: standard deviation before the limitation to [0, 1].
    """

    mu: float
    sigma: float

    @property
    def kind(self) -> str:
        """Name of the distribution."""
        raise NotImplementedError

    def mirrored(self) -> Gaussian:
        """Return the distribution with its peak reflected about the middle of the gene."""
        return replace(self, mu=1.0 - self.mu)


@dataclass(frozen=True)
class ClippedGaussian(Gaussian):
    """A Gaussian that is clipped to [0, 1] (Saunders 2009, section II).

    Args:
        clipping: "truncated" cuts the tails off and renormalizes the rest; "clamped" moves values
            beyond 0 and 1 to the bound.
    """

    clipping: Clipping = "truncated"

    @classmethod
    def with_floor(cls, mu: float, ratio: float = 3.0) -> ClippedGaussian:
        """Return a truncated Gaussian whose minimum density is 1 / `ratio` times its maximum.

        The ratio is 3 in Saunders 2009, section II ("no smaller than one third"). The formula is
        sigma = D / sqrt(2 ln ratio), where D is the distance from mu to the farther bound.
        """
        return cls(mu, max(mu, 1.0 - mu) / math.sqrt(2.0 * math.log(ratio)))

    @property
    def kind(self) -> str:
        """See `Gaussian.kind`."""
        return f"{self.clipping}_gaussian"

    def quantile(self, share: Array) -> Array:
        """See `Distribution.quantile`."""
        low, high = self._tails()
        x: Array = self.mu + self.sigma * ndtri(low + (high - low) * share)
        return np.clip(x, 0.0, 1.0)

    def density(self, x: Array) -> Array:
        """See `Distribution.density`. If clamped, the probability masses at the bounds are left out."""
        low, high = self._tails()
        bell = np.exp(-0.5 * ((x - self.mu) / self.sigma) ** 2)
        inside = (x >= 0) & (x <= 1)
        return np.where(inside, bell / ((high - low) * self.sigma * math.sqrt(2 * math.pi)), 0.0)

    def _tails(self) -> tuple[float, float]:
        """Return the range of cumulative probabilities of the unclipped Gaussian to draw from."""
        if self.clipping == "clamped":
            return 0.0, 1.0
        return ndtr(-self.mu / self.sigma), ndtr((1.0 - self.mu) / self.sigma)


@dataclass(frozen=True)
class WrappedGaussian(Gaussian):
    """A Gaussian on a circle, for circular genes, truncated half a circle away from its peak."""

    @classmethod
    def with_floor(cls, mu: float, ratio: float = 3.0) -> WrappedGaussian:
        """Return a Gaussian whose minimum density is 1 / `ratio` times its maximum."""
        return cls(mu, ClippedGaussian.with_floor(0.5, ratio).sigma)

    @property
    def kind(self) -> str:
        """See `Gaussian.kind`."""
        return "wrapped_gaussian"

    def mirrored(self) -> Gaussian:
        """Return the distribution with its peak moved by half the circle."""
        return replace(self, mu=(self.mu + 0.5) % 1.0)

    def quantile(self, share: Array) -> Array:
        """See `Distribution.quantile`. A share of 0 gives the point opposite the peak."""
        return (ClippedGaussian(0.5, self.sigma).quantile(share) + self.mu - 0.5) % 1.0

    def density(self, x: Array) -> Array:
        """See `Distribution.density`."""
        centred = ClippedGaussian(0.5, self.sigma).density((x - self.mu + 0.5) % 1.0)
        return np.where((x >= 0) & (x <= 1), centred, 0.0)
