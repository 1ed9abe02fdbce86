"""The genome: morphology genes, then the gait genes.

A genome is a point in [0, 1]^n, where 0 and 1 are the bounds of a gene in SI units. The kinds of genomes
(n holds for four segments and on-off timing):

- `shared`, n = 20: 8 morphology genes for all segments, and gait genes for each left-right pair of
  springs (Saunders 2009, section III).
- `full`, n = 32: like `shared`, but gait genes for every spring.
- `per-segment`, n = 44: like `shared`, but 8 morphology genes for each segment.

The gait genes depend on the timing:

- `on-off`: the times at which each pair (or spring) is switched on and off, as in the paper.
- `phase`: delay and duty of each pair (or spring), see `GaitTimings.from_phases`.
- `wave`: four genes for the whole gait. Each dorsal pair follows the dorsal pair ahead with the same
  delay (lag), and each ventral pair follows the dorsal pair above it with the same delay (offset). All
  dorsal pairs have the same duty, and so have all ventral pairs.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal, NamedTuple, TypeVar

import numpy as np

from caterpillar_env.arrays import Array
from caterpillar_env.errors import CaterpillarError, check_choice, show, to_array
from caterpillar_env.gait import (
    GAIT_PERIOD_S,
    MAX_DUTY,
    GaitTimings,
    count_steps,
    pair_names,
    spring_names,
)
from caterpillar_env.morphology import PARAMETERS, Body, Morphology
from caterpillar_env.physics import CONTROL_INTERVAL_S, Physics
from caterpillar_env.robot import Robot

T = TypeVar("T", float, Array)

GenomeKind = Literal["shared", "full", "per-segment"]
Timing = Literal["on-off", "phase", "wave"]

_DISPLAY_UNITS = {
    "m": (1000.0, "mm"),
    "kg": (1000.0, "g"),
    "rad": (math.degrees(1.0), "°"),
    "1": (100.0, "%"),
}


class Gene(NamedTuple):
    """One gene: its name (with the unit), symbol, unit and bounds in that unit."""

    name: str
    symbol: str
    unit: str
    lower: float
    upper: float
    parameter: str  #: name without segment or gap; design parameters refer to it
    circular: bool = False  #: whether the gene wraps around from 1 to 0

    @property
    def title(self) -> str:
        """The name with spaces and without the unit."""
        return self.name.removesuffix(f"_{self.unit}").replace("_", " ")

    @property
    def shown(self) -> tuple[float, str]:
        """The factor that converts values to the display unit, and this unit, such as mm, g, ° or %."""
        return _DISPLAY_UNITS.get(self.unit, (1.0, self.unit))

    def value(self, share: T) -> T:
        """Convert a number or an array from [0, 1] to SI units."""
        return self.lower + share * (self.upper - self.lower)


@dataclass(frozen=True)
class Encoding:
    """Maps genomes to robots. Each robot has a body and a gait, and all robots have the same physics.

    Raises:
        CaterpillarError: the kind or the timing is unknown, the two cannot be combined (`full`
            and `wave`), or the period is not a multiple of the control interval.
    """

    physics: Physics = field(default_factory=Physics)
    gait_period_s: float = GAIT_PERIOD_S
    kind: GenomeKind = "shared"
    timing: Timing = "on-off"

    def __post_init__(self) -> None:
        check_choice("genome", self.kind, GenomeKind)
        check_choice("timing", self.timing, Timing)
        if self.kind == "full" and self.timing == "wave":
            raise CaterpillarError(
                "timing = 'wave' has the same genes for all springs, but genome = 'full' has separate "
                "genes for every spring; choose timing = 'phase' or genome = 'shared'"
            )
        count_steps(self.gait_period_s, CONTROL_INTERVAL_S, "gait_period_s")

    @cached_property
    def genes(self) -> tuple[Gene, ...]:
        """The genes in order: morphology, then gait, each from head to tail."""
        count = self.physics.num_segments
        prefixes = [f"segment{i + 1}_" for i in range(count)] if self.kind == "per-segment" else [""]
        body = [
            Gene(prefix + p.name, p.symbol, p.unit, p.lower, p.upper, p.name)
            for prefix in prefixes
            for p in PARAMETERS
        ]
        return (*body, *self._gait_genes())

    def _gait_genes(self) -> list[Gene]:
        if self.timing == "wave":
            return [
                _make_delay("lag", "lag"),
                _make_duty("dorsal_duty"),
                _make_delay("offset", "offset"),
                _make_duty("ventral_duty"),
            ]
        count = self.physics.num_segments
        genes = []
        for name in spring_names(count) if self.kind == "full" else pair_names(count):
            if self.timing == "phase":
                genes += [
                    _make_delay(f"{name}_delay", _find_parameter(name)),
                    _make_duty(f"{name}_duty"),
                ]
                continue
            for edge in ("on", "off"):
                gene = f"{name}_{edge}_s"
                genes.append(Gene(gene, f"t_{edge}", "s", 0.0, self.gait_period_s, gene))
        return genes

    def check(self, genomes: Array) -> Array:
        """Validate genomes (P, n), or a single one (n,). Returns an array of shape (P, n).

        Raises:
            CaterpillarError: wrong shape, or a value that is not in [0, 1].
        """
        array, n = to_array(genomes), len(self.genes)
        array = array[None] if array is not None and array.ndim == 1 else array
        if array is None or array.ndim != 2 or array.shape[1] != n:
            got = show(genomes) if array is None else np.shape(genomes)
            raise CaterpillarError(f"genomes must have shape ({n},) or (P, {n}); got {got}")
        bad = ~((array >= 0) & (array <= 1))
        if bad.any():
            row, column = np.argwhere(bad)[0]
            raise CaterpillarError(
                f"gene {column} of genome {row} is {array[row, column]}; genes must lie in [0, 1]"
            )
        return array

    def decode(self, genomes: Array) -> tuple[list[Body], GaitTimings]:
        """Return the bodies and gaits of genomes (P, n) or (n,).

        Returns:
            P bodies, and timings of shape (P, pairs), or (P, springs) if the kind is `full`.

        Raises:
            CaterpillarError: see `check`.
        """
        array = self.check(genomes)
        body_genes, gait_genes = np.split(array, [self._num_body_genes], axis=1)
        size = len(PARAMETERS)
        segments = body_genes.reshape(len(array), self._num_body_genes // size, size)
        bodies = [tuple(Morphology.from_unit(segment) for segment in row) for row in segments]
        timings = self._decode_gait(gait_genes)
        return [body if self.kind == "per-segment" else body[0] for body in bodies], timings

    @property
    def _num_body_genes(self) -> int:
        """Number of morphology genes."""
        bodies = self.physics.num_segments if self.kind == "per-segment" else 1
        return bodies * len(PARAMETERS)

    def _decode_gait(self, genes: Array) -> GaitTimings:
        period_s = self.gait_period_s
        if self.timing == "on-off":
            action = (2.0 * genes - 1.0).astype(np.float32)
        else:
            if self.timing == "wave":
                genes = self._repeat_wave(genes)
            timings = GaitTimings.from_phases(
                genes[:, 0::2], MAX_DUTY * genes[:, 1::2], period_s, springs=self.kind == "full"
            )
            action = timings.to_action()
        # Built from an action, so that the environment reproduces the gait bit for bit.
        return GaitTimings.from_action(action, period_s)

    def _repeat_wave(self, genes: Array) -> Array:
        """Return the genes for the timing `phase`, (P, 2 pairs), from those for `wave`, (P, 4)."""
        phases = np.tile(genes, self.physics.num_segments - 1)
        phases[:, 0] = 0.0  # the first pair is switched on at the start of the period
        return phases

    def values(self, genomes: Array) -> Array:
        """Return the values of all genes in SI units, (P, n). Times are rounded as in the simulation.

        Raises:
            CaterpillarError: see `check`.
        """
        lower, upper = np.array([(gene.lower, gene.upper) for gene in self.genes]).T
        array = self.check(genomes)
        values: Array = lower + array * (upper - lower)
        if self.timing == "on-off":
            first = self._num_body_genes
            values[:, first:] = self._decode_gait(array[:, first:]).times_s
        return values

    def robot(self, genome: Array, **record: Any) -> Robot:
        """Return the robot of a genome (n,). The keywords are the robot's results, see `Robot`."""
        (body,), timings = self.decode(np.asarray(genome)[None])
        return Robot(body, timings[0], self.physics, **record)


def _make_delay(name: str, parameter: str) -> Gene:
    return Gene(name, "δ", "1", 0.0, 1.0, parameter, circular=True)


def _make_duty(name: str) -> Gene:
    return Gene(name, "D", "1", 0.0, MAX_DUTY, "duty")


def _find_parameter(name: str) -> str:
    """Return `Gene.parameter` for the delay gene of a pair or spring."""
    if name.endswith("_right"):
        return "side"
    if "ventral" in name:
        return "offset"
    return "start" if name.startswith("gap1_") else "lag"
