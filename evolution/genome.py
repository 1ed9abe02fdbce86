"""The genome: genes of morphology, then times of power on and off.

A genome is a point of [0, 1]^n; 0 and 1 are a gene's bounds in SI units. Kinds (n for four segments):

- `shared`, n = 20: 8 genes of morphology that all segments share, times of the mirrored pairs (Saunders
  2009, section III).
- `full`, n = 32: every spring has times of its own.
- `per-segment`, n = 44: every segment has 8 genes of morphology of its own, times of the mirrored pairs.
"""

from __future__ import annotations

import math
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from caterpillar_env.errors import CaterpillarError
from caterpillar_env.gait import GaitTimings, pair_names, spring_names
from caterpillar_env.morphology import PARAMETERS, Body, Morphology

Array = NDArray[np.float64]
GenomeKind = Literal["shared", "full", "per-segment"]


class GenomeError(CaterpillarError):
    """A genome is of the wrong length, not finite or outside [0, 1]."""


class Gene(NamedTuple):
    """One gene: its name (with the unit), symbol, unit and bounds in that unit."""

    name: str
    symbol: str
    unit: str
    lower: float
    upper: float
    parameter: str  #: its name without the segment: what the preprocessor has a rule for

    @property
    def title(self) -> str:
        """Its name in words, without the unit."""
        return self.name.removesuffix(f"_{self.unit}").replace("_", " ")

    @property
    def shown(self) -> tuple[float, str]:
        """A factor and the unit to which it takes values for people to read: mm, g, °."""
        return _SHOWN.get(self.unit, (1.0, self.unit))


_SHOWN = {"m": (1000.0, "mm"), "kg": (1000.0, "g"), "rad": (math.degrees(1.0), "°")}


def genes(num_segments: int, period_s: float, kind: GenomeKind = "shared") -> tuple[Gene, ...]:
    """The genes in their order: morphology, then times of each pair or spring; head to tail."""
    segments = [f"segment{i + 1}_" for i in range(num_segments)] if kind == "per-segment" else [""]
    body = [
        Gene(segment + p.name, p.symbol, p.unit, p.lower, p.upper, p.name)
        for segment in segments
        for p in PARAMETERS
    ]
    timed = spring_names(num_segments) if kind == "full" else pair_names(num_segments)
    control = [
        Gene(name, f"t_{edge}", "s", 0.0, period_s, name)
        for one in timed
        for edge in ("on", "off")
        for name in (f"{one}_{edge}_s",)
    ]
    return (*body, *control)


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


def decode(
    genomes: Array, num_segments: int, period_s: float, kind: GenomeKind = "shared"
) -> tuple[list[Body], GaitTimings]:
    """Bodies and gaits of P genomes.

    Returns:
        P bodies, and timings of the mirrored pairs, shape (P, pairs); of the springs if `full`.

    Raises:
        GenomeError: see `check`.
    """
    array = check(genomes, len(genes(num_segments, period_s, kind)))
    size = len(PARAMETERS)
    count = num_segments if kind == "per-segment" else 1
    body = size * count
    # Through the environment's action, so that an environment can repeat the gait bit for bit.
    action = (2.0 * array[:, body:] - 1.0).astype(np.float32)
    timings = GaitTimings.from_action(action, period_s)
    segments = array[:, :body].reshape(len(array), count, size)
    bodies = [tuple(Morphology.from_unit(segment) for segment in row) for row in segments]
    return [body if kind == "per-segment" else body[0] for body in bodies], timings
