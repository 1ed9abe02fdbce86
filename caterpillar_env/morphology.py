"""The eight body parameters that are evolved (Saunders 2009, section III and fig. 8)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from caterpillar_env.arrays import Array
from caterpillar_env.errors import MorphologyError, from_mapping


class Parameter(NamedTuple):
    """One body parameter: a field of `Morphology`, the paper's symbol, and its closed interval."""

    name: str
    symbol: str
    unit: str
    lower: float
    upper: float
    nominal: float
    description: str


#: In the paper's order. The bounds stand for the paper's "manufacturability, cost and physical
#: constraints", which it does not print; see docs/sources.md.
PARAMETERS: tuple[Parameter, ...] = (
    Parameter("leg_separation_m", "w", "m", 0.008, 0.024, 0.016, "lateral separation of the feet"),
    Parameter("segment_length_m", "L", "m", 0.022, 0.036, 0.030, "length of one segment"),
    Parameter("segment_radius_m", "R", "m", 0.009, 0.015, 0.012, "radius of one element"),
    Parameter("segment_mass_kg", "m", "kg", 0.004, 0.012, 0.008, "mass of one segment"),
    Parameter("joint_limit_rad", "q", "rad", 0.2, 1.0, 0.6, "limit of the revolute joints"),
    Parameter("attachment_x_m", "x", "m", 0.0, 0.006, 0.003, "spring attachment, outboard"),
    Parameter("attachment_y_m", "y", "m", 0.004, 0.009, 0.0065, "spring attachment, vertical"),
    Parameter("attachment_z_m", "z", "m", 0.003, 0.009, 0.006, "spring attachment, lateral"),
)
NAMES: tuple[str, ...] = tuple(p.name for p in PARAMETERS)
LOWER: Array = np.array([p.lower for p in PARAMETERS])
UPPER: Array = np.array([p.upper for p in PARAMETERS])
for _bound in (LOWER, UPPER):
    _bound.flags.writeable = False


@dataclass(frozen=True)
class Morphology:
    """The eight parameters of a segment, and of a body whose segments are built alike.

    The paper's axes are x longitudinal, y vertical and z lateral. `attachment_x_m` is measured from
    the centre of a legged element away from the neighbour that the spring pulls on, so that a spring
    spans L + 2x when the body is straight.

    Raises:
        MorphologyError: a value is not a finite number within its bounds (`PARAMETERS`).
    """

    leg_separation_m: float = PARAMETERS[0].nominal
    segment_length_m: float = PARAMETERS[1].nominal
    segment_radius_m: float = PARAMETERS[2].nominal
    segment_mass_kg: float = PARAMETERS[3].nominal
    joint_limit_rad: float = PARAMETERS[4].nominal
    attachment_x_m: float = PARAMETERS[5].nominal
    attachment_y_m: float = PARAMETERS[6].nominal
    attachment_z_m: float = PARAMETERS[7].nominal

    def __post_init__(self) -> None:
        for p in PARAMETERS:
            value = getattr(self, p.name)
            is_number = isinstance(value, (int, float, np.number)) and not isinstance(value, bool)
            number = float(value) if is_number else float("nan")
            if not p.lower <= number <= p.upper:
                raise MorphologyError(
                    f"{p.name} = {value!r} is not in [{p.lower:g}, {p.upper:g}] {p.unit} "
                    f"({p.description}, {p.symbol} in the paper); choose a value in that interval"
                )
            object.__setattr__(self, p.name, number)

    @classmethod
    def of(cls, value: Morphology | Mapping[str, Any] | Sequence[float] | NDArray[Any]) -> Morphology:
        """Return the morphology that `value` describes.

        Args:
            value: a `Morphology`, a mapping of the parameters that differ from the nominal body (names
                in `NAMES`, SI units), or all eight values in that order, shape (8,).

        Raises:
            MorphologyError: a name is unknown, the shape is wrong, or a value is out of bounds.
        """
        if isinstance(value, Morphology):
            return value
        if isinstance(value, Mapping):
            return from_mapping(cls, value, "a morphology", MorphologyError)
        try:
            array = np.asarray(value, dtype=np.float64)
        except (TypeError, ValueError):
            array = np.empty(0)
        if array.shape != (len(PARAMETERS),):
            raise MorphologyError(
                f"a morphology is a mapping or {len(PARAMETERS)} numbers ({', '.join(NAMES)}); "
                f"got {value!r}"
            )
        return cls(*array.tolist())

    @classmethod
    def from_unit(cls, unit: Array) -> Morphology:
        """The morphology at `unit`, shape (8,), where 0 is the lower and 1 the upper bound."""
        return cls(*np.clip(LOWER + unit * (UPPER - LOWER), LOWER, UPPER).tolist())

    def to_array(self) -> Array:
        """The eight values in the order of `NAMES`, SI units, shape (8,)."""
        return np.array([getattr(self, f.name) for f in fields(self)])

    def to_unit(self) -> Array:
        """The eight values scaled to [0, 1] by their bounds, shape (8,)."""
        return (self.to_array() - LOWER) / (UPPER - LOWER)

    def to_dict(self) -> dict[str, float]:
        """The eight values by name, SI units: plain JSON."""
        return asdict(self)


#: A robot's body: one morphology for all segments (the paper's), or one each, from head to tail.
Body = Morphology | tuple[Morphology, ...]


def length_m(segments: Sequence[Morphology]) -> float:
    """Return the length of a body, m."""
    return sum(segment.segment_length_m for segment in segments)


def segments_of(body: Body, num_segments: int) -> tuple[Morphology, ...]:
    """Return the morphology of each segment, from head to tail.

    Raises:
        MorphologyError: `body` is neither one morphology nor one per segment.
    """
    if isinstance(body, Morphology):
        return (body,) * num_segments
    if len(body) != num_segments:
        raise MorphologyError(
            f"a body of {num_segments} segments is one morphology for all of them, or a tuple of "
            f"{num_segments}; got {len(body)}"
        )
    return tuple(body)
