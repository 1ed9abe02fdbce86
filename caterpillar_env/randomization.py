"""Domain randomisation: what may differ from one robot, or one day, to the next.

`Conditions` are what one robot meets with, `Randomization` says what they are drawn from, and `varied`
writes them into a compiled model.
"""

from __future__ import annotations

import copy
import math
from collections.abc import Mapping
from dataclasses import dataclass, fields
from typing import Any, NamedTuple

import mujoco
import numpy as np

from caterpillar_env.errors import PhysicsError, from_mapping
from caterpillar_env.ground import condim
from caterpillar_env.model import trim_tendons
from caterpillar_env.physics import Physics, mismatched

Range = tuple[float, float]


class Conditions(NamedTuple):
    """What one robot meets with."""

    friction: float  #: of its feet and elements on the ground
    strengths: tuple[float, ...]  #: factor on each spring's force
    mass: float  #: factor on the mass of the body
    ambient_c: float  #: temperature of the air, degC


@dataclass(frozen=True)
class Randomization:
    """What conditions are drawn from at each reset, uniformly between two bounds; None: as in `Physics`.

    Raises:
        PhysicsError: bounds are no two numbers in order, or out of range.
    """

    friction: Range | None = None  #: of feet and elements on the ground
    mismatch_std: Range | None = None  #: spread of the springs' strengths, which are drawn anew with it
    spring_force: Range | None = None  #: factor on the force of all springs
    mass: Range | None = None  #: factor on the mass of the body
    ambient_c: Range | None = None  #: temperature of the air, degC

    def __post_init__(self) -> None:
        for f in fields(self):
            value = getattr(self, f.name)
            if value is None:
                continue
            try:
                low, high = map(float, value)
            except (TypeError, ValueError):
                low, high = math.nan, math.nan
            least, open_ = _LEAST[f.name]
            if not (low <= high < math.inf and (low > least if open_ else low >= least)):
                raise PhysicsError(
                    f"randomization of {f.name} must be two numbers, the lesser first, each "
                    f"{'above' if open_ else 'not below'} {least:g}; got {value!r}"
                )
            object.__setattr__(self, f.name, (low, high))

    @classmethod
    def of(cls, value: Randomization | Mapping[str, Any] | None) -> Randomization | None:
        """Randomisation from itself or a mapping of its fields; None where nothing is to be drawn.

        Raises:
            PhysicsError: an unknown field or an unusable value.
        """
        if not isinstance(value, Randomization):
            value = from_mapping(cls, {} if value is None else value, "randomization", PhysicsError)
        return None if value == cls() else value

    def check(self, physics: Physics) -> None:
        """See that the air cannot be warmer than springs that are to cool down.

        Raises:
            PhysicsError: it can.
        """
        finish_c = physics.spring.martensite_finish_c
        if self.ambient_c is not None and self.ambient_c[1] >= finish_c:
            raise PhysicsError(
                f"randomization of ambient_c must end below {finish_c:g} degC, where springs finish "
                f"cooling; got {self.ambient_c}"
            )

    def draw(self, physics: Physics, rng: np.random.Generator) -> Conditions:
        """Conditions for one episode; the number of draws does not depend on what is randomised."""
        share = rng.uniform(size=len(fields(self)))
        normal = rng.standard_normal(physics.num_springs)

        def value(name: str, place: int, default: float) -> float:
            bounds: Range | None = getattr(self, name)
            if bounds is None:
                return default
            return float(bounds[0] + share[place] * (bounds[1] - bounds[0]))

        strengths = physics.strengths()
        if self.mismatch_std is not None:
            strengths = mismatched(value("mismatch_std", 1, 0.0), normal)
        return Conditions(
            friction=value("friction", 0, physics.friction),
            strengths=tuple((value("spring_force", 2, 1.0) * strengths).tolist()),
            mass=value("mass", 3, 1.0),
            ambient_c=value("ambient_c", 4, physics.spring.ambient_c),
        )


#: Least value, and whether it is excluded itself.
_LEAST = {
    "friction": (0.0, False), "mismatch_std": (0.0, False), "spring_force": (0.0, True),
    "mass": (0.0, True), "ambient_c": (-273.15, False),
}  # fmt: skip


def apply_conditions(model: mujoco.MjModel, physics: Physics, conditions: Conditions) -> mujoco.MjModel:
    """A copy of a robot of `physics`, as it is under `conditions`; the air is the springs' affair."""
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
