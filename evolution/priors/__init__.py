"""Prior distributions of genes: uniform, or from the preprocessor."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal

import numpy as np

from caterpillar_env.errors import CaterpillarError
from evolution.genome import Encoding
from evolution.priors.body import body_parameters
from evolution.priors.distributions import (
    ClippedGaussian,
    Clipping,
    Distribution,
    Gaussian,
    Uniform,
    WrappedGaussian,
)
from evolution.priors.gait import gait_parameters
from evolution.priors.preprocessor import (
    Contradictions,
    DesignParameter,
    GenePrior,
    Search,
    preprocess,
    search_all,
)

Prior = Literal["uniform", "body", "gait", "body+gait"]
Control = Literal["none", "mirrored", "shuffled"]
#: Name of a design parameter K_i to leave out of a prior.
Without = Literal["none", "roll stability", "yaw stability", "lifting moment", "stroke", "advance"]

_SHUFFLE = 0x5F  # separates the random numbers of the shuffle from those of the optimizer


def design_parameters(
    encoding: Encoding, prior: Prior, without: Without = "none"
) -> tuple[DesignParameter, ...]:
    """Return the design parameters K_i of a prior, except the one that `without` names.

    Raises:
        CaterpillarError: the prior has no K_i of this name.
    """
    body = body_parameters(encoding.physics) if "body" in prior else ()
    gait = gait_parameters(encoding.physics, encoding.gait_period_s) if "gait" in prior else ()
    found = (*body, *gait)
    kept = tuple(k for k in found if k.name != without)
    if without != "none" and len(kept) == len(found):
        names = ", ".join(k.name for k in found) or "none"
        raise CaterpillarError(
            f"the design parameter to leave out, {without!r}, must belong to the prior {prior!r}, which "
            f"has {names}"
        )
    return kept


def _make_wave(encoding: Encoding) -> Encoding:
    """Return the encoding with one body for all segments and a wave: its genes are those of the K_i."""
    return replace(encoding, kind="shared", timing="wave")


def searches(encoding: Encoding, prior: Prior, without: Without = "none") -> list[Search]:
    """Maximize each K_i of a prior by grid search, and return the results."""
    return search_all(design_parameters(encoding, prior, without), _make_wave(encoding).genes)


def make_priors(
    encoding: Encoding,
    prior: Prior = "body",
    *,
    floor_ratio: float = 3.0,
    clipping: Clipping = "truncated",
    contradictions: Contradictions = "uniform",
    control: Control = "none",
    without: Without = "none",
    seed: int = 0,
) -> list[GenePrior]:
    """Return the distribution of each gene. With the prior "body", this is the paper's Table I.

    The K_i of the gait give distributions of lag, offset and duty. With the timing `on-off`, the times
    get distributions that peak at the times of the best wave: the wave with lag, offset and duty at
    their peaks, whose first dorsal pair is switched on at the start of the period. If one of the three
    has no peak, for example because two K_i disagree on it, the times stay uniform.

    Args:
        encoding: the genes, and the physics that the K_i depend on.
        prior: the K_i to use: body, gait, both or none.
        floor_ratio: ratio of the maximum to the minimum density of a Gaussian, before clamping.
        clipping: interpretation of the paper's "clipped Gaussian".
        contradictions: what to do with genes on which two K_i disagree.
        control: "mirrored" or "shuffled" gives a deliberately misleading prior with the same standard
            deviations. With "mirrored", the best wave has its lag, offset and duty mirrored, too.
        without: name of a K_i to leave out.
        seed: seed of the shuffle.

    Raises:
        CaterpillarError: see `preprocess` and `design_parameters`.
    """
    parameters = design_parameters(encoding, prior, without)
    found = preprocess(parameters, _make_wave(encoding).genes, floor_ratio, contradictions)
    if control == "mirrored":
        found = [replace(row, distribution=_mirror(row.distribution)) for row in found]
    known = {row.gene.parameter: row for row in found}
    if "gait" in prior and encoding.timing == "on-off":
        known |= _time_priors(encoding, known)
    genes = encoding.genes
    free = GenePrior(genes[0], Uniform(), (), "in no design parameter")
    rows = [replace(known.get(gene.parameter, free), gene=gene) for gene in genes]
    shapes = [row.distribution for row in rows]
    if control == "shuffled":
        order = np.random.default_rng([seed, _SHUFFLE]).permutation(len(shapes))
        shapes = [shapes[i] for i in order]
    shapes = [replace(d, clipping=clipping) if isinstance(d, ClippedGaussian) else d for d in shapes]
    return [replace(row, distribution=d) for row, d in zip(rows, shapes, strict=True)]


def _mirror(distribution: Distribution) -> Distribution:
    return distribution.mirrored() if isinstance(distribution, Gaussian) else distribution


def _time_priors(encoding: Encoding, known: dict[str, GenePrior]) -> dict[str, GenePrior]:
    """Return priors of the on and off times, by gene, from the priors of lag, offset and duty."""
    shapes = [known[name].distribution for name in ("lag", "offset", "duty")]
    peaks = [d for d in shapes if isinstance(d, Gaussian)]
    if len(peaks) < len(shapes):
        return {}  # without all three peaks, there is no best wave
    lag, offset, duty = (d.mu for d in peaks)
    wave = _make_wave(encoding)
    body = [0.5] * (len(wave.genes) - 4)
    _, timings = wave.decode(np.array([*body, lag, duty, offset, duty]))
    if encoding.kind == "full":
        timings = timings.mirrored()
    row = replace(known["lag"], reason="best wave")
    return {
        gene.name: replace(row, distribution=WrappedGaussian(place, peaks[0].sigma))
        for gene, place in zip(
            [gene for gene in encoding.genes if gene.unit == "s"],
            (timings.times_s[0] / timings.period_s % 1.0).tolist(),
            strict=True,
        )
    }
