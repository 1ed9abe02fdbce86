"""Worlds: the ground that robots crawl on. The default is flat.

A world is part of `Physics`. Robots start with the head at the origin and crawl along x. On a slope,
gravity is tilted and the ground stays at z = 0. All positions and directions are relative to the ground.
Random features are generated from a seed, and are the same on every machine.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, fields
from functools import lru_cache
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from caterpillar_env.arrays import Array
from caterpillar_env.errors import CaterpillarError, check_fields, from_mapping, show

#: Extent of rough ground along x and y, m. Steps end before the upper limit of x. The ground outside
#: this range is level.
EXTENT_X_M, EXTENT_Y_M = (-0.6, 1.2), (-0.3, 0.3)
#: Extent of the tiles along x and y, m. Tiles at the edge are extended to 5 m from the origin.
TILES_X_M, TILES_Y_M = (-0.2, 0.7), (-0.15, 0.15)
#: Position of the first step, just in front of the head, m.
FIRST_STEP_M = 0.02

_BOUNDS = {
    "angle_deg": (0.0, 45.0),
    "height_m": (1e-4, 0.01),  # a body is 12 to 30 mm in diameter
    "spacing_m": (0.02, 1.0),
    "amplitude_m": (1e-4, 0.01),
    "wavelength_m": (0.02, 1.0),
    "size_m": (0.02, 1.0),
    "least": (0.05, 10.0),
    "greatest": (0.05, 10.0),
    "seed": (0, 2**63),
}
_STEEPEST = 8  # smallest ratio of wavelength to amplitude; the steepest ground is then about 20 degrees
_CELLS = 8  # height samples per wavelength
_LARGEST_CELL_M = 0.01
_ROUGH, _PATCHES = 0x52, 0x50  # spawn keys of the random streams


@dataclass(frozen=True)
class World:
    """Base class of worlds. To create a world, use a subclass or `World.of`.

    Raises:
        CaterpillarError: a value has the wrong type or is out of range.
    """

    def __post_init__(self) -> None:
        check_fields(self, _BOUNDS)

    @classmethod
    def of(cls, value: World | Mapping[str, Any] | str) -> World:
        """Return `value` as a world.

        Args:
            value: a world, a mapping with its `kind` and fields, or text such as "rough" or
                "slope:angle_deg=5,direction=down". Missing fields keep their defaults.

        Raises:
            CaterpillarError: the kind or a field is unknown, or a value is invalid.
        """
        if isinstance(value, World) and type(value) is not World:
            return value
        given = _parse(value) if isinstance(value, str) else value
        if not isinstance(given, Mapping):
            raise CaterpillarError(f"world must be one of {', '.join(WORLDS)}; got {show(value)}")
        kind = given.get("kind")
        if not isinstance(kind, str) or kind not in WORLDS:
            raise CaterpillarError(f"kind of world must be one of {', '.join(WORLDS)}; got {show(kind)}")
        return from_mapping(WORLDS[kind], given, f"world {kind}")

    def __str__(self) -> str:
        """Return text for `World.of`, with the fields that differ from their defaults."""
        values = asdict(self)
        kind = values.pop("kind", "")
        defaults = {f.name: f.default for f in fields(self)}
        changed = [f"{name}={value}" for name, value in values.items() if value != defaults[name]]
        return f"{kind}:{','.join(changed)}" if changed else kind

    @property
    def up(self) -> tuple[float, float, float]:
        """Unit vector opposite to gravity, in the frame of the ground."""
        return 0.0, 0.0, 1.0

    @property
    def level(self) -> bool:
        """Whether the ground is the plane z = 0 everywhere in its frame."""
        return True

    def surface(self, x: Array, y: Array) -> tuple[Array, Array]:
        """Return the height of the ground, m, (...), and its unit normals, (..., 3), at points (...)."""
        normals = np.zeros((*np.shape(x), 3))
        normals[..., 2] = 1.0
        return np.zeros(np.shape(x)), normals


@dataclass(frozen=True)
class Flat(World):
    """A horizontal plane."""

    kind: Literal["flat"] = field(default="flat", kw_only=True)


@dataclass(frozen=True)
class Slope(World):
    """An inclined plane. The robot crawls up, down, or across it with uphill on its left."""

    angle_deg: float = 10.0  #: inclination, 0 to 45 degrees
    direction: Literal["up", "down", "across"] = "up"  #: crawling direction on the slope
    kind: Literal["slope"] = field(default="slope", kw_only=True)

    @property
    def up(self) -> tuple[float, float, float]:
        """See `World.up`."""
        angle = math.radians(self.angle_deg)
        along = {"up": (1.0, 0.0), "down": (-1.0, 0.0), "across": (0.0, 1.0)}[self.direction]
        return along[0] * math.sin(angle), along[1] * math.sin(angle), math.cos(angle)


@dataclass(frozen=True)
class Steps(World):
    """Stairs across x that begin in front of the robot."""

    height_m: float = 0.002  #: height of a step, 0.1 to 10 mm
    spacing_m: float = 0.04  #: depth of a step, 20 mm to 1 m
    direction: Literal["up", "down"] = "up"
    kind: Literal["steps"] = field(default="steps", kw_only=True)

    @property
    def level(self) -> bool:
        """See `World.level`."""
        return False

    @property
    def count(self) -> int:
        """Number of steps."""
        return int((EXTENT_X_M[1] - FIRST_STEP_M) / self.spacing_m)

    @property
    def rise_m(self) -> float:
        """Height of a step, negative for steps that lead down, m."""
        return self.height_m if self.direction == "up" else -self.height_m

    def surface(self, x: Array, y: Array) -> tuple[Array, Array]:
        """See `World.surface`. The normals of the treads are used everywhere."""
        _, normals = super().surface(x, y)
        passed = np.clip(np.floor((x - FIRST_STEP_M) / self.spacing_m) + 1.0, 0.0, self.count)
        return np.where(np.isfinite(passed), passed, 0.0) * self.rise_m, normals


class HeightField(NamedTuple):
    """Heights on a rectangular grid, interpolated bilinearly between its points."""

    heights_m: Array  #: (rows along y, columns along x)
    x_m: tuple[float, float]  #: first and last column
    y_m: tuple[float, float]  #: first and last row


@dataclass(frozen=True)
class Rough(World):
    """Smooth random bumps: a cubic B-spline through random heights, half a wavelength apart."""

    amplitude_m: float = 0.003  #: largest height above z = 0, or depth below it; 0.1 to 10 mm
    wavelength_m: float = 0.06  #: twice the distance between random heights; 20 mm to 1 m
    seed: int = 0  #: random seed of the heights
    kind: Literal["rough"] = field(default="rough", kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.wavelength_m < _STEEPEST * self.amplitude_m:
            raise CaterpillarError(
                f"amplitude_m = {self.amplitude_m:g} must be at most 1/{_STEEPEST} of wavelength_m = "
                f"{self.wavelength_m:g}; choose flatter ground"
            )

    @property
    def level(self) -> bool:
        """See `World.level`."""
        return False

    @property
    def height_field(self) -> HeightField:
        """Heights of the ground. They fade to 0 within a wavelength of the edge of the grid."""
        return _height_field(self)

    def surface(self, x: Array, y: Array) -> tuple[Array, Array]:
        """See `World.surface`."""
        heights, (x_0, x_1), (y_0, y_1) = self.height_field
        rows, columns = heights.shape
        cell_x, cell_y = (x_1 - x_0) / (columns - 1), (y_1 - y_0) / (rows - 1)
        # A diverging robot has positions that are not finite.
        u = np.clip(np.nan_to_num((x - x_0) / cell_x), 0.0, columns - 1.0)
        v = np.clip(np.nan_to_num((y - y_0) / cell_y), 0.0, rows - 1.0)
        inside = (u > 0) & (u < columns - 1) & (v > 0) & (v < rows - 1)
        i, j = np.minimum(u.astype(int), columns - 2), np.minimum(v.astype(int), rows - 2)
        s, t = u - i, v - j
        near, far = heights[j, i], heights[j, i + 1]
        near_left, far_left = heights[j + 1, i], heights[j + 1, i + 1]
        right, left = near + s * (far - near), near_left + s * (far_left - near_left)
        rise_x = inside * ((far - near) * (1.0 - t) + (far_left - near_left) * t) / cell_x
        rise_y = inside * (left - right) / cell_y
        scale = 1.0 / np.sqrt(1.0 + rise_x * rise_x + rise_y * rise_y)
        normals = np.stack([-rise_x * scale, -rise_y * scale, scale], axis=-1)
        return right + t * (left - right), normals


@dataclass(frozen=True)
class Patches(World):
    """Square tiles on flat ground. The friction of the feet differs from tile to tile."""

    size_m: float = 0.03  #: side length of a tile, 20 mm to 1 m
    least: float = 0.25  #: smallest factor on `Physics.friction`
    greatest: float = 1.0  #: largest factor; the factors are uniformly distributed
    seed: int = 0  #: random seed of the factors
    kind: Literal["patches"] = field(default="patches", kw_only=True)

    def __post_init__(self) -> None:
        super().__post_init__()
        if self.least > self.greatest:
            raise CaterpillarError(
                f"least = {self.least:g} must not exceed greatest = {self.greatest:g}"
            )

    def factors(self) -> tuple[Array, Array, Array]:
        """Return the tile edges along x and along y, m, and the factors, (tiles in x, tiles in y)."""
        x, y = (
            np.asarray(low) + self.size_m * np.arange(math.ceil((high - low) / self.size_m) + 1)
            for low, high in (TILES_X_M, TILES_Y_M)
        )
        shares = _generator(_PATCHES, self.seed).random((len(x) - 1, len(y) - 1))
        return x, y, self.least + (self.greatest - self.least) * shares


#: Worlds by their `kind`.
WORLDS: dict[str, type[World]] = {
    "flat": Flat, "slope": Slope, "steps": Steps, "rough": Rough, "patches": Patches,
}  # fmt: skip


def _parse(text: str) -> dict[str, Any]:
    """Convert the text of a world to a mapping, see `World.of`."""
    kind, _, rest = text.partition(":")
    values: dict[str, Any] = {"kind": kind}
    for part in rest.split(",") if rest else ():
        name, equals, value = part.partition("=")
        if not equals:
            raise CaterpillarError(
                f"world = {show(text)} must be a kind such as 'rough', or a kind with fields such as "
                "'slope:angle_deg=5,direction=down'"
            )
        try:
            values[name.strip().replace("-", "_")] = json.loads(value)
        except ValueError:
            values[name.strip().replace("-", "_")] = value.strip()  # not JSON, such as down
    return values


def _generator(stream: int, seed: int) -> np.random.Generator:
    return np.random.default_rng(np.random.SeedSequence(seed, spawn_key=(stream,)))


@lru_cache(maxsize=16)
def _height_field(world: Rough) -> HeightField:
    """Compute heights with basic arithmetic only, so that they are the same on every machine."""
    cell_m = min(world.wavelength_m / _CELLS, _LARGEST_CELL_M)
    (x_0, x_1), (y_0, y_1) = EXTENT_X_M, EXTENT_Y_M
    columns, rows = round((x_1 - x_0) / cell_m) + 1, round((y_1 - y_0) / cell_m) + 1
    per_node = 2.0 * cell_m / world.wavelength_m
    along, across = np.arange(columns) * per_node, np.arange(rows) * per_node
    shape = int(across[-1]) + 4, int(along[-1]) + 4
    nodes = 2.0 * _generator(_ROUGH, world.seed).random(shape) - 1.0
    heights = _interpolate(_interpolate(nodes, across).T, along).T
    for axis, places in enumerate((across, along)):
        edge = np.minimum(np.minimum(places, places[-1] - places) / 2.0, 1.0)
        heights = heights * (edge * edge * (3.0 - 2.0 * edge)).reshape((-1, 1) if axis == 0 else (1, -1))
    heights = heights * (world.amplitude_m / np.abs(heights).max())
    heights.setflags(write=False)
    return HeightField(heights, (x_0, x_0 + (columns - 1) * cell_m), (y_0, y_0 + (rows - 1) * cell_m))


def _interpolate(nodes: Array, places: NDArray[Any]) -> Array:
    """Return values (p, n) of the uniform cubic B-spline with control points (m, n) at places (p,)."""
    first = places.astype(int)
    t = (places - first)[:, None]
    weights = (
        (1.0 - t) * (1.0 - t) * (1.0 - t),
        (3.0 * t - 6.0) * t * t + 4.0,
        ((3.0 - 3.0 * t) * t + 3.0) * t + 1.0,
        t * t * t,
    )
    total = np.zeros((len(places), nodes.shape[1]))
    for offset, weight in enumerate(weights):
        total = total + weight * nodes[first + offset]
    return total / 6.0
