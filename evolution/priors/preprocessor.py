"""The preprocessor predicts good gene values from physics (Saunders 2009, sections II and III).

A key design parameter K_i is a function of a few genes. An exhaustive search over a coarse grid
maximizes it, and the best node gives the peak of each gene's distribution. The distribution stays
uniform if the gene is in no K_i, or if two K_i disagree on it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import lru_cache
from typing import Literal, NamedTuple

import numpy as np

from caterpillar_env.arrays import Array
from caterpillar_env.errors import CaterpillarError, show, to_number
from evolution.genome import Gene
from evolution.priors.distributions import (
    ClippedGaussian,
    Distribution,
    Gaussian,
    Uniform,
    WrappedGaussian,
)

GRID_NODES = 10  #: "approximately ten nodes per gene", Saunders 2009, section II
_TIE = 1e-9  #: largest difference of equal values, relative to the range of K_i

#: What to do with a gene on which two K_i disagree: keep it uniform, as in the paper, or put the peak at
#: the node where the product of the normalized K_i is largest, unless the product is 0 everywhere.
Contradictions = Literal["uniform", "product"]


class DesignParameter(NamedTuple):
    """A key design parameter K_i = f(g_i) to maximize (Saunders 2009, eq. 1)."""

    name: str
    source: str  #: equation of the paper, or the name of our model
    unit: str
    gene_names: tuple[str, ...]  #: the genes g_i
    formula: Callable[..., Array]  #: takes these genes in SI units, as arrays that broadcast


class Search(NamedTuple):
    """Result of the exhaustive search for the maximum of one K_i."""

    parameter: DesignParameter
    genes: tuple[Gene, ...]  #: the genes g_i
    nodes: tuple[Array, ...]  #: values of each gene in SI units, (GRID_NODES,)
    values: Array  #: K_i at all combinations of nodes, one axis for each gene
    best: tuple[int, ...]  #: index of the best node of each gene

    def profile(self, name: str) -> Array:
        """Return K_i along one gene, with the other genes at their best node, (GRID_NODES,)."""
        names = self.parameter.gene_names
        line: Array = self.values[
            tuple(slice(None) if n == name else b for n, b in zip(names, self.best, strict=True))
        ]
        return line

    def node(self, name: str) -> int:
        """Return the index of the best node of a gene."""
        return self.best[self.parameter.gene_names.index(name)]


@dataclass(frozen=True)
class GenePrior:
    """The result of the preprocessor for one gene: a row of the paper's Table I."""

    gene: Gene
    distribution: Distribution  #: over [0, 1]
    #: (name of K_i, sign): 1 if K_i is largest at a high value, -1 at a low value; 0 for a circular gene
    signs: tuple[tuple[str, int], ...]
    reason: str

    @property
    def peak(self) -> float | None:
        """Value with the highest density, in SI units, or None if the distribution is uniform."""
        d = self.distribution
        return self.gene.value(d.mu) if isinstance(d, Gaussian) else None

    @property
    def width(self) -> float | None:
        """Parameter sigma of the Gaussian, in SI units, or None if the distribution is uniform."""
        d = self.distribution
        return d.sigma * (self.gene.upper - self.gene.lower) if isinstance(d, Gaussian) else None

    def to_dict(self) -> dict[str, str | float | None]:
        """Return plain data for JSON. mu and sigma are in the gene's unit; None if uniform."""
        gene, d = self.gene, self.distribution
        return {
            "gene": gene.name,
            "symbol": gene.symbol,
            "unit": gene.unit,
            "kind": d.kind if isinstance(d, Gaussian) else "uniform",
            "mu": self.peak,
            "sigma": self.width,
            "lower": gene.lower,
            "upper": gene.upper,
            "reason": self.reason,
        }


@lru_cache(maxsize=64)
def search_grid(k: DesignParameter, genes: tuple[Gene, ...]) -> Search:
    """Maximize K_i by exhaustive search over the nodes of its genes.

    Raises:
        CaterpillarError: K_i is not finite everywhere on the grid, or does not depend on a gene.
    """
    nodes = tuple(np.linspace(g.lower, g.upper, GRID_NODES, endpoint=not g.circular) for g in genes)
    grid = np.meshgrid(*nodes, indexing="ij", sparse=True)
    values = np.broadcast_to(k.formula(*grid), (GRID_NODES,) * len(nodes))
    if not np.isfinite(values).all():
        raise CaterpillarError(f"{k.name} must be finite everywhere on the grid of its genes")
    for axis, name in enumerate(k.gene_names):
        if np.all(np.ptp(values, axis=axis) == 0):
            raise CaterpillarError(
                f"{k.name} does not depend on {name}; leave out {k.name}, or remove {name} from "
                "its gene_names"
            )
    best = np.unravel_index(int(np.argmax(values)), values.shape)
    return Search(k, genes, nodes, values, tuple(map(int, best)))


def check_floor_ratio(floor_ratio: float) -> None:
    """Raise a `CaterpillarError` unless the ratio is finite and greater than 1."""
    if (to_number(floor_ratio) or 0.0) <= 1:
        raise CaterpillarError(
            f"floor_ratio = {show(floor_ratio)} must be a finite number greater than 1"
        )


def search_all(parameters: Sequence[DesignParameter], genes: Sequence[Gene]) -> list[Search]:
    """Maximize each K_i.

    The genes of a K_i are named without segment or gap. The result holds for the corresponding genes of
    all segments and gaps.

    Raises:
        CaterpillarError: two K_i have the same name, a K_i uses an unknown gene, or `search_grid` fails.
    """
    names = [k.name for k in parameters]
    if len(set(names)) < len(names):
        raise CaterpillarError(f"design parameters must have different names; got {', '.join(names)}")
    known = {gene.parameter: gene for gene in reversed(genes)}
    if unknown := {name for k in parameters for name in k.gene_names} - set(known):
        raise CaterpillarError(
            f"no such genes: {', '.join(sorted(unknown))}; a design parameter can use "
            f"{', '.join(reversed(known))}"
        )
    return [search_grid(k, tuple(known[name] for name in k.gene_names)) for k in parameters]


def preprocess(
    parameters: Sequence[DesignParameter],
    genes: Sequence[Gene],
    floor_ratio: float = 3.0,
    contradictions: Contradictions = "uniform",
) -> list[GenePrior]:
    """Return a distribution for each gene (Saunders 2009, section II and Table I).

    Genes of the same parameter in several segments get the same distribution.

    Args:
        parameters: the design parameters K_i.
        genes: all genes of the genome.
        floor_ratio: ratio of the maximum to the minimum density of a Gaussian; 3 in the paper.
        contradictions: what to do with genes on which two K_i disagree, see `Contradictions`.

    Raises:
        CaterpillarError: see `search_all`. With "product", a K_i that disagrees with another one has no
            positive value.
    """
    check_floor_ratio(floor_ratio)
    searches = search_all(parameters, genes)
    return [_make_prior(gene, searches, floor_ratio, contradictions) for gene in genes]


def _make_prior(
    gene: Gene, searches: Sequence[Search], floor_ratio: float, contradictions: Contradictions
) -> GenePrior:
    name, last = gene.parameter, GRID_NODES if gene.circular else GRID_NODES - 1
    found = [search for search in searches if name in search.parameter.gene_names]
    if not found:
        return GenePrior(gene, Uniform(), (), "in no design parameter")
    wanted = {search.parameter.name: search.node(name) for search in found}
    profiles = {search.parameter.name: search.profile(name) for search in found}
    agreed = np.all([k >= k.max() - _TIE * np.ptp(k) for k in profiles.values()], axis=0)
    if len(set(wanted.values())) > 1 and agreed.any():  # some K_i have their maximum at several nodes
        wanted = dict.fromkeys(wanted, int(np.argmax(agreed)))
    signs = tuple(
        (k, 0 if gene.circular else 1 if 2 * node > last else -1) for k, node in wanted.items()
    )
    node, reason = next(iter(wanted.values())), f"best node of {' and '.join(wanted)}"
    if len(set(wanted.values())) > 1:
        factor, unit = gene.shown
        values = {k: factor * gene.value(n / last) for k, n in wanted.items()}
        wishes = "; ".join(f"{k} wants {value:.3g} {unit}" for k, value in values.items())
        if contradictions == "uniform":
            return GenePrior(gene, Uniform(), signs, f"contradiction: {wishes}")
        if negative := [k for k, values in profiles.items() if values.max() <= 0]:
            raise CaterpillarError(
                f"{' and '.join(negative)} must have positive values for contradictions = 'product'"
            )
        product = np.prod([np.maximum(k, 0.0) / k.max() for k in profiles.values()], axis=0)
        if not product.any():
            return GenePrior(gene, Uniform(), signs, f"contradiction: {wishes}")
        node, reason = int(np.argmax(product)), f"best product ({wishes})"
    kind = WrappedGaussian if gene.circular else ClippedGaussian
    return GenePrior(gene, kind.with_floor(node / last, floor_ratio), signs, reason)
