"""The task: crawl straight ahead for 30 s without falling, leaping or turning away.

`judge` decides what counts as a failure. `Crawl` advances robots control interval by control interval,
stops those that fail, and measures their progress. Environments and fitness evaluation both use it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from caterpillar_env.arrays import Array, Rows
from caterpillar_env.errors import SimulationError
from caterpillar_env.gait import count_steps
from caterpillar_env.morphology import Body
from caterpillar_env.physics import CONTROL_INTERVAL_S, SMA_STEP_S, Physics
from caterpillar_env.pose import Pose, Trace
from caterpillar_env.randomization import Conditions
from caterpillar_env.simulation import FREE_QPOS, Simulation

#: Saunders 2009, section IV: distance travelled within 30 s of simulated time.
EPISODE_S = 30.0
#: Function to call after each control interval with its trace.
OnInterval = Callable[[Trace], None]
STEPS_PER_INTERVAL = count_steps(CONTROL_INTERVAL_S, SMA_STEP_S, "the control interval")


class Failure(IntEnum):
    """Why a robot was stopped. Names are those of Saunders 2009, section IV, and `DIVERGED`."""

    NONE = 0
    DIVERGED = 1  #: the integration broke down; says nothing about the robot
    FLIPPED = 2  #: on its back
    TIPPED = 3  #: on its side, head or tail
    JUMPED = 4  #: clear of the ground
    VEERED = 5  #: substantially off course
    SAGGED = 6  #: carried by its body instead of its legs

    @property
    def label(self) -> str:
        """Lower-case name, or "ok"."""
        return "ok" if self is Failure.NONE else self.name.lower()


_LEAST_LOAD_N = 1e-6  # below, nothing is carried: the robot is in the air
_NONE, _DIVERGED = int(Failure.NONE), int(Failure.DIVERGED)  # members are slow to look up
_LABELS = {int(failure): failure.label for failure in Failure}


def label(failure: int | np.integer[Any]) -> str:
    """Name of a failure code, "ok" for none."""
    return _LABELS[int(failure)]


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
    sagged_share: float = 0.05  #: sagged when the body carries more of the load, on average


def judge(
    pose: Pose,
    lateral_m: Array,
    heading_rad: Array,
    body_load: Array,
    diverged: NDArray[np.bool_],
    thresholds: Thresholds,
) -> NDArray[np.int8]:
    """The failure of each of R robots, as values of `Failure`, shape (R,).

    Args:
        pose: where the robots are.
        lateral_m: distance of the centre of mass from the starting line, (R,).
        heading_rad: heading relative to the start, (R,).
        body_load: mean share of the load that the body carries, see `Progress`, (R,).
        diverged: whether the integration broke down, (R,).
        thresholds: where a failure begins.
    """
    up = pose.up[:, 2]
    failure = np.zeros(len(up), dtype=np.int8)
    for fails, code in (  # the graver a failure, the later it is written
        (body_load > thresholds.sagged_share, Failure.SAGGED),
        (np.abs(heading_rad) > thresholds.veered_heading_rad, Failure.VEERED),
        (np.abs(lateral_m) > thresholds.veered_lateral_m, Failure.VEERED),
        (pose.clearance_m > thresholds.jumped_clearance_m, Failure.JUMPED),
        (up < thresholds.tipped_up, Failure.TIPPED),
        (up < thresholds.flipped_up, Failure.FLIPPED),
        (diverged, Failure.DIVERGED),
    ):
        failure[fails] = code
    return failure


class Progress(NamedTuple):
    """What R robots have achieved since reset."""

    time_s: Array  #: simulated, (R,)
    distance_m: Array  #: of the centre of mass along the starting heading; backwards is negative
    lateral_m: Array  #: to the left of the starting heading
    heading_rad: Array  #: relative to the start, counter-clockwise, in (-pi, pi]
    energy_j: Array  #: electrical energy drawn
    body_load: Array  #: share of the load on the body, mean over at least `EPISODE_S`
    failure: NDArray[np.int8]  #: values of `Failure`


class Crawl:
    """Robots that crawl, each until it fails; at the start when made.

    Args:
        bodies: one for each robot.
        physics: material, numerics, number of segments.
        threads: see `Simulation`.
        thresholds: where a failure begins.
        stop_on_failure: whether a failed robot stands still from then on. A diverged one always does.

    Attributes:
        simulation: the robots' bodies, springs and motion.
        failure: why each robot was stopped, values of `Failure`, (B,).
    """

    def __init__(
        self,
        bodies: Sequence[Body],
        physics: Physics,
        threads: int = 0,
        *,
        thresholds: Thresholds | None = None,
        stop_on_failure: bool = True,
    ) -> None:
        self.simulation = Simulation(bodies, physics, threads)
        self.physics = physics
        self.thresholds = thresholds or Thresholds()
        self.stop_on_failure = stop_on_failure
        self.failure = np.zeros(len(bodies), dtype=np.int8)
        self._start_m = np.zeros((len(bodies), 2))
        self._direction = np.zeros((len(bodies), 2))  # cosine and sine of the starting heading
        self._measured = np.zeros((len(bodies), 6))  # the first six fields of `Progress`
        self._borne_s = np.zeros(len(bodies))  # time for which the body has carried the robot
        self._start(self.simulation.rows(), 0.0)

    def reset(
        self,
        bodies: Sequence[Body] | None = None,
        rows: Rows | None = None,
        *,
        conditions: Sequence[Conditions] | None = None,
        heading_rad: float = 0.0,
        offset: Array | None = None,
    ) -> None:
        """Put robots back to the start, at rest and cold.

        Args:
            bodies: one for each robot that is reset; the present ones by default.
            rows: which robots; all by default.
            conditions: one for each robot that is reset; those of `physics` by default.
            heading_rad: direction to crawl in, counter-clockwise from world x.
            offset: added to the positions of the internal joints, m or rad, (R, J).
        """
        self.simulation.reset(bodies, rows, conditions=conditions)
        index = self.simulation.rows(rows)
        if heading_rad != 0.0 or offset is not None:
            qpos = np.stack([self.simulation.qpos(row) for row in index])
            if heading_rad != 0.0:
                half = heading_rad / 2
                qpos[:, 3:FREE_QPOS] = [np.cos(half), 0.0, 0.0, np.sin(half)]
            if offset is not None:
                qpos[:, FREE_QPOS:] += offset
            self.simulation.place(qpos, index, standing=offset is not None)
        self._start(index, heading_rad)

    def _start(self, index: Rows, heading_rad: float) -> None:
        self.failure[index] = Failure.NONE
        self._borne_s[index] = 0.0
        pose = self.simulation.pose(index)
        self._start_m[index] = pose.com_m[:, :2]
        self._direction[index] = np.cos(heading_rad), np.sin(heading_rad)
        self._measured[index] = self._measure(index, pose)

    def run(
        self,
        power: Array,
        rows: Rows | None = None,
        on_interval: OnInterval | None = None,
        *,
        intervals: NDArray[np.int64] | None = None,
    ) -> None:
        """Advance robots by whole control intervals; those that fail stop at the end of one.

        Args:
            power: share of the drive power, (R, intervals * STEPS_PER_INTERVAL, num_springs).
            rows: which robots; all by default. One that has failed already stands still.
            on_interval: called with the trace of every interval.
            intervals: maximum number of control intervals of each robot, (R,); no limit by default.

        Raises:
            SimulationError: wrong shape, or not a whole number of control intervals.
        """
        index = self.simulation.rows(rows)
        steps = power.shape[1] if power.ndim == 3 else -1
        if steps < 0 or steps % STEPS_PER_INTERVAL or len(power) != len(index):
            raise SimulationError(
                f"power must have shape ({len(index)}, n * {STEPS_PER_INTERVAL}, "
                f"{self.physics.num_springs}); got {power.shape}"
            )
        count = steps // STEPS_PER_INTERVAL
        limit = np.full(len(index), count) if intervals is None else intervals
        going = (limit > 0) & ~self._stopped(index)
        if not going.all():
            index, power, limit = index[going], power[going], limit[going]
        if not index.size:
            return
        heating = self.simulation.heat(power, index)
        places = np.arange(len(index))
        for number in range(count):
            first = number * STEPS_PER_INTERVAL
            trace = self.simulation.advance(
                heating, places, first, first + STEPS_PER_INTERVAL, trace=on_interval is not None
            )
            moved = index[places]
            self._judge(moved)
            if on_interval is not None and trace is not None:
                on_interval(trace)
            places = places[(limit[places] > number + 1) & ~self._stopped(moved)]
            if not places.size:
                break

    def progress(self, rows: Rows | None = None) -> Progress:
        """What the robots have achieved since reset, measured at the end of their last interval."""
        index = self.simulation.rows(rows)
        time_s, distance_m, lateral_m, heading_rad, energy_j, body_load = self._measured[index].T
        failure = self.failure[index]
        return Progress(time_s, distance_m, lateral_m, heading_rad, energy_j, body_load, failure)

    def _measure(self, index: Rows, pose: Pose) -> Array:
        """The first six fields of `Progress`, (R, 6)."""
        measured = np.empty((len(index), 6))
        both = np.empty((len(index), 2, 2))  # the way and the forward axis, horizontal
        np.subtract(pose.com_m[:, :2], self._start_m[index], out=both[:, 0])
        both[:, 1] = pose.forward[:, :2]
        cosine, sine = self._direction[index].T[..., None]
        x, y = both[..., 0], both[..., 1]
        along, across = x * cosine + y * sine, y * cosine - x * sine
        measured[:, 0] = pose.time_s
        measured[:, 1], measured[:, 2] = along[:, 0], across[:, 0]
        np.arctan2(across[:, 1], along[:, 1], out=measured[:, 3])
        measured[:, 4] = self.simulation.energy_j[index]
        measured[:, 5] = self._borne_s[index] / np.maximum(pose.time_s, EPISODE_S)
        return measured

    def _judge(self, index: Rows) -> None:
        pose = self.simulation.pose(index)
        feet_n, body_n = pose.load_n.T
        share = body_n / np.maximum(feet_n + body_n, _LEAST_LOAD_N)
        self._borne_s[index] += np.maximum(share, 0.0) * CONTROL_INTERVAL_S
        measured = self._measured[index] = self._measure(index, pose)
        _, _, lateral_m, heading_rad, _, body_load = measured.T
        diverged = self.simulation.diverged(index)
        found = judge(pose, lateral_m, heading_rad, body_load, diverged, self.thresholds)
        if found.any():
            # The first failure stays; only a later divergence replaces it.
            keep = (self.failure[index] != _NONE) & (found != _DIVERGED)
            self.failure[index] = np.where(keep, self.failure[index], found)

    def _stopped(self, index: Rows) -> NDArray[np.bool_]:
        code = self.failure[index]
        stopped: NDArray[np.bool_] = code != _NONE if self.stop_on_failure else code == _DIVERGED
        return stopped
