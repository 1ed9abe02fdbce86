"""Springs that fail in an episode: their drive is cut or weakened, at reset or later."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from caterpillar_env.arrays import Array
from caterpillar_env.errors import CaterpillarError, check_fields, from_mapping, show
from caterpillar_env.gait import MAX_STEPS
from caterpillar_env.physics import SMA_STEP_S

_BOUNDS = {"springs": (1, 1000), "power": (0.0, 1.0), "time_s": (0.0, MAX_STEPS * SMA_STEP_S)}


@dataclass(frozen=True)
class Faults:
    """Failures of springs in an episode. The springs and the time are sampled at each reset.

    A spring without power stays in the body. It cools down and keeps its cold tension.

    Raises:
        CaterpillarError: a value has the wrong type or is out of range.
    """

    springs: int = 1  #: number of springs that fail; every episode samples which ones
    power: float = 0.0  #: share of the drive power that failed springs keep; 0 for dead springs
    time_s: tuple[float, ...] = (0.0, 0.0)  #: earliest and latest time of the failure, s since reset

    def __post_init__(self) -> None:
        check_fields(self, _BOUNDS)
        if len(self.time_s) != 2 or self.time_s[0] > self.time_s[1]:
            raise CaterpillarError(
                "time_s of faults must be (earliest, latest) with earliest <= latest; got "
                f"{show(self.time_s)}"
            )

    @classmethod
    def of(cls, value: Faults | Mapping[str, Any] | int | None) -> Faults | None:
        """Return `value` as `Faults`. An integer n stands for `Faults(springs=n)`, and 0 for no faults.

        Raises:
            CaterpillarError: a field is unknown or its value is invalid.
        """
        if value is None or isinstance(value, Faults):
            return value
        if isinstance(value, (int, np.integer)) and not isinstance(value, bool):
            return None if value == 0 else cls(springs=int(value))
        if not isinstance(value, Mapping):
            raise CaterpillarError(
                f"faults must be a number of springs, or a mapping from field names to values; got "
                f"{show(value)}"
            )
        return from_mapping(cls, value, "faults")

    def draw(self, num_springs: int, rng: np.random.Generator) -> tuple[Array, int]:
        """Sample the share of the power that each spring keeps, and the thermal step of the failure."""
        shares = np.ones(num_springs)
        shares[rng.choice(num_springs, self.springs, replace=False)] = self.power
        earliest, latest = self.time_s
        return shares, round((earliest + (latest - earliest) * rng.random()) / SMA_STEP_S)
