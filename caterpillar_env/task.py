"""The task is to crawl straight ahead for 30 s without falling, jumping or turning away.

`update_failures` detects failures. `Crawl` advances robots by control intervals, stops those that
fail, and measures their progress. The environments and the fitness evaluation both use `Crawl`.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from enum import IntEnum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from caterpillar_env.arrays import Array, Rows, compiled
from caterpillar_env.errors import CaterpillarError
from caterpillar_env.gait import count_steps
from caterpillar_env.morphology import Body
from caterpillar_env.physics import CONTROL_INTERVAL_S, SMA_STEP_S, Physics
from caterpillar_env.pose import Pose, SimulationState, Trace, turn
from caterpillar_env.randomization import Conditions
from caterpillar_env.simulation import FREE_QPOS, Simulation

#: Length of an episode, s. Saunders 2009, section IV, measures the distance travelled within 30 s of
#: simulated time.
EPISODE_S = 30.0
#: Function to call after each control interval with its trace.
OnInterval = Callable[[Trace], None]
STEPS_PER_INTERVAL = count_steps(CONTROL_INTERVAL_S, SMA_STEP_S, "the control interval")


class Failure(IntEnum):
    """Reason for stopping a robot.

    Saunders 2009, section IV, names the failures from `FLIPPED` to `VEERED`. The others are ours.
    """

    NONE = 0
    DIVERGED = 1  #: the integration became unstable; a numerical problem
    FLIPPED = 2  #: on its back
    TIPPED = 3  #: on its side, head or tail
    JUMPED = 4  #: no contact with the ground
    VEERED = 5  #: substantially off course
    SAGGED = 6  #: its elements, instead of its feet, carry too much of the load

    @property
    def label(self) -> str:
        """Lower-case name, or "ok"."""
        return "ok" if self is Failure.NONE else self.name.lower()

    def __str__(self) -> str:
        return self.label


MIN_LOAD_N = 1e-6  #: below this load, the robot is in the air
_NONE, _DIVERGED = int(Failure.NONE), int(Failure.DIVERGED)  # looking up enum members is slow


class FailureLimits(NamedTuple):
    """Limits beyond which robots fail, checked after every control interval.

    The paper names the failures but gives no limits; we chose them. `up` is the vertical component
    of the mean upward axis of the elements (1 upright, 0 on its side, -1 on its back). `heading` is the
    direction of the mean forward axis of the elements.
    """

    flipped_up: float = -0.5  #: FLIPPED if `up` is lower (a straight robot rolled by 120 degrees)
    tipped_up: float = 0.5  #: TIPPED if `up` is lower (a straight robot rolled by 60 degrees)
    jumped_clearance_m: float = 0.005  #: JUMPED if the lowest point is higher
    veered_heading_rad: float = np.pi / 4  #: VEERED if the heading error is larger
    veered_lateral_m: float = 0.12  #: VEERED if the lateral displacement is larger (nominal body length)
    sagged_share: float = 0.05  #: SAGGED if the elements carry a larger mean share of the load


@compiled
def update_failures(
    rows: Rows,
    up: Array,
    clearance_m: Array,
    lateral_m: Array,
    heading_rad: Array,
    body_load: Array,
    diverged: NDArray[np.bool_],
    limits: FailureLimits,
    failure: NDArray[np.int8],
) -> None:
    """Write the failures of R robots into `failure`. Only a divergence replaces an earlier failure.

    Args:
        rows: indices of R of the B robots in the simulation, (R,).
        up: mean upward axis of the elements, (R, 3).
        clearance_m: height of the lowest point above the ground, m, (R,).
        lateral_m: displacement of the centre of mass to the left of the goal heading, m, (R,).
        heading_rad: heading relative to the goal heading, rad, (R,).
        body_load: mean share of the load that the body carries, see `Progress`, (R,).
        diverged: whether the integration became unstable, (R,).
        limits: limits beyond which robots fail.
        failure: failures of all B robots, values of `Failure`, (B,); changed in place.
    """
    for r, row in enumerate(rows):
        if diverged[r]:
            failure[row] = Failure.DIVERGED
        elif failure[row] != Failure.NONE:
            continue
        elif up[r, 2] < limits.flipped_up:
            failure[row] = Failure.FLIPPED
        elif up[r, 2] < limits.tipped_up:
            failure[row] = Failure.TIPPED
        elif clearance_m[r] > limits.jumped_clearance_m:
            failure[row] = Failure.JUMPED
        elif (
            abs(heading_rad[r]) > limits.veered_heading_rad
            or abs(lateral_m[r]) > limits.veered_lateral_m
        ):
            failure[row] = Failure.VEERED
        elif body_load[r] > limits.sagged_share:
            failure[row] = Failure.SAGGED


@compiled
def _add_body_load(rows: Rows, load_n: Array, duration_s: float, body_load_s: Array) -> None:
    """Add the share of the load on the body, times the duration, to `body_load_s`, (B,)."""
    for r, row in enumerate(rows):
        feet_n, body_n = load_n[r]
        share = body_n / np.maximum(feet_n + body_n, MIN_LOAD_N)
        body_load_s[row] += np.maximum(share, 0.0) * duration_s


class Progress(NamedTuple):
    """Progress of R robots since reset."""

    time_s: Array  #: simulated time, (R,)
    distance_m: Array  #: progress of the centre of mass along the goal heading; negative backwards, (R,)
    lateral_m: Array  #: displacement to the left of the goal heading, (R,)
    heading_rad: Array  #: heading relative to the goal, counter-clockwise, in (-pi, pi], (R,)
    energy_j: Array  #: electrical energy used, (R,)
    #: time integral of the share of the load on the elements, divided by max(time, `EPISODE_S`), (R,)
    body_load: Array
    failure: NDArray[np.int8]  #: values of `Failure`, (R,)


class CrawlState(NamedTuple):
    """State of R crawling robots, see `Crawl.get_state`."""

    simulation: SimulationState
    failure: NDArray[np.int8]  #: (R,)
    start_m: Array  #: horizontal position at reset, (R, 2)
    direction: Array  #: cosine and sine of the goal heading, (R, 2)
    #: the first six fields of `Progress`, (R, 6); stored, because `Pose` lags one physics step behind
    measured: Array
    body_load_s: Array  #: integral of the body's share of the load over time, (R,)

    def rows(self, index: Rows) -> CrawlState:
        """Return the states of some of the robots."""
        parts: Any = (self.simulation, self[1:])
        simulation, others = ((field[index] for field in fields) for fields in parts)
        return CrawlState(SimulationState(*simulation), *others)

    @classmethod
    def join(cls, states: Sequence[CrawlState]) -> CrawlState:
        """Join the states of several groups of robots."""
        parts: Any = ([state.simulation for state in states], [state[1:] for state in states])
        simulation, others = (
            (np.concatenate(fields) for fields in zip(*part, strict=True)) for part in parts
        )
        return cls(SimulationState(*simulation), *others)


class Crawl:
    """Simulate crawling robots, each until it fails. They begin in the initial state.

    Args:
        bodies: bodies of B robots.
        physics: material, numerics and number of segments.
        threads: number of threads, see `Simulation`.
        limits: limits beyond which robots fail.
        stop_on_failure: whether a failed robot stops. A diverged robot always stops.

    Attributes:
        simulation: the `Simulation` of the robots.
        failure: failure of each robot, values of `Failure`, (B,).
        direction: cosine and sine of the heading in which distances are measured, (B, 2).
    """

    def __init__(
        self,
        bodies: Sequence[Body],
        physics: Physics,
        threads: int = 0,
        *,
        limits: FailureLimits | None = None,
        stop_on_failure: bool = True,
    ) -> None:
        self.simulation = Simulation(bodies, physics, threads)
        self.physics = physics
        self.limits = limits or FailureLimits()
        self.stop_on_failure = stop_on_failure
        self.failure = np.zeros(len(bodies), dtype=np.int8)
        self._start_m = np.zeros((len(bodies), 2))
        self.direction = np.zeros((len(bodies), 2))
        self._measured = np.zeros((len(bodies), 6))  # the first six fields of `Progress`
        self._body_load_s = np.zeros(len(bodies))  # integral of the body's share of the load over time
        self._start(self.simulation.indices(), 0.0)

    def reset(
        self,
        bodies: Sequence[Body] | None = None,
        rows: Rows | None = None,
        *,
        conditions: Sequence[Conditions | None] | None = None,
        heading_rad: float = 0.0,
        goal_heading_rad: float = 0.0,
        offset: Array | None = None,
    ) -> None:
        """Reset robots to the initial state, at rest and with cold springs.

        Args:
            bodies: new body of each of these robots. By default, bodies do not change.
            rows: indices of the robots to reset, (R,); all by default.
            conditions: conditions of each of these robots; None means those of `physics`.
            heading_rad: direction that the robots face, counter-clockwise from world x, rad.
            goal_heading_rad: direction to crawl in, counter-clockwise from `heading_rad`, rad.
            offset: offset to add to the positions of the internal joints, m or rad, (R, J). The sums are
                clipped to the limits of the joints.
        """
        self.simulation.reset(bodies, rows, conditions=conditions)
        index = self.simulation.indices(rows)
        if heading_rad != 0.0 or offset is not None:
            qpos = np.stack([self.simulation.qpos(row) for row in index])
            if heading_rad != 0.0:
                half = heading_rad / 2
                qpos[:, 3:FREE_QPOS] = [np.cos(half), 0.0, 0.0, np.sin(half)]
            if offset is not None:
                limits = np.array([self.simulation.models[row].jnt_range[1:] for row in index])
                qpos[:, FREE_QPOS:] = np.clip(
                    qpos[:, FREE_QPOS:] + offset, limits[..., 0], limits[..., 1]
                )
            self.simulation.place(qpos, index, standing=offset is not None)
        self._start(index, heading_rad + goal_heading_rad)

    def get_state(self, rows: Rows | None = None) -> CrawlState:
        """Return the state of robots as new arrays, from which their motion can be repeated exactly."""
        index = self.simulation.indices(rows)
        fields = (field[index] for field in self._state_fields())
        return CrawlState(self.simulation.get_state(index), *fields)

    def set_state(self, state: CrawlState, rows: Rows | None = None) -> None:
        """Set the state of robots. Bodies and conditions must be the same as in `get_state`.

        Args:
            state: state of R robots.
            rows: indices of the robots to change, (R,); all by default.
        """
        index = self.simulation.indices(rows)
        self.simulation.set_state(state.simulation, index)
        for field, value in zip(self._state_fields(), state[1:], strict=True):
            field[index] = value

    def _state_fields(self) -> tuple[NDArray[Any], ...]:
        """Return the arrays of `CrawlState` for all rows, without the simulation."""
        return self.failure, self._start_m, self.direction, self._measured, self._body_load_s

    def _start(self, index: Rows, goal_rad: float) -> None:
        self.failure[index] = Failure.NONE
        self._body_load_s[index] = 0.0
        pose = self.simulation.pose(index)
        self._start_m[index] = pose.com_m[:, :2]
        self.direction[index] = np.cos(goal_rad), np.sin(goal_rad)
        self._measured[index] = self._measure(index, pose)

    def run(
        self,
        power: Array,
        rows: Rows | None = None,
        on_interval: OnInterval | None = None,
        *,
        intervals: NDArray[np.int64] | None = None,
    ) -> None:
        """Advance robots by control intervals. A robot that fails stops at the end of the interval.

        Args:
            power: share of the drive power, (R, intervals * STEPS_PER_INTERVAL, num_springs).
            rows: indices of the robots to advance, (R,); all by default. Stopped robots do not move.
            on_interval: function to call with the trace of every interval. Without one, no trace is
                recorded.
            intervals: maximum number of control intervals of each robot, (R,); no limit by default.

        Raises:
            CaterpillarError: `power` has the wrong shape or a wrong number of steps.
        """
        index = self.simulation.indices(rows)
        steps = power.shape[1] if power.ndim == 3 else -1
        if steps < 0 or steps % STEPS_PER_INTERVAL or len(power) != len(index):
            raise CaterpillarError(
                f"power must have shape ({len(index)}, n * {STEPS_PER_INTERVAL}, "
                f"{self.physics.num_springs}) for n control intervals; got {power.shape}"
            )
        count = steps // STEPS_PER_INTERVAL
        limit = np.full(len(index), count) if intervals is None else intervals
        going = (limit > 0) & ~self._stopped(index)
        if not going.all():
            index, power, limit = index[going], power[going], limit[going]
        if not index.size:
            return
        heating = self.simulation.heat(power, index)
        active = np.arange(len(index))
        for number in range(count):
            first = number * STEPS_PER_INTERVAL
            trace = self.simulation.advance(
                heating, active, first, first + STEPS_PER_INTERVAL, trace=on_interval is not None
            )
            moved = index[active]
            self._check_failures(moved)
            if on_interval is not None and trace is not None:
                on_interval(trace)
            active = active[(limit[active] > number + 1) & ~self._stopped(moved)]
            if not active.size:
                break

    def progress(self, rows: Rows | None = None) -> Progress:
        """Return the progress of the robots since reset, as measured after their last interval."""
        index = self.simulation.indices(rows)
        return Progress._make((*self._measured[index].T, self.failure[index]))

    def _measure(self, index: Rows, pose: Pose) -> Array:
        """Return the first six fields of `Progress`, (R, 6)."""
        moved_m = pose.com_m[:, :2] - self._start_m[index]
        forward = turn(index, self.direction, pose.forward)
        measured = np.empty((len(index), 6))
        measured[:, 0] = pose.time_s
        measured[:, 1:3] = turn(index, self.direction, moved_m)
        measured[:, 3] = np.arctan2(forward[:, 1], forward[:, 0])
        measured[:, 4] = self.simulation.energy_j[index]
        measured[:, 5] = self._body_load_s[index] / np.maximum(pose.time_s, EPISODE_S)
        return measured

    def _check_failures(self, index: Rows) -> None:
        pose = self.simulation.pose(index)
        _add_body_load(index, pose.load_n, CONTROL_INTERVAL_S, self._body_load_s)
        measured = self._measured[index] = self._measure(index, pose)
        _, _, lateral_m, heading_rad, _, body_load = measured.T
        diverged = self.simulation.diverged(index)
        update_failures(
            index, pose.up, pose.clearance_m, lateral_m, heading_rad, body_load, diverged,
            self.limits, self.failure,
        )  # fmt: skip

    def _stopped(self, index: Rows) -> NDArray[np.bool_]:
        code = self.failure[index]
        stopped: NDArray[np.bool_] = code != _NONE if self.stop_on_failure else code == _DIVERGED
        return stopped
