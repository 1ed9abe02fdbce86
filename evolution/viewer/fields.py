"""What can be changed of a robot by hand: a slider for every number, within its bounds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from caterpillar_env.errors import CaterpillarError
from caterpillar_env.gait import GaitTimings
from caterpillar_env.morphology import PARAMETERS, Morphology, Parameter
from caterpillar_env.robot import Robot

#: Plausible ones are 0.4 to 1.2 (docs/sources.md).
_LOWEST_FRICTION, _HIGHEST_FRICTION = 0.05, 1.5
_SHOWN = {"m": ("mm", 1000, 1), "kg": ("g", 1000, 1), "rad": ("rad", 1, 2)}  # unit, factor, decimals


@dataclass(frozen=True)
class Field:
    """One number of a robot, in the unit in which it is shown."""

    folder: str
    label: str  #: with the unit
    hint: str
    lower: float
    upper: float
    decimals: int  #: to which it is shown
    exact: Callable[[Robot], float]
    put: Callable[[Robot, float], Robot]

    @property
    def step(self) -> float:
        """The smallest change."""
        return float(10.0**-self.decimals)

    def read(self, individual: Robot) -> float:
        """The robot's number, rounded as it is shown."""
        return round(self.exact(individual), self.decimals)

    def write(self, individual: Robot, value: float) -> Robot:
        """The robot with another number, its record gone; itself if it shows that number already.

        Raises:
            CaterpillarError: the value is not within the bounds.
        """
        if value == self.read(individual):
            return individual
        if not self.lower <= value <= self.upper:
            raise CaterpillarError(
                f"{self.label}: {value:g} is not in {self.lower:g} to {self.upper:g}; choose one there"
            )
        return replace(self.put(individual, value), fitness_m=None, generation=None)


def fields_of(individual: Robot) -> list[Field]:
    """All that can be changed of a robot with as many segments and times as this one."""
    body = individual.morphology
    segments = [None] if isinstance(body, Morphology) else list(range(len(body)))
    return [
        _friction(individual.physics.friction),
        *(_of_body(p, segment) for segment in segments for p in PARAMETERS),
        *(
            _of_gait(individual, index, edge)
            for index in range(len(individual.timed))
            for edge in ("on", "off")
        ),
    ]


def _friction(friction: float) -> Field:
    return Field(
        folder="",
        label="friction",
        hint="of feet and elements on the ground; another one starts anew",
        lower=min(_LOWEST_FRICTION, round(friction, 2)),
        upper=max(_HIGHEST_FRICTION, round(friction, 2)),
        decimals=2,
        exact=lambda robot: robot.physics.friction,
        put=lambda robot, value: replace(robot, physics=replace(robot.physics, friction=value)),
    )


def _of_body(p: Parameter, segment: int | None) -> Field:
    unit, factor, decimals = _SHOWN[p.unit]

    def exact(robot: Robot) -> float:
        body = robot.morphology
        part = body if isinstance(body, Morphology) else body[segment or 0]
        return factor * float(getattr(part, p.name))

    def put(robot: Robot, value: float) -> Robot:
        body = robot.morphology
        changed = {p.name: value / factor}
        if isinstance(body, Morphology):
            return replace(robot, morphology=replace(body, **changed))
        parts = [replace(part, **changed) if i == segment else part for i, part in enumerate(body)]
        return replace(robot, morphology=tuple(parts))

    return Field(
        folder="body" if segment is None else f"segment {segment + 1}",
        label=f"{p.name.removesuffix('_' + p.unit).replace('_', ' ')}, {unit}",
        hint=f"{p.description} ({p.symbol} in the paper); another one starts anew",
        lower=round(factor * p.lower, decimals),
        upper=round(factor * p.upper, decimals),
        decimals=decimals,
        exact=exact,
        put=put,
    )


def _of_gait(individual: Robot, index: int, edge: Literal["on", "off"]) -> Field:
    def exact(robot: Robot) -> float:
        return float((robot.timings.on_s if edge == "on" else robot.timings.off_s)[index])

    def put(robot: Robot, value: float) -> Robot:
        on, off = np.array(robot.timings.on_s), np.array(robot.timings.off_s)
        (on if edge == "on" else off)[index] = value
        return replace(robot, timings=GaitTimings(robot.timings.period_s, on, off))

    return Field(
        folder="gait, times in s",
        label=f"{individual.timed[index].replace('_', ' ')} {edge}",
        hint=f"when the power goes {edge}; off before on: powered round the end of the period",
        lower=0.0,
        upper=individual.timings.period_s,
        decimals=2,
        exact=exact,
        put=put,
    )
