"""The genome: 8 genes of morphology and, for each mirrored pair, the times of power on and off.

A genome is a point of [0, 1]^n; 0 and 1 are a gene's bounds in SI units. With four segments n = 20
(Saunders 2009, section III).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from caterpillar_env.errors import CaterpillarError
from caterpillar_env.gait import GaitTimings, pair_names
from caterpillar_env.morphology import PARAMETERS, Morphology

Array = NDArray[np.float64]


class GenomeError(CaterpillarError):
    """A genome is of the wrong length, not finite or outside [0, 1]."""


class Gene(NamedTuple):
    """One gene: its name (with the unit), symbol, unit and bounds in that unit."""

    name: str
    symbol: str
    unit: str
    lower: float
    upper: float


def genes(num_segments: int, period_s: float) -> tuple[Gene, ...]:
    """The genes in their order: morphology, then on and off time of each pair from head to tail."""
    control = [
        Gene(f"{pair}_{edge}_s", f"t_{edge}", "s", 0.0, period_s)
        for pair in pair_names(num_segments)
        for edge in ("on", "off")
    ]
    return tuple(Gene(p.name, p.symbol, p.unit, p.lower, p.upper) for p in PARAMETERS) + tuple(control)


def check(genomes: Array, num_genes: int) -> Array:
    """`genomes` as an array of shape (P, num_genes).

    Raises:
        GenomeError: wrong shape, or a value that is not in [0, 1].
    """
    array = np.asarray(genomes, dtype=np.float64)
    if array.ndim != 2 or array.shape[1] != num_genes:
        raise GenomeError(f"genomes must have shape (P, {num_genes}); got {array.shape}")
    bad = ~((array >= 0) & (array <= 1))
    if bad.any():
        row, column = np.argwhere(bad)[0]
        raise GenomeError(
            f"gene {column} of genome {row} is {array[row, column]}; every gene must lie in [0, 1]"
        )
    return array


def decode(genomes: Array, num_segments: int, period_s: float) -> tuple[list[Morphology], GaitTimings]:
    """Bodies and gaits of P genomes.

    Returns:
        P morphologies, and timings of the mirrored pairs, arrays of shape (P, pairs).

    Raises:
        GenomeError: see `check`.
    """
    array = check(genomes, len(genes(num_segments, period_s)))
    body = len(PARAMETERS)
    # Through the environment's action, so that an environment can repeat the gait bit for bit.
    action = (2.0 * array[:, body:] - 1.0).astype(np.float32)
    timings = GaitTimings.from_action(action, period_s)
    return [Morphology.from_unit(row) for row in array[:, :body]], timings
