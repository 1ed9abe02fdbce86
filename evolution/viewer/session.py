"""The robot of one page: what it is, and what has become of it since it was put at the start."""

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

#: A wave from the tail, ventral pairs half a period after dorsal ones; each is heated for 1 s.
_ON_S = (0.0, 2.5, 3.3, 0.8, 1.7, 4.2)
_OFF_S = (1.0, 3.5, 4.3, 1.8, 2.7, 0.2)
_INTERVALS = count_steps(EPISODE_S, CONTROL_INTERVAL_S, "the episode")


def nominal_robot() -> Robot:
    """The robot to begin with: the nominal body, with a gait that crawls."""
    return Robot(Morphology(), GaitTimings(5.0, np.array(_ON_S), np.array(_OFF_S)), Physics())


class History(NamedTuple):
    """What was measured at the start and at the end of each of N control intervals."""

    time_s: Array  #: since the start, (N + 1,)
    distance_m: Array  #: of the centre of mass, forwards, (N + 1,)
    temperature_c: Array  #: of what the gait times, mirrored pairs or springs, (N + 1, n)
    fraction: Array  #: austenite fraction, likewise


class Session:
    """One robot that crawls for 30 s, or until it fails, and that can be changed meanwhile.

    Without changes it repeats `Robot.simulate` bit for bit.

    Args:
        individual: the robot.

    Raises:
        TimingError: its gait period is not a whole number of control intervals, or its times are neither
            those of its springs nor of its mirrored pairs.
    """

    def __init__(self, individual: Robot) -> None:
        self.individual = individual
        self._power = _power(individual)
        self._crawl = Crawl([individual.morphology], individual.physics, threads=1)
        self.reset()

    def reset(self) -> None:
        """Put the robot at the start."""
        self._crawl.reset([self.individual.morphology])
        self._trace: Trace | None = None
        self._changed_on_the_way = False
        self._count = 0
        shape = (_INTERVALS + 1, len(self.individual.timed))
        self._history = History(
            np.zeros(_INTERVALS + 1), np.zeros(_INTERVALS + 1), np.zeros(shape), np.zeros(shape)
        )
        self._record()

    def change(self, individual: Robot) -> bool:
        """Take another body, gait or physics.

        Returns:
            Whether the robot was put at the start; another gait alone goes on from where it is.

        Raises:
            TimingError: as for the class; the robot is then as before.
        """
        old = self.individual
        self._power = _power(individual)
        self.individual = individual
        if individual.physics != old.physics:
            self._crawl = Crawl([individual.morphology], individual.physics, threads=1)
        elif individual.morphology == old.morphology:
            self._changed_on_the_way |= self._count > 0
            return False
        self.reset()
        return True

    def advance(self) -> None:
        """Crawl for one control interval; nothing when it is `over`."""
        if self.over:
            return
        first = self._count * STEPS_PER_INTERVAL % len(self._power)
        part = self._power[None, first : first + STEPS_PER_INTERVAL]
        self._crawl.run(part, on_interval=self._keep)
        self._count += 1
        self._record()

    def pose(self, time_s: float) -> tuple[Array, Array]:
        """Generalised positions (nq,) and the springs' temperatures in degC (num_springs,).

        Args:
            time_s: a time within the last control interval; otherwise the nearest one.
        """
        if self._trace is None:
            simulation = self._crawl.simulation
            return simulation.qpos(0), simulation.state().temperature_c[0]
        steps = self._trace.qpos.shape[1]
        number = round(time_s / SMA_STEP_S) - (self._count - 1) * STEPS_PER_INTERVAL - 1
        number = min(max(number, 0), steps - 1)
        return self._trace.qpos[0, number], self._trace.temperature_c[0, number]

    @property
    def history(self) -> History:
        """What was measured since the start."""
        end = self._count + 1
        return History(*(values[:end] for values in self._history))

    @property
    def progress(self) -> Progress:
        """What the robot has achieved, arrays of shape (1,)."""
        return self._crawl.progress()

    @property
    def time_s(self) -> float:
        """Simulated since the start."""
        return float(self.progress.time_s[0])

    @property
    def failure(self) -> Failure:
        """Why the robot was stopped, if it was."""
        return Failure(int(self.progress.failure[0]))

    @property
    def over(self) -> bool:
        """Whether the robot has failed or its time is up."""
        return self.failure is not Failure.NONE or self._count == _INTERVALS

    def to_save(self) -> Robot:
        """The robot; with its fitness where it has crawled to the end unchanged."""
        if not self.over or self._changed_on_the_way:
            return self.individual
        return replace(self.individual, fitness_m=float(Outcomes.of(self.progress).fitness()[0]))

    def _keep(self, trace: Trace) -> None:
        self._trace = trace

    def _record(self) -> None:
        state = self._crawl.simulation.state()
        # A pair's springs are heated alike, so its left one tells of both.
        stride = self.individual.physics.num_springs // self._history.fraction.shape[1]
        row = self._count
        self._history.time_s[row] = state.time_s[0]
        self._history.distance_m[row] = self.progress.distance_m[0]
        self._history.temperature_c[row] = state.temperature_c[0, ::stride]
        self._history.fraction[row] = state.fraction[0, ::stride]


def _power(individual: Robot) -> Array:
    """Share of the drive power over one period, (steps, num_springs)."""
    timings = individual.timings
    count_steps(timings.period_s, CONTROL_INTERVAL_S, "the gait period")
    return timings.of_springs(individual.physics.num_springs).power(SMA_STEP_S)
