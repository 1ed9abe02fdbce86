"""Domain randomization of friction, actuator mismatch, mass and air temperature at each reset.

`Randomization` holds the ranges, and `Conditions` holds one sample. `apply_conditions` applies a sample
to a model.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping
from dataclasses import dataclass, fields, replace
from typing import Any, NamedTuple

import mujoco
import numpy as np

from caterpillar_env.errors import CaterpillarError, from_mapping, show
from caterpillar_env.ground import TILE, condim
from caterpillar_env.model import trim_tendons
from caterpillar_env.physics import Physics, mismatched

Range = tuple[float, float]


class Conditions(NamedTuple):
    """Conditions of one episode."""

    friction: float  #: friction coefficient of feet and elements on the ground
    strengths: tuple[float, ...]  #: factor on the force of each spring
    mass: float  #: factor on the mass of the body
    ambient_c: float  #: air temperature, degC


@dataclass(frozen=True)
class Randomization:
    """Ranges of conditions, sampled uniformly at each reset. None keeps the value of `Physics`.

    Raises:
        CaterpillarError: a range is not a pair (lower, upper), or is out of bounds.
    """

    friction: Range | None = None  #: friction coefficient of feet and elements on the ground
    mismatch_std: Range | None = None  #: standard deviation of new spring-force factors
    spring_force: Range | None = None  #: one force factor for all springs
    mass: Range | None = None  #: factor on the mass of the body
    ambient_c: Range | None = None  #: air temperature, degC

    def __post_init__(self) -> None:
        for f in fields(self):
            value = getattr(self, f.name)
            if value is None:
                continue
            try:
                low, high = map(float, value)
            except (TypeError, ValueError, OverflowError):
                low, high = math.nan, math.nan
            least, greatest = _BOUNDS[f.name]
            if not least <= low <= high <= greatest:
                raise CaterpillarError(
                    f"randomization of {f.name} must be (lower, upper) with {least:g} <= lower <= upper "
                    f"<= {greatest:g}; got {show(value)}"
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
        """Check that springs can cool down in the warmest air.

        Raises:
            CaterpillarError: `ambient_c` reaches the martensite finish temperature Mf.
        """
        if self.ambient_c is not None:
            replace(physics.spring, ambient_c=self.ambient_c[1])

    def draw(self, physics: Physics, rng: np.random.Generator) -> Conditions:
        """Sample the conditions of one episode. The number of random draws is always the same."""
        shares = rng.uniform(size=len(fields(self)))
        normal = rng.standard_normal(physics.num_springs)
        sampled = {}
        for (name, bounds), share in zip(vars(self).items(), shares.tolist(), strict=True):
            if bounds is not None:
                sampled[name] = bounds[0] + share * (bounds[1] - bounds[0])
        strengths = physics.strengths()
        if "mismatch_std" in sampled:
            strengths = mismatched(sampled["mismatch_std"], normal)
        return Conditions(
            friction=sampled.get("friction", physics.friction),
            strengths=tuple((sampled.get("spring_force", 1.0) * strengths).tolist()),
            mass=sampled.get("mass", 1.0),
            ambient_c=sampled.get("ambient_c", physics.spring.ambient_c),
        )


#: Bounds of each range. Springs without force and bodies without mass cannot be simulated.
_BOUNDS = {
    "friction": (0.0, 100.0), "mismatch_std": (0.0, 10.0), "spring_force": (0.01, 100.0),
    "mass": (0.01, 100.0), "ambient_c": (-273.15, 2000.0),
}  # fmt: skip


def apply_conditions(model: mujoco.MjModel, physics: Physics, conditions: Conditions) -> mujoco.MjModel:
    """Return a copy of `model` with `conditions` applied, except the air temperature."""
    changed = copy.copy(model)
    tiles = changed.geom_priority == TILE  # a tile's friction is a multiple of the robot's
    changed.geom_friction[tiles, 0] *= conditions.friction / (physics.friction or 1.0)
    changed.geom_friction[~tiles, 0] = conditions.friction
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
