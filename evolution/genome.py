"""The genome: genes of morphology, then times of power on and off.

A genome is a point of [0, 1]^n; 0 and 1 are a gene's bounds in SI units. Kinds (n for four segments):

- `shared`, n = 20: 8 genes of morphology that all segments share, times of the mirrored pairs (Saunders
  2009, section III).
- `full`, n = 32: every spring has times of its own.
- `per-segment`, n = 44: every segment has 8 genes of morphology of its own, times of the mirrored pairs.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal, NamedTuple

import numpy as np

from caterpillar_env.arrays import Array
from caterpillar_env.errors import CaterpillarError
from caterpillar_env.gait import GAIT_PERIOD_S, GaitTimings, pair_names, spring_names
from caterpillar_env.morphology import PARAMETERS, Body, Morphology
from caterpillar_env.physics import Physics
from caterpillar_env.robot import Robot

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


@dataclass(frozen=True)
class Encoding:
    """What the genomes of a run stand for: robots of some physics with a body and a gait each."""

    physics: Physics = field(default_factory=Physics)
    gait_period_s: float = GAIT_PERIOD_S
    kind: GenomeKind = "shared"

    @cached_property
    def genes(self) -> tuple[Gene, ...]:
        """The genes in their order: morphology, then times of each pair or spring; head to tail."""
        segments = range(1, self.physics.num_segments + 1)
        body = [
            Gene(segment + p.name, p.symbol, p.unit, p.lower, p.upper, p.name)
            for segment in ([f"segment{i}_" for i in segments] if self.kind == "per-segment" else [""])
            for p in PARAMETERS
        ]
        timed = (spring_names if self.kind == "full" else pair_names)(self.physics.num_segments)
        control = [
            Gene(name, f"t_{edge}", "s", 0.0, self.gait_period_s, name)
            for one in timed
            for edge in ("on", "off")
            for name in (f"{one}_{edge}_s",)
        ]
        return (*body, *control)

    def check(self, genomes: Array) -> Array:
        """`genomes` as an array of shape (P, n).

        Raises:
            GenomeError: wrong shape, or a value that is not in [0, 1].
        """
        array = np.asarray(genomes, dtype=np.float64)
        if array.ndim != 2 or array.shape[1] != len(self.genes):
            raise GenomeError(f"genomes must have shape (P, {len(self.genes)}); got {array.shape}")
        bad = ~((array >= 0) & (array <= 1))
        if bad.any():
            row, column = np.argwhere(bad)[0]
            raise GenomeError(
                f"gene {column} of genome {row} is {array[row, column]}; every gene must lie in [0, 1]"
            )
        return array

    def decode(self, genomes: Array) -> tuple[list[Body], GaitTimings]:
        """Bodies and gaits of P genomes (P, n).

        Returns:
            P bodies, and timings of the mirrored pairs, shape (P, pairs); of the springs if `full`.

        Raises:
            GenomeError: see `check`.
        """
        array = self.check(genomes)
        size = len(PARAMETERS)
        count = self.physics.num_segments if self.kind == "per-segment" else 1
        # Through the environment's action, so that an environment can repeat the gait bit for bit.
        action = (2.0 * array[:, size * count :] - 1.0).astype(np.float32)
        timings = GaitTimings.from_action(action, self.gait_period_s)
        segments = array[:, : size * count].reshape(len(array), count, size)
        bodies = [tuple(Morphology.from_unit(segment) for segment in row) for row in segments]
        return [body if self.kind == "per-segment" else body[0] for body in bodies], timings

    def robot(self, genome: Array, **record: Any) -> Robot:
        """The robot of a genome (n,) in [0, 1]; keywords are what was recorded of it, see `Robot`."""
        (body,), timings = self.decode(genome[None])
        gait = GaitTimings(timings.period_s, timings.on_s[0], timings.off_s[0])
        return Robot(body, gait, self.physics, **record)


def gene_values(bodies: Sequence[Body], timings: GaitTimings) -> Array:
    """What each gene says of P bodies and their gaits, in the order of the genes, SI units, (P, n)."""
    times = np.stack([timings.on_s, timings.off_s], axis=-1).reshape(len(bodies), -1)
    segments = [body if isinstance(body, tuple) else (body,) for body in bodies]
    values = [np.concatenate([m.to_array() for m in body]) for body in segments]
    return np.concatenate([np.reshape(values, (len(bodies), -1)), times], axis=1)
