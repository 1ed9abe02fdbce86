"""Domain randomization of friction, actuator mismatch, mass and air temperature at each reset.

`Randomization` holds the ranges and `Conditions` one sample. `apply_conditions` applies a sample to a
model.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, NamedTuple

import mujoco
import numpy as np

from caterpillar_env.errors import CaterpillarError, from_mapping
from caterpillar_env.ground import condim
from caterpillar_env.model import trim_tendons
from caterpillar_env.physics import Physics, mismatched

Range = tuple[float, float]


class Conditions(NamedTuple):
    """Conditions of one episode."""

    friction: float  #: coefficient of feet and elements on the ground
    strengths: tuple[float, ...]  #: factor on the force of each spring
    mass: float  #: factor on the mass of the body
    ambient_c: float  #: air temperature, degC


@dataclass(frozen=True)
class Randomization:
    """Ranges to sample conditions from, uniformly, at each reset. None keeps the value of `Physics`.

    Raises:
        CaterpillarError: a range is not a pair of increasing numbers, or is out of bounds.
    """

    friction: Range | None = None  #: coefficient of feet and elements on the ground
    mismatch_std: Range | None = None  #: standard deviation of newly sampled spring strengths
    spring_force: Range | None = None  #: factor on the force of all springs
    mass: Range | None = None  #: factor on the mass of the body
    ambient_c: Range | None = None  #: air temperature, degC

    def __post_init__(self) -> None:
        for f in fields(self):
            value = getattr(self, f.name)
            if value is None:
                continue
            try:
                low, high = map(float, value)
            except (TypeError, ValueError):
                low, high = math.nan, math.nan
            minimum, exclusive = _MINIMUM[f.name]
            if not (low <= high < math.inf and (low > minimum if exclusive else low >= minimum)):
                raise CaterpillarError(
                    f"randomization of {f.name} must be two numbers in increasing order, "
                    f"{'above' if exclusive else 'at least'} {minimum:g}; got {value!r}"
                )
            object.__setattr__(self, f.name, (low, high))

    @classmethod
    def of(cls, value: Randomization | Mapping[str, Any] | None) -> Randomization | None:
        """Return `value` as a `Randomization`, or None if it randomizes nothing.

        Raises:
            CaterpillarError: a field is unknown or its value is invalid.
        """
        if not isinstance(value, Randomization):
            value = from_mapping(cls, {} if value is None else value, "randomization")
        return None if value == cls() else value

    def check(self, physics: Physics) -> None:
        """Check that springs can cool down at every air temperature in the range.

        Raises:
            CaterpillarError: `ambient_c` reaches the martensite finish temperature Mf.
        """
        finish_c = physics.spring.martensite_finish_c
        if self.ambient_c is not None and self.ambient_c[1] >= finish_c:
            raise CaterpillarError(
                f"randomization of ambient_c must end below {finish_c:g} degC (Mf), so that springs "
                f"can cool down; got {self.ambient_c}"
            )

    def draw(self, physics: Physics, rng: np.random.Generator) -> Conditions:
        """Sample the conditions of one episode. The number of random draws is always the same."""
        share = rng.uniform(size=len(fields(self)))
        normal = rng.standard_normal(physics.num_springs)

        def sample(name: str, index: int, default: float) -> float:
            bounds: Range | None = getattr(self, name)
            if bounds is None:
                return default
            return float(bounds[0] + share[index] * (bounds[1] - bounds[0]))

        strengths = physics.strengths()
        if self.mismatch_std is not None:
            strengths = mismatched(sample("mismatch_std", 1, 0.0), normal)
        return Conditions(
            friction=sample("friction", 0, physics.friction),
            strengths=tuple((sample("spring_force", 2, 1.0) * strengths).tolist()),
            mass=sample("mass", 3, 1.0),
            ambient_c=sample("ambient_c", 4, physics.spring.ambient_c),
        )


#: Minimum of each range, and whether the minimum itself is excluded.
_MINIMUM = {
    "friction": (0.0, False), "mismatch_std": (0.0, False), "spring_force": (0.0, True),
    "mass": (0.0, True), "ambient_c": (-273.15, False),
}  # fmt: skip


def apply_conditions(model: mujoco.MjModel, physics: Physics, conditions: Conditions) -> mujoco.MjModel:
    """Return a copy of `model` with `conditions`. `ambient_c` affects only the springs."""
    changed = copy.copy(model)
    changed.geom_friction[:, 0] = conditions.friction
    changed.geom_condim[:] = condim(conditions.friction)
    ratio = (np.array(conditions.strengths) / physics.strengths())[:, None]
    for parameters in (changed.actuator_gainprm, changed.actuator_biasprm, changed.actuator_forcerange):
        parameters *= ratio
    if conditions.mass != 1.0:
        changed.body_mass *= conditions.mass
        changed.body_inertia *= conditions.mass
        mujoco.mj_setConst(changed, mujoco.MjData(changed))
        trim_tendons(changed)
    return changed
