"""Episodes of N robots as arrays, for the single and the vector environment."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
from gymnasium import spaces
from gymnasium.envs.registration import EnvSpec
from numpy.typing import NDArray

from caterpillar_env.arguments import EpisodeConfig
from caterpillar_env.arrays import Array, Rows
from caterpillar_env.errors import CaterpillarError, show, to_array
from caterpillar_env.gait import MAX_DUTY, GaitTimings, count_steps
from caterpillar_env.model import joint_names
from caterpillar_env.morphology import NAMES, Body, Morphology
from caterpillar_env.observation import observation_names, observe
from caterpillar_env.physics import CONTROL_INTERVAL_S, SMA_STEP_S
from caterpillar_env.pose import BodyState
from caterpillar_env.randomization import Conditions
from caterpillar_env.task import (
    STEPS_PER_INTERVAL,
    Crawl,
    CrawlState,
    Failure,
    OnInterval,
    Progress,
)

#: Observations, rewards, terminations, truncations and info of R robots; `info` maps keys to arrays.
Step = tuple[NDArray[np.float32], Array, NDArray[np.bool_], NDArray[np.bool_], dict[str, NDArray[Any]]]

_NONE, _DIVERGED = int(Failure.NONE), int(Failure.DIVERGED)  # NumPy compares enum members slowly
#: Bound of every entry of an observation. Entries of healthy robots have a magnitude of about one.
OBSERVATION_LIMIT = 1000.0
_REWARDS = ("reward_forward", "reward_ctrl", "reward_failure")  # parts of the reward
#: Maximum displacement of axial joints for a `reset_noise_scale` of 1, m. For hinges, it is 1 rad.
_AXIAL_NOISE_M = 0.01


class EpisodeState(NamedTuple):
    """State of R robots in mid-episode: everything that the rest of the episodes depends on."""

    bodies: tuple[Body, ...]  #: (R,)
    conditions: tuple[Conditions | None, ...]  #: drawn at reset, (R,)
    crawl: CrawlState
    intervals: NDArray[np.int64]  #: control intervals since reset, (R,)
    kept: Array  #: share of the power that each spring keeps after its failure, (R, springs)
    fault_step: NDArray[np.int64]  #: thermal step of the failure, (R,)
    generators: tuple[dict[str, Any] | None, ...]  #: state of each random generator, (R,)

    def rows(self, index: Sequence[int] | Rows) -> EpisodeState:
        """Return the states of some of the robots. An index may occur several times.

        Raises:
            CaterpillarError: an index is not an integer, or out of range.
        """
        chosen = check_rows(index, len(self.bodies))
        bodies, conditions, generators = (
            tuple(values[row] for row in chosen)
            for values in (self.bodies, self.conditions, self.generators)
        )
        return EpisodeState(
            bodies, conditions, self.crawl.rows(chosen), self.intervals[chosen], self.kept[chosen],
            self.fault_step[chosen], generators,
        )  # fmt: skip


class Episodes:
    """Run episodes of N robots.

    Args:
        bodies: body of each robot.
        config: settings of the episodes.
        threads: number of threads, see `Simulation`.
    """

    def __init__(self, bodies: Sequence[Morphology], config: EpisodeConfig, threads: int) -> None:
        self.config, physics = config, config.physics
        self.crawl = Crawl(bodies, physics, threads, stop_on_failure=config.terminate_on_failure)
        periodic = config.action_mode != "switch"
        period = count_steps(config.gait_period_s, CONTROL_INTERVAL_S, "gait_period_s")
        self._step_intervals = config.action_repeat * (period if periodic else 1)
        self.step_s = self._step_intervals * CONTROL_INTERVAL_S
        self._limit = count_steps(config.episode_s, CONTROL_INTERVAL_S, "episode_s")
        if config.max_episode_steps:
            self._limit = min(self._limit, config.max_episode_steps * self._step_intervals)
        # In timing and phase mode, steps always start at phase zero, so the phase is not observed.
        self._clock_s = None if periodic else config.gait_period_s
        self._scaled_bodies = np.zeros((len(bodies), len(NAMES)))  # in [-1, 1], as observed
        self._intervals = np.zeros(len(bodies), dtype=np.int64)  # since reset
        self._kept = np.ones((len(bodies), physics.num_springs))
        self._fault_step = np.zeros(len(bodies), dtype=np.int64)

        self.action_space: spaces.Box | spaces.MultiBinary
        if periodic:
            size = physics.num_springs if config.symmetric else 2 * physics.num_springs
            self.action_space = spaces.Box(-1.0, 1.0, (size,), np.float32)
        else:
            self.action_space = spaces.MultiBinary(physics.num_springs)
        self.observation_names = observation_names(physics, clock=self._clock_s is not None)
        self.observation_space = spaces.Box(
            -OBSERVATION_LIMIT, OBSERVATION_LIMIT, (len(self.observation_names),), np.float32
        )

    @property
    def episode_s(self) -> float:
        """Simulated length of an episode without failure, s."""
        return self._limit * CONTROL_INTERVAL_S

    @property
    def max_steps(self) -> int:
        """Number of steps in an episode without failure."""
        return -(-self._limit // self._step_intervals)

    def morphology(self, row: int) -> Morphology:
        """Return the body of a row."""
        body = self.crawl.simulation.bodies[row]
        assert isinstance(body, Morphology)  # environments take bodies of identical segments only
        return body

    def reset(
        self,
        rows: Rows,
        generators: Sequence[np.random.Generator],
        bodies: Sequence[Morphology] | None = None,
    ) -> tuple[NDArray[np.float32], dict[str, NDArray[Any]]]:
        """Start new episodes.

        Args:
            rows: indices of the robots to reset, (R,).
            generators: random generator of each of these robots.
            bodies: new body of each of these robots. By default, bodies do not change.
        """
        config, physics = self.config, self.config.physics
        joints = joint_names(physics.num_segments)
        noise = np.array([g.uniform(-1.0, 1.0, len(joints)) for g in generators])
        offset = None
        if config.reset_noise_scale:
            scale = [_AXIAL_NOISE_M if name.startswith("axial") else 1.0 for name in joints]
            offset = config.reset_noise_scale * noise * np.array(scale)
        conditions = None
        if config.randomization is not None:
            conditions = [config.randomization.draw(physics, g) for g in generators]
        self._kept[rows] = 1.0
        if config.faults is not None:
            for row, g in zip(rows, generators, strict=True):
                self._kept[row], self._fault_step[row] = config.faults.draw(physics.num_springs, g)
        self.crawl.reset(
            bodies, rows, conditions=conditions, goal_heading_rad=config.goal_heading_rad, offset=offset
        )
        self._scale_bodies(rows)
        self._intervals[rows] = 0
        state, start = self.crawl.simulation.state(rows), self.crawl.progress(rows)
        rewards = {name: np.zeros(len(rows)) for name in _REWARDS}
        info = self._info(rows, state, start, start, rewards)
        return self._observe(rows, state, start), info

    def get_state(self, rows: Rows, generators: Sequence[np.random.Generator | None]) -> EpisodeState:
        """Return the state of robots. For the arguments, see `reset`."""
        simulation = self.crawl.simulation
        return EpisodeState(
            tuple(simulation.bodies[row] for row in rows),
            tuple(simulation.conditions[row] for row in rows),
            self.crawl.get_state(rows),
            self._intervals[rows],
            self._kept[rows],
            self._fault_step[rows],
            tuple(None if g is None else dict(g.bit_generator.state) for g in generators),
        )

    def set_state(self, state: EpisodeState, rows: Rows) -> NDArray[np.float32]:
        """Set the state of robots, except their generators, and return their observations.

        Raises:
            CaterpillarError: the number of robots or of segments is wrong.
        """
        expected = (len(rows), self.config.physics.num_springs)
        given = state.crawl.simulation.fraction.shape
        if given != expected:
            raise CaterpillarError(
                f"the state must have {expected[0]} robots with {expected[1]} springs each; got "
                f"the shape {given} (robots, springs)"
            )
        self.crawl.reset(state.bodies, rows, conditions=state.conditions)
        self.crawl.set_state(state.crawl, rows)
        self._scale_bodies(rows)
        self._intervals[rows] = state.intervals
        self._kept[rows], self._fault_step[rows] = state.kept, state.fault_step
        return self._observe(rows, self.crawl.simulation.state(rows), self.crawl.progress(rows))

    def find_ended(self, state: EpisodeState) -> NDArray[np.bool_]:
        """Return whether the episodes in a state have been terminated or truncated, (R,)."""
        failure = state.crawl.failure
        failed = failure != _NONE if self.config.terminate_on_failure else failure == _DIVERGED
        ended: NDArray[np.bool_] = failed | (state.intervals >= self._limit)
        return ended

    def _scale_bodies(self, rows: Rows) -> None:
        self._scaled_bodies[rows] = [2.0 * self.morphology(row).to_unit() - 1.0 for row in rows]

    def step(
        self,
        actions: Array,
        rows: Rows,
        on_interval: OnInterval | None = None,
    ) -> Step:
        """Advance robots by one environment step. A robot that fails stops within the step.

        Args:
            actions: action of each robot, as returned by `check_actions`.
            rows: indices of the robots to advance, (R,).
            on_interval: see `Crawl.run`.
        """
        config, before = self.config, self.crawl.progress(rows)
        # The last gait period of an episode may be cut short.
        left = np.minimum(self._limit - self._intervals[rows], self._step_intervals)
        power = self._power(actions)
        if (self._kept[rows] != 1.0).any():
            number = self._intervals[rows, None] * STEPS_PER_INTERVAL + np.arange(power.shape[1])
            broken = number >= self._fault_step[rows, None]
            power = power * np.where(broken[..., None], self._kept[rows, None], 1.0)
        self.crawl.run(power, rows, on_interval, intervals=left)
        self._intervals[rows] += left
        after = self.crawl.progress(rows)

        moved_m = after.distance_m - before.distance_m
        diverged, failed = after.failure == _DIVERGED, after.failure != _NONE
        moved_m[diverged] = 0.0  # positions after a divergence are meaningless
        forward = config.forward_reward_weight * moved_m
        ctrl = -config.ctrl_cost_weight * (after.energy_j - before.energy_j)
        failure = -config.failure_cost * (failed & (before.failure == _NONE))
        terminated = failed if config.terminate_on_failure else diverged
        state = self.crawl.simulation.state(rows)
        truncated = ~terminated & (self._intervals[rows] >= self._limit)
        rewards = dict(zip(_REWARDS, (forward, ctrl, failure), strict=True))
        info = self._info(rows, state, before, after, rewards)
        return self._observe(rows, state, after), forward + ctrl + failure, terminated, truncated, info

    def _info(
        self,
        rows: Rows,
        state: BodyState,
        before: Progress,
        now: Progress,
        rewards: dict[str, Array],
    ) -> dict[str, NDArray[Any]]:
        """Return the info of robots that moved from `before` to `now` with these rewards."""
        elapsed_s = np.maximum(now.time_s - before.time_s, CONTROL_INTERVAL_S)
        along_m_s = (now.distance_m - before.distance_m) / elapsed_s
        across_m_s = (now.lateral_m - before.lateral_m) / elapsed_s
        cos, sin = self.crawl.direction[rows].T
        info = {
            "x_position": state.com_m[:, 0],
            "y_position": state.com_m[:, 1],
            "distance": now.distance_m,
            "distance_from_origin": np.hypot(now.distance_m, now.lateral_m),
            "x_velocity": cos * along_m_s - sin * across_m_s,
            "y_velocity": sin * along_m_s + cos * across_m_s,
            **rewards,
            "energy_j": now.energy_j,
            "body_load": now.body_load,
            "time_s": now.time_s,
            "failure": now.failure,
        }
        if self.config.faults is not None:
            broken = self._intervals[rows] * STEPS_PER_INTERVAL >= self._fault_step[rows]
            info["spring_power"] = np.where(broken[:, None], self._kept[rows], 1.0)
        return info

    def check_actions(self, actions: Any, count: int | None = None) -> Array:
        """Return the actions of `count` robots, or the action of a single robot, as an array.

        Raises:
            CaterpillarError: the shape is wrong, a value is not finite, or a switch value is not 0 or 1.
        """
        one = self.action_space.shape or ()
        expected, name = (one, "the action") if count is None else ((count, *one), "the actions")
        array = to_array(actions)
        if array is None or array.shape != expected:
            got = show(actions) if array is None else f"shape {array.shape}"
            raise CaterpillarError(f"{name} must be numbers of shape {expected}; got {got}")
        switch = self.config.action_mode == "switch"
        if switch and ((array == 0) | (array == 1)).all():
            return array
        if not np.isfinite(array).all():
            raise CaterpillarError(f"{name} must be finite; got {actions!r}")
        if switch:
            raise CaterpillarError(f"switch actions must be 0 (off) or 1 (on); got {actions!r}")
        return array

    def _power(self, actions: Array) -> Array:
        """Return the share of the drive power in the next environment step, (R, steps, springs)."""
        if self.config.action_mode == "switch":
            return np.repeat(actions[:, None], self._step_intervals * STEPS_PER_INTERVAL, axis=1)
        timings = self._timings(actions)
        power = timings.of_springs(self.config.physics.num_springs).power(SMA_STEP_S)
        return np.tile(power, (1, self.config.action_repeat, 1))

    def _timings(self, actions: Array) -> GaitTimings:
        """Return the gaits of timing or phase actions."""
        config = self.config
        if config.action_mode == "timing":
            return GaitTimings.from_action(actions, config.gait_period_s)
        shares = np.clip((actions + 1.0) / 2.0, 0.0, 1.0)
        return GaitTimings.from_phases(
            shares[:, 0::2], MAX_DUTY * shares[:, 1::2], config.gait_period_s,
            springs=not config.symmetric,
        )  # fmt: skip

    def _observe(self, rows: Rows, state: BodyState, progress: Progress) -> NDArray[np.float32]:
        seen = observe(
            self.config.physics, state, progress.heading_rad, self._scaled_bodies[rows], self._clock_s
        )
        # Only a diverging robot reaches the limit or has NaN.
        if not (np.abs(seen) < OBSERVATION_LIMIT).all():
            seen = np.clip(np.nan_to_num(seen), -OBSERVATION_LIMIT, OBSERVATION_LIMIT)
        return seen


class WithSpec:
    """Mixin of both environments: `config`, and a `spec` with the number of steps in an episode."""

    _episodes: Episodes
    _spec: EnvSpec | None = None
    _has_time_limit = True  #: whether Gymnasium truncates episodes after the number of steps in the spec

    @property
    def config(self) -> EpisodeConfig:
        """Settings of the episodes."""
        return self._episodes.config

    @property
    def spec(self) -> EnvSpec | None:
        """Specification of the environment, with `max_episode_steps`."""
        return self._spec

    @spec.setter
    def spec(self, spec: EnvSpec | None) -> None:
        if spec is not None and (spec.max_episode_steps is None or not self._has_time_limit):
            spec = replace(spec, max_episode_steps=self._episodes.max_steps)
        self._spec = spec


def check_rows(rows: Any, count: int) -> Rows:
    """Return indices of robots as an array, (R,).

    Raises:
        CaterpillarError: an index is not an integer from 0 to `count - 1`.
    """
    array = to_array(rows)
    index = np.empty(0, dtype=np.int64) if array is None else np.asarray(rows)
    if not index.size or index.ndim != 1 or index.dtype.kind not in "iu":
        raise CaterpillarError(f"rows must be a list of indices; got {show(rows)}")
    if ((index < 0) | (index >= count)).any():
        raise CaterpillarError(f"rows must be indices from 0 to {count - 1}; got {show(rows)}")
    return index.astype(np.int64)


def make_generator(state: dict[str, Any] | None) -> np.random.Generator | None:
    """Create a random generator from an entry of `EpisodeState.generators`; None stays None."""
    if state is None:
        return None
    generator = np.random.Generator(getattr(np.random, state["bit_generator"])())
    generator.bit_generator.state = state
    return generator
