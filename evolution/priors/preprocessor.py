"""The physics-based preprocessor: statics say where good genes lie (Saunders 2009, sections II and III).

Three key design parameters K_i, each a formula over a few genes, are maximised by exhaustive search over
a coarse grid. The best node gives the peak of each gene's mutation distribution; genes in no K_i, and
genes on which two K_i disagree, stay uniform.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

import numpy as np

from caterpillar_env.arrays import Array
from caterpillar_env.errors import CaterpillarError
from caterpillar_env.gait import count_steps
from caterpillar_env.morphology import Morphology
from caterpillar_env.physics import CONTROL_INTERVAL_S, GRAVITY_M_S2, Physics
from evolution.genome import Encoding, Gene
from evolution.priors.distributions import ClampedGaussian, Distribution, TruncatedGaussian, Uniform

GRID_NODES = 10  #: "approximately ten nodes per gene", Saunders 2009, section II
Clipping = Literal["truncated", "clamped"]
PITCH_ANGLES = 10  #: likewise, over the range that the joints allow


class DesignParameter(NamedTuple):
    """A key design parameter K_i = f(g_i), to be maximised (Saunders 2009, eq. 1)."""

    name: str
    source: str  #: equation of the paper
    unit: str
    gene_names: tuple[str, ...]  #: g_i
    formula: Callable[..., Array]  #: takes the genes in SI units, broadcast against one another


def roll_stability(segment_mass_kg: Array, leg_separation_m: Array, segment_radius_m: Array) -> Array:
    """Least sideways force at the centre of mass that topples a segment, N (Saunders 2009, eqs 2-4).

    The centre of mass stands 2R above the ground and w/2 from the contact point a, so that
    F_phi 2R = m g w / 2.
    """
    width_ratio = leg_separation_m / (2 * segment_radius_m)  # P_w, eq. 4
    return segment_mass_kg * GRAVITY_M_S2 * width_ratio / 2  # eq. 3


def yaw_stability(
    friction: float,
) -> Callable[[Array, Array, Array], Array]:
    """Least sideways force at a spring's height that turns a segment about one foot, N (eq. 5)."""

    def force(segment_mass_kg: Array, leg_separation_m: Array, attachment_z_m: Array) -> Array:
        w, z = leg_separation_m, attachment_z_m
        # The printed minus is the direction of the force; the magnitude is to be large.
        return friction * segment_mass_kg * GRAVITY_M_S2 * w / (2 * z + w)

    return force


def lifting_moment(
    stiffness_n_m: float, rest_length_m: float, radius_m: float, joint_limit_rad: float
) -> Callable[[Array, Array, Array, Array], Array]:
    """Mean moment with which an austenite spring lifts a segment about its contact point b, N m.

    Saunders 2009, eqs 6-7: M_b = r_b,sp x F_s + r_b,cm x W. The segment lies ahead of b by L/2, its
    centre of mass h_b = 2R above the ground; it is pitched up by theta about b. The spring runs from
    the anchor, x outboard and y above the centre, to its fellow on the neighbour, which stays level:
    L + 2x long at theta = 0, where M_b = k (L + 2x - Delta)(y + h_b) - m g L / 2. The mean is over pitch
    angles from 0 to the joint limit.
    """

    def moment(
        attachment_x_m: Array, attachment_y_m: Array, segment_mass_kg: Array, segment_length_m: Array
    ) -> Array:
        x, y, m, length = attachment_x_m, attachment_y_m, segment_mass_kg, segment_length_m
        height = 2 * radius_m
        total = np.zeros(np.broadcast_shapes(x.shape, y.shape, m.shape, length.shape))
        for theta in np.linspace(0.0, joint_limit_rad, PITCH_ANGLES):
            cosine, sine = np.cos(theta), np.sin(theta)
            # In the plane of pitch, b at the origin: along the body, and upwards.
            anchor_x = (length / 2 + x) * cosine - (y + height) * sine
            anchor_z = (length / 2 + x) * sine + (y + height) * cosine
            fellow_x, fellow_z = -length / 2 - x, y + height
            span_x, span_z = fellow_x - anchor_x, fellow_z - anchor_z
            span = np.hypot(span_x, span_z)
            pull = stiffness_n_m * np.maximum(span - rest_length_m, 0.0)
            spring = (anchor_x * span_z - anchor_z * span_x) * pull / span
            centre_x = length / 2 * cosine - height * sine
            total += spring - m * GRAVITY_M_S2 * centre_x
        return total / PITCH_ANGLES

    return moment


def design_parameters(physics: Physics) -> tuple[DesignParameter, ...]:
    """The paper's three K_i. What is no gene of theirs is taken at its nominal value."""
    nominal = Morphology()
    return (
        DesignParameter(
            "roll stability", "eqs 2-4", "N",
            ("segment_mass_kg", "leg_separation_m", "segment_radius_m"), roll_stability,
        ),
        DesignParameter(
            "yaw stability", "eq. 5", "N",
            ("segment_mass_kg", "leg_separation_m", "attachment_z_m"), yaw_stability(physics.friction),
        ),
        DesignParameter(
            "lifting moment", "eqs 6-7", "N m",
            ("attachment_x_m", "attachment_y_m", "segment_mass_kg", "segment_length_m"),
            lifting_moment(
                physics.spring.austenite_stiffness_n_m, physics.spring.austenite_rest_length_m,
                nominal.segment_radius_m, nominal.joint_limit_rad,
            ),
        ),
    )  # fmt: skip


_KINDS = {
    Uniform: "uniform",
    TruncatedGaussian: "truncated_gaussian",
    ClampedGaussian: "clamped_gaussian",
}


@dataclass(frozen=True)
class GenePrior:
    """What the preprocessor says of one gene: a row of the paper's Table I."""

    gene: Gene
    distribution: Distribution  #: over [0, 1]
    signs: tuple[tuple[str, int], ...]  #: of each K_i that holds it: 1 better high, -1 better low
    reason: str

    def to_dict(self) -> dict[str, str | float | None]:
        """Plain JSON; mu and sigma in the gene's unit, None for a uniform gene."""
        gene, d = self.gene, self.distribution
        span = gene.upper - gene.lower
        return {
            "gene": gene.name,
            "symbol": gene.symbol,
            "unit": gene.unit,
            "kind": _KINDS[type(d)],
            "mu": None if isinstance(d, Uniform) else gene.lower + d.mu * span,
            "sigma": None if isinstance(d, Uniform) else d.sigma * span,
            "lower": gene.lower,
            "upper": gene.upper,
            "reason": self.reason,
        }


def best_node(
    parameter: DesignParameter, bounds: Mapping[str, tuple[float, float]], nodes: int = GRID_NODES
) -> dict[str, float]:
    """Exhaustive search: the place in [0, 1] of each gene of K_i at the node where K_i is greatest.

    Raises:
        CaterpillarError: K_i is not finite somewhere on the grid, or does not depend on a gene.
    """
    axes = [np.linspace(*bounds[name], nodes) for name in parameter.gene_names]
    grid = np.meshgrid(*axes, indexing="ij", sparse=True)
    values = np.broadcast_to(parameter.formula(*grid), (nodes,) * len(axes))
    if not np.isfinite(values).all():
        raise CaterpillarError(f"{parameter.name} must be finite all over the grid of its genes")
    for axis, name in enumerate(parameter.gene_names):
        if np.all(np.ptp(values, axis=axis) == 0):
            raise CaterpillarError(f"{parameter.name} does not depend on {name}: leave it out")
    best = np.unravel_index(int(np.argmax(values)), values.shape)
    return {
        name: float(node) / (nodes - 1) for name, node in zip(parameter.gene_names, best, strict=True)
    }


def preprocess(
    parameters: Sequence[DesignParameter], table: Sequence[Gene], floor_ratio: float = 3.0
) -> list[GenePrior]:
    """One distribution for each gene of `table` (Saunders 2009, section II and Table I).

    Genes that are one parameter of several segments get one and the same: each K_i is of one segment.

    Args:
        parameters: the K_i.
        table: all genes of the genome.
        floor_ratio: greatest over least density of a Gaussian; the paper's third is 3.

    Raises:
        CaterpillarError: a K_i names a gene that is not in the table, see also `best_node`.
    """
    if not 1 < floor_ratio < np.inf:
        raise CaterpillarError(f"floor_ratio = {floor_ratio!r} must be a number greater than 1")
    if len({k.name for k in parameters}) < len(parameters):
        raise CaterpillarError(
            "each design parameter needs a name of its own; got " + ", ".join(k.name for k in parameters)
        )
    bounds = {gene.parameter: (gene.lower, gene.upper) for gene in table}
    unknown = set(itertools.chain(*(k.gene_names for k in parameters))) - set(bounds)
    if unknown:
        raise CaterpillarError(
            f"no such genes: {', '.join(sorted(unknown))}; there are {', '.join(bounds)}"
        )
    peaks = {k.name: best_node(k, bounds) for k in parameters}
    return [_prior(gene, peaks, floor_ratio) for gene in table]


def _prior(gene: Gene, peaks: Mapping[str, Mapping[str, float]], floor_ratio: float) -> GenePrior:
    said = {name: places[gene.parameter] for name, places in peaks.items() if gene.parameter in places}
    signs = tuple((name, 1 if place > 0.5 else -1) for name, place in said.items())
    if not said:
        return GenePrior(gene, Uniform(), signs, "in no design parameter")
    if len(set(said.values())) > 1:
        wishes = "; ".join(f"{name} wants it {'high' if s > 0 else 'low'}" for name, s in signs)
        return GenePrior(gene, Uniform(), signs, f"contradiction: {wishes}")
    place = next(iter(said.values()))
    distribution = TruncatedGaussian.with_floor(place, floor_ratio)
    return GenePrior(gene, distribution, signs, f"best node of {' and '.join(said)}")


def paper_priors(
    encoding: Encoding,
    floor_ratio: float = 3.0,
    clipping: Clipping = "truncated",
    *,
    mirrored: bool = False,
) -> list[GenePrior]:
    """The preprocessor's answer for this robot: Table I.

    Args:
        encoding: the genes, of robots whose physics is in the K_i.
        floor_ratio: greatest over least density of a Gaussian, before it is clamped.
        clipping: what "clipped Gaussian" is to mean.
        mirrored: whether every peak is put at the opposite end: a prior that misleads on purpose.
    """
    count_steps(encoding.gait_period_s, CONTROL_INTERVAL_S, "gait_period_s")
    priors = preprocess(design_parameters(encoding.physics), encoding.genes, floor_ratio)
    return [replace(p, distribution=_varied(p.distribution, clipping, mirrored)) for p in priors]


def _varied(distribution: Distribution, clipping: Clipping, mirrored: bool) -> Distribution:
    if isinstance(distribution, Uniform):
        return distribution
    mu = 1.0 - distribution.mu if mirrored else distribution.mu
    kind = TruncatedGaussian if clipping == "truncated" else ClampedGaussian
    return kind(mu, distribution.sigma)
