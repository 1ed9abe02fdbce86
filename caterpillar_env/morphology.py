"""Body parameters, their bounds and units (Saunders 2009, section III and fig. 8)."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, fields
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from caterpillar_env.arrays import Array
from caterpillar_env.errors import CaterpillarError, from_mapping, show, to_array, to_number


class Parameter(NamedTuple):
    """A body parameter: field of `Morphology`, symbol in the paper, unit, bounds and nominal value."""

    name: str
    symbol: str
    unit: str
    lower: float
    upper: float
    nominal: float
    description: str


#: The eight parameters in the paper's order. The paper does not publish bounds; docs/sources.md gives
#: the source of the bounds used here.
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
    """The eight parameters of a segment, or of a body of identical segments.

    As in the paper, x is longitudinal, y vertical and z lateral. `attachment_x_m` is measured from the
    centre of a legged element, in the direction away from the legged element at the other end of the
    spring. A spring therefore has the length L + 2x in a straight body.

    Raises:
        CaterpillarError: a value is not a number within its bounds (see `PARAMETERS`).
    """

    leg_separation_m: float = PARAMETERS[0].nominal  #: lateral separation of the feet, m
    segment_length_m: float = PARAMETERS[1].nominal  #: length of one segment, m
    segment_radius_m: float = PARAMETERS[2].nominal  #: radius of an element, m; two per segment
    segment_mass_kg: float = PARAMETERS[3].nominal  #: mass of one segment, kg
    joint_limit_rad: float = PARAMETERS[4].nominal  #: limit of the revolute joints, rad
    #: longitudinal distance of a spring's attachment from the centre of its element, m
    attachment_x_m: float = PARAMETERS[5].nominal
    attachment_y_m: float = PARAMETERS[6].nominal  #: vertical distance of the attachment, m
    attachment_z_m: float = PARAMETERS[7].nominal  #: lateral distance of the attachment, m

    def __post_init__(self) -> None:
        for p in PARAMETERS:
            value = getattr(self, p.name)
            number = to_number(value)
            if number is None or not p.lower <= number <= p.upper:
                raise CaterpillarError(
                    f"{p.name} = {show(value)} must be in [{p.lower:g}, {p.upper:g}] {p.unit} "
                    f"({p.description}, {p.symbol} in the paper)"
                )
            object.__setattr__(self, p.name, float(number))

    @classmethod
    def of(cls, value: Morphology | Mapping[str, Any] | Sequence[float] | NDArray[Any]) -> Morphology:
        """Return `value` as a `Morphology`.

        Args:
            value: a `Morphology`; a mapping with any of the `NAMES`, where missing parameters are
                nominal; or all eight values in the order of `NAMES`, SI units, shape (8,).

        Raises:
            CaterpillarError: a name is unknown, the shape is wrong, or a value is out of bounds.
        """
        if isinstance(value, Morphology):
            return value
        if isinstance(value, Mapping):
            return from_mapping(cls, value, "a morphology")
        array = to_array(value)
        if array is None or array.shape != (len(PARAMETERS),):
            raise CaterpillarError(
                f"a morphology must be a mapping or {len(PARAMETERS)} numbers ({', '.join(NAMES)}); "
                f"got {show(value)}"
            )
        return cls(*array.tolist())

    @classmethod
    def from_unit(cls, unit: Array) -> Morphology:
        """Create a morphology from values scaled to [0, 1] by their bounds, shape (8,)."""
        return cls(*np.clip(LOWER + unit * (UPPER - LOWER), LOWER, UPPER).tolist())

    def to_array(self) -> Array:
        """Return the values in the order of `NAMES`, SI units, shape (8,)."""
        return np.array([getattr(self, f.name) for f in fields(self)])

    def to_unit(self) -> Array:
        """Return the values scaled to [0, 1] by their bounds, shape (8,)."""
        return (self.to_array() - LOWER) / (UPPER - LOWER)

    def to_dict(self) -> dict[str, float]:
        """Return the values by name, SI units, for JSON."""
        return asdict(self)


#: A robot's body: one morphology for all segments, as in the paper, or one per segment from the head.
Body = Morphology | tuple[Morphology, ...]


def length_m(body: Body, num_segments: int) -> float:
    """Return the length of a robot's body, m."""
    return sum(segment.segment_length_m for segment in segments_of(body, num_segments))


def segments_of(body: Body, num_segments: int) -> tuple[Morphology, ...]:
    """Return the morphology of each segment, from head to tail.

    Raises:
        CaterpillarError: `body` is a tuple whose length is not `num_segments`.
    """
    if isinstance(body, Morphology):
        return (body,) * num_segments
    if len(body) != num_segments:
        raise CaterpillarError(
            f"the body of a robot with {num_segments} segments must be one morphology for all segments "
            f"or a tuple of {num_segments} morphologies; got {len(body)}"
        )
    return tuple(body)
