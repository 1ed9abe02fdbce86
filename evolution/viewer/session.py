"""Simulation behind one page. The robot can be changed while it crawls."""

from __future__ import annotations

from caterpillar_env.arrays import Array
from caterpillar_env.gait import count_steps
from caterpillar_env.physics import CONTROL_INTERVAL_S, SMA_STEP_S
from caterpillar_env.pose import Trace
from caterpillar_env.robot import Robot
from caterpillar_env.task import EPISODE_S, STEPS_PER_INTERVAL, Crawl, Failure, Progress

_INTERVALS = count_steps(EPISODE_S, CONTROL_INTERVAL_S, "the episode")


class Session:
    """One robot that crawls for 30 s or until it fails. It can be changed while it crawls.

    An unchanged robot reproduces `Robot.simulate` bit for bit.

    Raises:
        CaterpillarError: the gait period is not a multiple of the control interval, or the number of
            times matches neither the springs nor the mirrored pairs.
    """

    def __init__(self, robot: Robot) -> None:
        self.robot = robot
        self._power = robot.power()
        self.reset()

    def reset(self) -> None:
        """Return the robot to its initial state."""
        self._crawl = Crawl([self.robot.morphology], self.robot.physics, threads=1)
        self._traces: list[Trace] = []  # traces of the last control interval
        self._intervals = 0

    def change(self, robot: Robot) -> bool:
        """Replace the robot, and return whether the simulation was restarted.

        A new body or new physics restarts it; a new gait does not.
        """
        self._power = robot.power()
        old, self.robot = self.robot, robot
        restarted = robot.physics != old.physics or robot.morphology != old.morphology
        if restarted:
            self.reset()
        return restarted

    def advance(self) -> None:
        """Simulate one control interval, unless `finished`."""
        if self.finished:
            return
        first = self._intervals * STEPS_PER_INTERVAL % len(self._power)
        power = self._power[None, first : first + STEPS_PER_INTERVAL]
        self._traces.clear()
        self._crawl.run(power, on_interval=self._traces.append)
        self._intervals += 1

    def pose(self, time_s: float) -> tuple[Array, Array]:
        """Return generalized positions (nq,) and spring temperatures in degC (num_springs,).

        Args:
            time_s: time in the last control interval; other times are clipped to this interval.
        """
        if not self._traces:
            simulation = self._crawl.simulation
            return simulation.qpos(0), simulation.state().temperature_c[0]
        step = round(time_s / SMA_STEP_S) - 1 - (self._intervals - 1) * STEPS_PER_INTERVAL
        step = min(max(step, 0), STEPS_PER_INTERVAL - 1)
        (trace,) = self._traces
        return trace.qpos[0, step], trace.temperature_c[0, step]

    @property
    def progress(self) -> Progress:
        """Progress of the robot since the start, as arrays of shape (1,)."""
        return self._crawl.progress()

    @property
    def time_s(self) -> float:
        """Simulated time since the start."""
        return float(self.progress.time_s[0])

    @property
    def failure(self) -> Failure:
        """Failure that stopped the robot, or `Failure.NONE`."""
        return Failure(int(self.progress.failure[0]))

    @property
    def finished(self) -> bool:
        """Whether the robot has failed or has crawled for 30 s."""
        return self.failure is not Failure.NONE or self._intervals == _INTERVALS
