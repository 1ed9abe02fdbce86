"""The simulation behind one page: a robot that crawls and can be changed meanwhile."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from caterpillar_env.arrays import Array
from caterpillar_env.gait import GaitTimings, count_steps
from caterpillar_env.morphology import Morphology
from caterpillar_env.physics import CONTROL_INTERVAL_S, SMA_STEP_S, Physics
from caterpillar_env.pose import Trace
from caterpillar_env.robot import Outcomes, Robot
from caterpillar_env.task import EPISODE_S, STEPS_PER_INTERVAL, Crawl, Failure, Progress

_INTERVALS = count_steps(EPISODE_S, CONTROL_INTERVAL_S, "the episode")


def nominal_robot() -> Robot:
    """The nominal body with a gait that crawls.

    The gait is a wave from the tail: each pair is heated for 1 s, ventral pairs half a period after
    dorsal ones.
    """
    on_s, off_s = (0.0, 2.5, 3.3, 0.8, 1.7, 4.2), (1.0, 3.5, 4.3, 1.8, 2.7, 0.2)
    return Robot(Morphology(), GaitTimings(5.0, np.array(on_s), np.array(off_s)), Physics())


class Measurements(NamedTuple):
    """Measurements at the start and at the end of each of N control intervals."""

    time_s: Array  #: since the start, (N + 1,)
    distance_m: Array  #: of the centre of mass along the starting heading, (N + 1,)
    temperature_c: Array  #: of the n mirrored pairs or springs that the gait times, (N + 1, n)
    fraction: Array  #: austenite fraction of the same, (N + 1, n)


class Session:
    """One robot that crawls for 30 s, or until it fails. It can be changed on the way.

    A robot that is not changed repeats `Robot.simulate` bit for bit.

    Args:
        robot: the robot.

    Attributes:
        robot: the present robot.

    Raises:
        TimingError: the gait period is not a multiple of the control interval, or the number of times
            is neither that of the springs nor that of the mirrored pairs.
    """

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self._power = _power(robot)
        self.reset()

    def reset(self) -> None:
        """Put the robot at the start."""
        self._crawl = Crawl([self.robot.morphology], self.robot.physics, threads=1)
        self._trace: Trace | None = None  # of the last control interval
        self._gait_changed = False
        self._measured: list[tuple[float, float, Array, Array]] = []
        self._measure()

    def change(self, robot: Robot) -> bool:
        """Replace the robot. A new body or physics restarts it; a new gait alone does not.

        Returns:
            Whether the robot was restarted.

        Raises:
            TimingError: see the class; the session keeps its robot.
        """
        self._power = _power(robot)
        old, self.robot = self.robot, robot
        if robot.physics != old.physics or robot.morphology != old.morphology:
            self.reset()
            return True
        self._gait_changed |= self._intervals > 0
        return False

    def advance(self) -> None:
        """Simulate one control interval, unless `finished`."""
        if self.finished:
            return
        traces: list[Trace] = []
        first = self._intervals * STEPS_PER_INTERVAL % len(self._power)
        power = self._power[None, first : first + STEPS_PER_INTERVAL]
        self._crawl.run(power, on_interval=traces.append)
        self._trace = traces[-1]
        self._measure()

    def pose(self, time_s: float) -> tuple[Array, Array]:
        """Generalised positions (nq,) and the springs' temperatures in °C (num_springs,).

        Args:
            time_s: a time in the last control interval; other times are clipped to it.
        """
        if self._trace is None:
            simulation = self._crawl.simulation
            return simulation.qpos(0), simulation.state().temperature_c[0]
        step = round(time_s / SMA_STEP_S) - 1 - (self._intervals - 1) * STEPS_PER_INTERVAL
        step = min(max(step, 0), STEPS_PER_INTERVAL - 1)
        return self._trace.qpos[0, step], self._trace.temperature_c[0, step]

    def measurements(self) -> Measurements:
        """All measurements since the start."""
        return Measurements(*(np.array(column) for column in zip(*self._measured, strict=True)))

    @property
    def progress(self) -> Progress:
        """The robot's progress since the start, as arrays of shape (1,)."""
        return self._crawl.progress()

    @property
    def time_s(self) -> float:
        """Simulated time since the start."""
        return float(self.progress.time_s[0])

    @property
    def failure(self) -> Failure:
        """Why the robot was stopped; `Failure.NONE` if it was not."""
        return Failure(int(self.progress.failure[0]))

    @property
    def finished(self) -> bool:
        """Whether the robot has failed or the 30 s are over."""
        return self.failure is not Failure.NONE or self._intervals == _INTERVALS

    def result(self) -> Robot:
        """The robot, with its fitness if it is finished and was not changed on the way."""
        if not self.finished or self._gait_changed:
            return self.robot
        return replace(self.robot, fitness_m=float(Outcomes.of(self.progress).fitness()[0]))

    @property
    def _intervals(self) -> int:
        return len(self._measured) - 1

    def _measure(self) -> None:
        state, progress = self._crawl.simulation.state(), self.progress
        # The springs of a pair have one temperature, so the left one stands for both.
        stride = self.robot.physics.num_springs // len(self.robot.timed)
        temperature_c, fraction = state.temperature_c[0, ::stride], state.fraction[0, ::stride]
        self._measured.append(
            (float(state.time_s[0]), float(progress.distance_m[0]), temperature_c, fraction)
        )


def _power(robot: Robot) -> Array:
    """Share of the drive power over one gait period, (steps, num_springs)."""
    timings = robot.timings
    count_steps(timings.period_s, CONTROL_INTERVAL_S, "the gait period")
    return timings.of_springs(robot.physics.num_springs).power(SMA_STEP_S)
