"""The task: crawl straight ahead for 30 s without falling, leaping or turning away.

Pure functions say what is seen (`observe`), and what counts as a failure (`judge`); `Crawl` runs robots
interval by interval, stops those that fail, and keeps their account. Environments and fitness
evaluation all go through `Crawl.run`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from caterpillar_env.errors import SimulationError
from caterpillar_env.gait import spring_names, whole
from caterpillar_env.model import CONTROL_INTERVAL_S, SMA_STEP_S, Physics, joint_names
from caterpillar_env.morphology import NAMES, Morphology
from caterpillar_env.simulation import Array, BodyState, Rows, Simulation, Trace

#: Saunders 2009, section IV: distance travelled within 30 s of simulated time.
EPISODE_S = 30.0
STEPS_PER_INTERVAL = whole(CONTROL_INTERVAL_S, SMA_STEP_S, "the control interval")


class Failure(IntEnum):
    """Why a robot was stopped. Names are those of Saunders 2009, section IV, and `DIVERGED`."""

    NONE = 0
    DIVERGED = 1  #: the integration broke down; says nothing about the robot
    FLIPPED = 2  #: on its back
    TIPPED = 3  #: on its side, head or tail
    JUMPED = 4  #: clear of the ground
    VEERED = 5  #: substantially off course

    @property
    def label(self) -> str:
        """Lower-case name, or "ok"."""
        return "ok" if self is Failure.NONE else self.name.lower()


@dataclass(frozen=True)
class Thresholds:
    """Where a failure begins, judged on the whole body every control interval.

    The paper names the failures and not the thresholds; these are ours. `up` is the mean over the
    elements of the vertical part of each one's own upward axis (1 upright, 0 on its side, -1 on its
    back), `heading` that of the mean forward axis.
    """

    flipped_up: float = -0.5  #: flipped below (inclined by more than 120 degrees)
    tipped_up: float = 0.5  #: tipped below (inclined by more than 60 degrees)
    jumped_clearance_m: float = 0.005  #: jumped when the lowest point is above
    veered_heading_rad: float = np.pi / 4  #: veered when the heading is off by more
    veered_lateral_m: float = (
        0.12  #: veered when the centre of mass is off the line by more: a body length
    )


def judge(
    state: BodyState,
    lateral_m: Array,
    heading_rad: Array,
    diverged: NDArray[np.bool_],
    thresholds: Thresholds,
) -> NDArray[np.int8]:
    """The failure of each of R robots, as values of `Failure`, shape (R,).

    Args:
        state: where the robots are.
        lateral_m: distance of the centre of mass from the starting line, (R,).
        heading_rad: heading relative to the start, (R,).
        diverged: whether the integration broke down, (R,).
        thresholds: where a failure begins.
    """
    up = state.up[:, 2]
    veered = (np.abs(heading_rad) > thresholds.veered_heading_rad) | (
        np.abs(lateral_m) > thresholds.veered_lateral_m
    )
    return np.select(
        [
            diverged,
            up < thresholds.flipped_up,
            up < thresholds.tipped_up,
            state.clearance_m > thresholds.jumped_clearance_m,
            veered,
        ],
        [Failure.DIVERGED, Failure.FLIPPED, Failure.TIPPED, Failure.JUMPED, Failure.VEERED],
        Failure.NONE,
    ).astype(np.int8)


class Progress(NamedTuple):
    """What R robots have achieved since reset."""

    time_s: Array  #: simulated, (R,)
    distance_m: Array  #: of the centre of mass along the starting heading; backwards is negative
    lateral_m: Array  #: to the left of the starting heading
    heading_rad: Array  #: relative to the start, counter-clockwise, in (-pi, pi]
    energy_j: Array  #: electrical energy drawn
    failure: NDArray[np.int8]  #: values of `Failure`


class Crawl:
    """Robots that crawl, each until it fails.

    Args:
        num_rows: number of robots.
        physics: material, numerics, number of segments.
        threads: see `Simulation`.
        thresholds: where a failure begins.
        stop_on_failure: whether a failed robot stands still from then on. A diverged one always does.
    """

    def __init__(
        self,
        num_rows: int,
        physics: Physics,
        threads: int = 0,
        *,
        thresholds: Thresholds | None = None,
        stop_on_failure: bool = True,
    ) -> None:
        self.simulation = Simulation(num_rows, physics, threads)
        self.physics = physics
        self.thresholds = thresholds or Thresholds()
        self.stop_on_failure = stop_on_failure
        self.failure = np.zeros(num_rows, dtype=np.int8)
        self._start_m = np.zeros((num_rows, 3))
        self._heading_rad = np.zeros(num_rows)

    def reset(
        self,
        morphologies: Sequence[Morphology],
        rows: Rows | None = None,
        *,
        heading_rad: float = 0.0,
        offset: Array | None = None,
    ) -> None:
        """Put robots at the start; arguments as for `Simulation.reset`."""
        self.simulation.reset(morphologies, rows, heading_rad=heading_rad, offset=offset)
        index = self._rows(rows)
        self.failure[index] = Failure.NONE
        self._start_m[index] = self.simulation.state(index).com_m
        self._heading_rad[index] = heading_rad

    def run(
        self,
        power: Array,
        rows: Rows | None = None,
        on_interval: Callable[[Trace | None], None] | None = None,
        *,
        intervals: NDArray[np.int64] | None = None,
        trace: bool = False,
    ) -> None:
        """Advance robots by whole control intervals; those that fail stop at the end of one.

        Args:
            power: share of the drive power, (R, intervals * STEPS_PER_INTERVAL, num_springs).
            rows: which robots; all by default. One that has failed already stands still.
            on_interval: called after every interval with its trace (None unless `trace`).
            intervals: how many control intervals each goes on for at most, (R,); all by default.
            trace: whether to trace what is needed to draw.

        Raises:
            SimulationError: not a whole number of control intervals, or a wrong shape.
        """
        index = self._rows(rows)
        steps = power.shape[1] if power.ndim == 3 else -1
        if steps < 0 or steps % STEPS_PER_INTERVAL or len(power) != len(index):
            raise SimulationError(
                f"power must have shape ({len(index)}, n * {STEPS_PER_INTERVAL}, "
                f"{self.physics.num_springs}); got {power.shape}"
            )
        going = np.flatnonzero(~self._stopped(index))
        for first in range(0, steps, STEPS_PER_INTERVAL):
            if intervals is not None:
                going = going[intervals[going] > first // STEPS_PER_INTERVAL]
            if not going.size:
                break
            chunk = power[going, first : first + STEPS_PER_INTERVAL]
            traced = self.simulation.advance(chunk, index[going], trace=trace)
            self._judge(index[going])
            if on_interval is not None:
                on_interval(traced)
            going = going[~self._stopped(index[going])]

    def progress(self, rows: Rows | None = None) -> Progress:
        """What the robots have achieved since reset."""
        index = self._rows(rows)
        return self._progress(index, self.simulation.state(index))

    def _progress(self, index: Rows, state: BodyState) -> Progress:
        moved = state.com_m - self._start_m[index]
        cosine, sine = np.cos(self._heading_rad[index]), np.sin(self._heading_rad[index])
        forward_x, forward_y = state.forward[:, 0], state.forward[:, 1]
        return Progress(
            time_s=state.time_s,
            distance_m=moved[:, 0] * cosine + moved[:, 1] * sine,
            lateral_m=moved[:, 1] * cosine - moved[:, 0] * sine,
            heading_rad=np.arctan2(
                forward_y * cosine - forward_x * sine, forward_x * cosine + forward_y * sine
            ),
            energy_j=self.simulation.energy_j[index],
            failure=self.failure[index],
        )

    def _judge(self, index: Rows) -> None:
        state = self.simulation.state(index)
        progress = self._progress(index, state)
        found = judge(
            state,
            progress.lateral_m,
            progress.heading_rad,
            self.simulation.diverged(index),
            self.thresholds,
        )
        # The first failure stays; only a later divergence is told instead.
        keep = (self.failure[index] != Failure.NONE) & (found != Failure.DIVERGED)
        self.failure[index] = np.where(keep, self.failure[index], found)

    def _stopped(self, index: Rows) -> NDArray[np.bool_]:
        code = self.failure[index]
        stopped: NDArray[np.bool_] = (
            code != Failure.NONE if self.stop_on_failure else code == Failure.DIVERGED
        )
        return stopped

    def _rows(self, rows: Rows | None) -> Rows:
        return np.arange(self.simulation.num_rows) if rows is None else rows


def observation_names(physics: Physics, *, clock: bool) -> list[str]:
    """Name of each entry of an observation, in order.

    Args:
        physics: gives the number of segments.
        clock: whether the phase of the gait period is seen; at the end of whole periods it is constant.
    """
    joints = joint_names(physics.num_segments)
    springs = spring_names(physics.num_segments)
    return [
        *(f"position:{j}" for j in joints),
        *(f"velocity:{j}" for j in joints),
        *(f"up:{axis}" for axis in "xyz"),
        "heading:cos",
        "heading:sin",
        "height",
        *(f"linear_velocity:{axis}" for axis in "xyz"),
        *(f"angular_velocity:{axis}" for axis in "xyz"),
        *(f"temperature:{s}" for s in springs),
        *(f"fraction:{s}" for s in springs),
        *(("phase:cos", "phase:sin") if clock else ()),
        *(f"morphology:{n}" for n in NAMES),
    ]


# Scales that bring observations to the order of one.
_AXIAL_SCALE_M = 0.003
_ANGLE_SCALE_RAD = 0.3
_VELOCITY_SCALE_M_S = 0.02
_RATE_SCALE_RAD_S = 1.0
_HEIGHT_SCALE_M = 0.024


def observe(
    crawl: Crawl, rows: Rows | None, morphology: Array, clock_period_s: float | None
) -> NDArray[np.float32]:
    """What robots sense, shape (R, len(observation_names)), float32; see the environment's table.

    Args:
        crawl: the robots.
        rows: which of them.
        morphology: their bodies scaled to [-1, 1], (R, 8).
        clock_period_s: gait period whose phase is seen, s; None leaves it out.
    """
    state = crawl.simulation.state(rows)
    progress = crawl.progress(rows)
    spring = crawl.physics.spring
    axial = np.array([n.startswith("axial") for n in joint_names(crawl.physics.num_segments)])
    cosine, sine = np.cos(progress.heading_rad), np.sin(progress.heading_rad)
    # Horizontal vectors are seen in the frame of the body's own heading.
    heading = np.arctan2(state.forward[:, 1], state.forward[:, 0])
    turn = np.zeros((len(heading), 3, 3))
    turn[:, 0, 0] = turn[:, 1, 1] = np.cos(heading)
    turn[:, 0, 1], turn[:, 1, 0], turn[:, 2, 2] = np.sin(heading), -np.sin(heading), 1.0

    def seen(vector: Array) -> Array:
        turned: Array = np.einsum("rij,rj->ri", turn, vector)
        return turned

    parts = [
        state.joint_position / np.where(axial, _AXIAL_SCALE_M, _ANGLE_SCALE_RAD),
        state.joint_velocity / np.where(axial, _VELOCITY_SCALE_M_S, _RATE_SCALE_RAD_S),
        seen(state.up),
        np.stack([cosine, sine, state.com_m[:, 2] / _HEIGHT_SCALE_M], axis=1),
        seen(state.velocity[:, :3]) / _VELOCITY_SCALE_M_S,
        seen(state.velocity[:, 3:]) / _RATE_SCALE_RAD_S,
        (state.temperature_c - spring.ambient_c) / (spring.cut_off_c - spring.ambient_c),
        state.fraction,
    ]
    if clock_period_s is not None:
        phase = 2 * np.pi * state.time_s / clock_period_s
        parts.append(np.stack([np.cos(phase), np.sin(phase)], axis=1))
    parts.append(morphology)
    observed: NDArray[np.float32] = np.concatenate(parts, axis=1).astype(np.float32)
    return observed
