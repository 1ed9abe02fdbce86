"""The physics-based preprocessor: statics predicts good values of genes (Saunders 2009, II and III).

An exhaustive search over a coarse grid maximizes three key design parameters K_i, each a function of a
few genes. The best node gives the peak of each gene's mutation distribution. The distribution stays
uniform if the gene is in no K_i, or if two K_i disagree on it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np

from caterpillar_env.arrays import Array
from caterpillar_env.errors import CaterpillarError
from caterpillar_env.morphology import Morphology
from caterpillar_env.physics import GRAVITY_M_S2, Physics
from evolution.genome import Encoding, Gene
from evolution.priors.distributions import ClippedGaussian, Clipping, Distribution, Uniform

GRID_NODES = 10  #: "approximately ten nodes per gene", Saunders 2009, section II
PITCH_ANGLES = 10  #: number of pitch angles over the range of the joints


class DesignParameter(NamedTuple):
    """A key design parameter K_i = f(g_i) to maximize (Saunders 2009, eq. 1)."""

    name: str
    source: str  #: equation of the paper
    unit: str
    gene_names: tuple[str, ...]  #: the genes g_i
    formula: Callable[..., Array]  #: takes these genes in SI units, as arrays that broadcast


def roll_stability(segment_mass_kg: Array, leg_separation_m: Array, segment_radius_m: Array) -> Array:
    """Return the minimum lateral force at the center of mass that tips a segment over, N (eqs 2-4).

    The center of mass is 2R above the ground and w/2 from the contact point a, so that
    F_phi 2R = m g w / 2.
    """
    width_ratio = leg_separation_m / (2 * segment_radius_m)  # P_w, eq. 4
    return segment_mass_kg * GRAVITY_M_S2 * width_ratio / 2  # eq. 3


def yaw_stability(
    segment_mass_kg: Array, leg_separation_m: Array, attachment_z_m: Array, *, friction: float
) -> Array:
    """Return the minimum lateral force at a spring that turns a segment about one foot, N (eq. 5)."""
    w, z = leg_separation_m, attachment_z_m
    # The minus sign in the paper gives the direction of the force; the magnitude is maximized.
    return friction * segment_mass_kg * GRAVITY_M_S2 * w / (2 * z + w)


def lifting_moment(
    x: Array, y: Array, m: Array, length: Array, *,
    stiffness_n_m: float, rest_length_m: float, radius_m: float, joint_limit_rad: float,
) -> Array:  # fmt: skip
    """Return the mean moment of an austenite spring that lifts a segment about its contact b, N m.

    Saunders 2009, eqs 6-7: M_b = r_b,sp x F_s + r_b,cm x W. The segment extends L/2 ahead of b, its
    center of mass is h_b = 2R above the ground, and it is pitched up by theta about b. The spring
    connects the anchor, x outboard and y above the center, to the mirrored anchor on the neighbor, which
    stays level. The spring is L + 2x long at theta = 0, where M_b = k (L + 2x - Delta)(y + h_b) -
    m g L / 2. The mean is over pitch angles from 0 to the joint limit. All values are in SI units.
    """
    height = 2 * radius_m
    total = np.zeros(np.broadcast_shapes(x.shape, y.shape, m.shape, length.shape))
    for theta in np.linspace(0.0, joint_limit_rad, PITCH_ANGLES):
        cosine, sine = np.cos(theta), np.sin(theta)
        # Coordinates in the pitch plane, with origin b: x along the body, z upwards.
        anchor_x = (length / 2 + x) * cosine - (y + height) * sine
        anchor_z = (length / 2 + x) * sine + (y + height) * cosine
        span_x, span_z = -length / 2 - x - anchor_x, y + height - anchor_z
        span = np.hypot(span_x, span_z)
        pull = stiffness_n_m * np.maximum(span - rest_length_m, 0.0)
        spring = (anchor_x * span_z - anchor_z * span_x) * pull / span
        center_x = length / 2 * cosine - height * sine
        total += spring - m * GRAVITY_M_S2 * center_x
    return total / PITCH_ANGLES


def design_parameters(physics: Physics) -> tuple[DesignParameter, ...]:
    """Return the paper's three K_i. Body parameters other than their genes have nominal values."""
    mass, width, spring, nominal = "segment_mass_kg", "leg_separation_m", physics.spring, Morphology()
    yaw = partial(yaw_stability, friction=physics.friction)
    lift = partial(
        lifting_moment,
        stiffness_n_m=spring.austenite_stiffness_n_m, rest_length_m=spring.austenite_rest_length_m,
        radius_m=nominal.segment_radius_m, joint_limit_rad=nominal.joint_limit_rad,
    )  # fmt: skip
    roll_genes, yaw_genes = (mass, width, "segment_radius_m"), (mass, width, "attachment_z_m")
    lift_genes = ("attachment_x_m", "attachment_y_m", mass, "segment_length_m")
    return (
        DesignParameter("roll stability", "eqs 2-4", "N", roll_genes, roll_stability),
        DesignParameter("yaw stability", "eq. 5", "N", yaw_genes, yaw),
        DesignParameter("lifting moment", "eqs 6-7", "N m", lift_genes, lift),
    )


@dataclass(frozen=True)
class GenePrior:
    """The result of the preprocessor for one gene: a row of the paper's Table I."""

    gene: Gene
    distribution: Distribution  #: over [0, 1]
    signs: tuple[tuple[str, int], ...]  #: per K_i with this gene: 1 if it prefers high values, else -1
    reason: str

    def to_dict(self) -> dict[str, str | float | None]:
        """Return plain data for JSON. mu and sigma are in the gene's unit, or None if it is uniform."""
        gene, d = self.gene, self.distribution
        span = gene.upper - gene.lower
        return {
            "gene": gene.name,
            "symbol": gene.symbol,
            "unit": gene.unit,
            "kind": f"{d.clipping}_gaussian" if isinstance(d, ClippedGaussian) else "uniform",
            "mu": gene.lower + d.mu * span if isinstance(d, ClippedGaussian) else None,
            "sigma": d.sigma * span if isinstance(d, ClippedGaussian) else None,
            "lower": gene.lower,
            "upper": gene.upper,
            "reason": self.reason,
        }


def best_node(k: DesignParameter, bounds: Mapping[str, tuple[float, float]]) -> dict[str, float]:
    """Maximize K_i by exhaustive search. Returns the best value of each gene, scaled to [0, 1].

    Raises:
        CaterpillarError: K_i is not finite everywhere on the grid, or does not depend on a gene.
    """
    axes = [np.linspace(*bounds[name], GRID_NODES) for name in k.gene_names]
    grid = np.meshgrid(*axes, indexing="ij", sparse=True)
    values = np.broadcast_to(k.formula(*grid), (GRID_NODES,) * len(axes))
    if not np.isfinite(values).all():
        raise CaterpillarError(f"{k.name} must be finite everywhere on the grid of its genes")
    for axis, name in enumerate(k.gene_names):
        if np.all(np.ptp(values, axis=axis) == 0):
            raise CaterpillarError(f"{k.name} does not depend on {name}; remove that gene")
    best = np.unravel_index(int(np.argmax(values)), values.shape)
    return {name: float(node) / (GRID_NODES - 1) for name, node in zip(k.gene_names, best, strict=True)}


def check_floor_ratio(floor_ratio: float) -> None:
    """Raise a `CaterpillarError` unless the ratio is finite and greater than 1."""
    if not 1 < floor_ratio < np.inf:
        raise CaterpillarError(f"floor_ratio = {floor_ratio!r} must be a finite number greater than 1")


def preprocess(
    parameters: Sequence[DesignParameter], genes: Sequence[Gene], floor_ratio: float = 3.0
) -> list[GenePrior]:
    """Return a distribution for each gene (Saunders 2009, section II and Table I).

    A K_i describes one segment, so genes of the same parameter in several segments get the same
    distribution.

    Args:
        parameters: the design parameters K_i.
        genes: all genes of the genome.
        floor_ratio: maximum over minimum density of a Gaussian; 3 in the paper ("one third").

    Raises:
        CaterpillarError: two K_i have the same name, a K_i uses an unknown gene, or `best_node` fails.
    """
    check_floor_ratio(floor_ratio)
    names = [k.name for k in parameters]
    if len(set(names)) < len(names):
        raise CaterpillarError(f"design parameters must have different names; got {', '.join(names)}")
    bounds = {gene.parameter: (gene.lower, gene.upper) for gene in genes}
    if unknown := {name for k in parameters for name in k.gene_names} - set(bounds):
        raise CaterpillarError(
            f"no such genes: {', '.join(sorted(unknown))}; choose from {', '.join(bounds)}"
        )
    peaks = {k.name: best_node(k, bounds) for k in parameters}
    return [_make_prior(gene, peaks, floor_ratio) for gene in genes]


def _make_prior(gene: Gene, peaks: Mapping[str, Mapping[str, float]], floor_ratio: float) -> GenePrior:
    wanted = {name: places[gene.parameter] for name, places in peaks.items() if gene.parameter in places}
    signs = tuple((name, 1 if place > 0.5 else -1) for name, place in wanted.items())
    if not wanted:
        return GenePrior(gene, Uniform(), signs, "in no design parameter")
    if len(set(wanted.values())) > 1:
        wishes = "; ".join(f"{name} wants it {'high' if s > 0 else 'low'}" for name, s in signs)
        return GenePrior(gene, Uniform(), signs, f"contradiction: {wishes}")
    distribution = ClippedGaussian.with_floor(next(iter(wanted.values())), floor_ratio)
    return GenePrior(gene, distribution, signs, f"best node of {' and '.join(wanted)}")


def paper_priors(
    encoding: Encoding,
    floor_ratio: float = 3.0,
    clipping: Clipping = "truncated",
    *,
    mirrored: bool = False,
) -> list[GenePrior]:
    """Return the paper's Table I for the robots of an encoding.

    Args:
        encoding: the genes, and the physics that the K_i depend on.
        floor_ratio: maximum over minimum density of a Gaussian, before clamping.
        clipping: interpretation of the paper's "clipped Gaussian".
        mirrored: whether to mirror every peak, which gives a misleading prior.

    Raises:
        CaterpillarError: see `preprocess`.
    """
    rows = preprocess(design_parameters(encoding.physics), encoding.genes, floor_ratio)
    return [
        replace(row, distribution=replace(d, mu=1.0 - d.mu if mirrored else d.mu, clipping=clipping))
        if isinstance(d := row.distribution, ClippedGaussian)
        else row
        for row in rows
    ]
