"""Robot parameters that the sliders change: friction and genes."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from caterpillar_env.arrays import Array
from caterpillar_env.gait import GaitTimings
from caterpillar_env.morphology import PARAMETERS, Morphology
from caterpillar_env.robot import Robot
from evolution.genome import Encoding, Gene, GenomeKind, Timing

_FRICTION_BOUNDS = (0.05, 1.5)  # plausible values: 0.4 to 1.2 (docs/sources.md)


@dataclass(frozen=True)
class Field:
    """One parameter of a robot, in the unit of its slider."""

    index: int  #: position in the list of fields
    folder: str  #: heading above the slider; empty for no heading
    gene: Gene  #: name, unit and bounds; friction has a gene although it is not evolved
    timing: Timing  #: kind of the gait's fields: on-off or phase

    @property
    def decimals(self) -> int:
        """Number of decimals: 1 for mm, g, ° and %, 2 for s and friction."""
        return 2 if self.gene.shown[0] == 1.0 else 1

    @property
    def bounds(self) -> tuple[float, float]:
        """Minimum and maximum of the slider."""
        return self._round(self.gene.lower), self._round(self.gene.upper)

    def read(self, robot: Robot) -> float:
        """Return the value of the field, rounded to `decimals`."""
        return self._round(read_values(robot, self.timing)[self.index])

    def write(self, robot: Robot, value: float) -> Robot:
        """Return a robot with a new value of the field and without a recorded fitness.

        Values out of bounds are clipped. If the slider already shows the value, return `robot` itself.
        """
        lower, upper = self.bounds
        value = min(upper, max(lower, value))
        if value == self.read(robot):
            return robot
        values = read_values(robot, self.timing)
        # The rounded end of a slider can exceed the bound: 57.3° is more than 1 rad.
        values[self.index] = np.clip(value / self.gene.shown[0], self.gene.lower, self.gene.upper)
        changed = _with_values(robot, values, self.timing)
        # Converting a gait to delays and back would round its times.
        return changed if self.folder == "gait" else replace(changed, timings=robot.timings)

    def _round(self, value: float) -> float:
        return round(float(value) * self.gene.shown[0], self.decimals)


def fields_of(robot: Robot, timing: Timing = "on-off") -> list[Field]:
    """Return all fields of a robot: friction, body parameters and gait.

    Args:
        robot: the robot.
        timing: "on-off" for on and off times, or "phase" for delays and duties.
    """
    kind: GenomeKind = "full" if robot.kind == "springs" else "shared"
    genes = Encoding(robot.physics, robot.timings.period_s, kind, timing).genes
    folders = ["body"]
    if isinstance(robot.morphology, tuple):
        folders = [f"segment {i + 1}" for i in range(len(robot.morphology))]
    rows = [("", Gene("friction", "", "", *_FRICTION_BOUNDS, "friction"))]
    rows += [(folder, gene) for folder in folders for gene in genes[: len(PARAMETERS)]]
    rows += [("gait", gene) for gene in genes[len(PARAMETERS) :]]
    fields = []
    for index, value in enumerate(read_values(robot, timing).tolist()):
        folder, gene = rows[index]
        # A robot may be outside the bounds, with friction 2 for example.
        gene = gene._replace(lower=min(gene.lower, value), upper=max(gene.upper, value))
        fields.append(Field(index, folder, gene, timing))
    return fields


def read_values(robot: Robot, timing: Timing) -> Array:
    """Return the exact values of all fields in SI units, (fields,)."""
    body, gait = robot.morphology, robot.timings
    segments = body if isinstance(body, tuple) else (body,)
    times = gait.times_s
    if timing == "phase":
        times = np.stack(gait.to_phases(springs=robot.kind == "springs"), axis=-1).ravel()
    return np.concatenate([[robot.physics.friction], *(m.to_array() for m in segments), times])


def _with_values(robot: Robot, values: Array, timing: Timing) -> Robot:
    body, size, period_s = robot.morphology, len(PARAMETERS), robot.timings.period_s
    end = 1 + size * (len(body) if isinstance(body, tuple) else 1)
    segments = tuple(map(Morphology.of, values[1:end].reshape(-1, size)))
    first, second = values[end::2], values[end + 1 :: 2]
    if timing == "phase":
        gait = GaitTimings.from_phases(first, second, period_s, springs=robot.kind == "springs")
    else:
        gait = GaitTimings(period_s, first, second)
    physics = replace(robot.physics, friction=float(values[0]))
    return Robot(segments if isinstance(body, tuple) else segments[0], gait, physics)
