"""N robots in the reset/step protocol, as arrays: what the single and the vector environment share."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray

from caterpillar_env.arrays import Array, Rows
from caterpillar_env.errors import MorphologyError, SimulationError, TimingError
from caterpillar_env.gait import GAIT_PERIOD_S, GaitTimings, count_steps
from caterpillar_env.model import joint_names
from caterpillar_env.morphology import NAMES, Morphology
from caterpillar_env.observation import observation_names, observe
from caterpillar_env.physics import CONTROL_INTERVAL_S, SMA_STEP_S, Physics
from caterpillar_env.randomization import Randomization
from caterpillar_env.simulation import BodyState, Trace
from caterpillar_env.task import EPISODE_S, STEPS_PER_INTERVAL, Crawl, Failure, Progress, label

#: Bound of every entry of an observation; healthy robots stay around one.
OBSERVATION_LIMIT = 1000.0
#: Reset noise of 1 stands for 1 rad in the hinges and this much in the axial joints.
_AXIAL_NOISE_M_RAD = 0.01


class Step(NamedTuple):
    """What a step gave, one entry per robot; `info` holds arrays by key."""

    observation: NDArray[np.float32]
    reward: Array
    terminated: NDArray[np.bool_]
    truncated: NDArray[np.bool_]
    info: dict[str, NDArray[Any]]


class Episodes:
    """Episodes of N robots; arguments and defaults are documented for `CaterpillarEnv`.

    Raises:
        CaterpillarError: an argument is of the wrong kind or out of range.
    """

    def __init__(
        self,
        bodies: Sequence[Morphology],
        *,
        threads: int,
        action_mode: str = "timing",
        symmetric: bool = True,
        physics: Physics | dict[str, Any] | None = None,
        gait_period_s: float = GAIT_PERIOD_S,
        frame_skip: int = 1,
        episode_s: float = EPISODE_S,
        max_episode_steps: int | None = None,
        forward_reward_weight: float = 100.0,
        ctrl_cost_weight: float = 0.0,
        failure_cost: float = 5.0,
        reset_noise_scale: float = 0.0,
        randomization: Randomization | Mapping[str, Any] | None = None,
        terminate_on_failure: bool = True,
    ) -> None:
        if action_mode not in ("timing", "switch"):
            raise SimulationError(f'action_mode must be "timing" or "switch"; got {action_mode!r}')
        if not isinstance(frame_skip, int) or frame_skip < 1:
            raise SimulationError(
                "frame_skip must be a whole number of control intervals (switch) or gait periods "
                f"(timing), 1 or more; got {frame_skip!r}"
            )
        for name, value in (
            ("forward_reward_weight", forward_reward_weight),
            ("ctrl_cost_weight", ctrl_cost_weight),
            ("failure_cost", failure_cost),
            ("reset_noise_scale", reset_noise_scale),
        ):
            if not (isinstance(value, (int, float, np.number)) and 0 <= value < np.inf):
                raise SimulationError(f"{name} must be finite and not negative; got {value!r}")
        self.physics = Physics.of(physics)
        self.action_mode = action_mode
        self.symmetric = symmetric
        self.gait_period_s = gait_period_s
        self._period_intervals = count_steps(gait_period_s, CONTROL_INTERVAL_S, "gait_period_s")
        self.episode_s = episode_s
        self._episode_intervals = count_steps(episode_s, CONTROL_INTERVAL_S, "episode_s")
        self._frame_skip = frame_skip
        self._step_intervals = frame_skip * (self._period_intervals if action_mode == "timing" else 1)
        if max_episode_steps:
            limit = max_episode_steps * self._step_intervals
            self._episode_intervals = min(self._episode_intervals, limit)
        self._weights = (forward_reward_weight, ctrl_cost_weight, failure_cost)
        self._noise = reset_noise_scale
        self._randomization = Randomization.of(randomization)
        if self._randomization is not None:
            self._randomization.check(self.physics)
        self._terminate = terminate_on_failure
        self._clock_s = gait_period_s if action_mode == "switch" else None
        self.crawl = Crawl(bodies, self.physics, threads, stop_on_failure=terminate_on_failure)
        self._unit = np.zeros((len(bodies), len(NAMES)))
        self._intervals = np.zeros(len(bodies), dtype=np.int64)

        springs = self.physics.num_springs
        self.action_space: spaces.Box | spaces.MultiBinary
        if action_mode == "timing":
            size = springs if symmetric else 2 * springs
            self.action_space = spaces.Box(-1.0, 1.0, (size,), np.float32)
        else:
            self.action_space = spaces.MultiBinary(springs)
        self.observation_names = observation_names(self.physics, clock=self._clock_s is not None)
        self.observation_space = spaces.Box(
            -OBSERVATION_LIMIT, OBSERVATION_LIMIT, (len(self.observation_names),), np.float32
        )

    @property
    def step_s(self) -> float:
        """Simulated length of one environment step, s."""
        return self._step_intervals * CONTROL_INTERVAL_S

    def morphology(self, row: int) -> Morphology:
        """The body of a row."""
        body = self.crawl.simulation.bodies[row]
        assert isinstance(body, Morphology)  # as given; one per segment is for `simulate` only
        return body

    def reset(
        self,
        rows: Rows,
        generators: Sequence[np.random.Generator],
        bodies: Sequence[Morphology] | None = None,
    ) -> tuple[NDArray[np.float32], dict[str, NDArray[Any]]]:
        """Start new episodes in some rows, with a source of noise for each, and new bodies if given."""
        joints = joint_names(self.physics.num_segments)
        scale = np.array([_AXIAL_NOISE_M_RAD if n.startswith("axial") else 1.0 for n in joints])
        drawn = np.array([g.uniform(-1.0, 1.0, len(joints)) for g in generators])
        offset = self._noise * drawn * scale if self._noise else None
        conditions = None
        if self._randomization is not None:
            conditions = [self._randomization.draw(self.physics, g) for g in generators]
        self.crawl.reset(bodies, rows, conditions=conditions, offset=offset)
        self._unit[rows] = [2.0 * self.morphology(row).to_unit() - 1.0 for row in rows]
        self._intervals[rows] = 0
        state, start = self.crawl.simulation.state(rows), self.crawl.progress(rows)
        nothing = np.zeros(len(rows))
        info = _info(state, start, start, nothing, nothing) | self._met(rows)
        return self._observe(rows, state, start), info

    def step(
        self,
        actions: Array,
        rows: Rows,
        on_interval: Callable[[Trace | None], None] | None = None,
        *,
        trace: bool = False,
    ) -> Step:
        """Advance some rows by one environment step; a robot that fails stops within it.

        Args:
            actions: one per row, as `checked` returns them.
            rows: which robots.
            on_interval: see `Crawl.run`.
            trace: likewise.
        """
        power = self._power(actions)
        before = self.crawl.progress(rows)
        # The last gait period of an episode may be a part of one.
        left = np.minimum(self._episode_intervals - self._intervals[rows], self._step_intervals)
        self.crawl.run(power, rows, on_interval, intervals=left, trace=trace)
        self._intervals[rows] += left
        after = self.crawl.progress(rows)

        forward_weight, ctrl_weight, failure_cost = self._weights
        moved = after.distance_m - before.distance_m
        moved[after.failure == Failure.DIVERGED] = 0.0  # wherever it is: that says nothing of it
        new_failure = (after.failure != Failure.NONE) & (before.failure == Failure.NONE)
        forward = forward_weight * moved
        ctrl = -ctrl_weight * (after.energy_j - before.energy_j)
        failed = after.failure != Failure.NONE if self._terminate else after.failure == Failure.DIVERGED
        state = self.crawl.simulation.state(rows)
        info = _info(state, before, after, forward, ctrl)
        info["reward_failure"] = -failure_cost * new_failure
        info |= self._met(rows)
        return Step(
            observation=self._observe(rows, state, after),
            reward=forward + ctrl + info["reward_failure"],
            terminated=failed,
            truncated=~failed & (self._intervals[rows] >= self._episode_intervals),
            info=info,
        )

    def checked(self, actions: Any, count: int) -> Array:
        """The actions of `count` robots as an array.

        Raises:
            TimingError: wrong shape, not finite, or in switch mode not 0 or 1.
        """
        expected = (count, *self.action_space.shape)
        try:
            array = np.asarray(actions, dtype=np.float64)
            got = f"shape {array.shape}"
        except (TypeError, ValueError):
            array, got = np.empty(0), f"no array of numbers: {actions!r}"
        if array.shape != expected:
            raise TimingError(
                f"actions must be numbers of shape {expected[1:]} a robot, {expected} in all; got {got}"
            )
        if not np.isfinite(array).all():
            raise TimingError(f"actions must be finite; got {actions!r}")
        if self.action_mode == "switch" and not ((array == 0) | (array == 1)).all():
            raise TimingError(f"switch actions must be 0 (off) or 1 (on); got {actions!r}")
        return array

    def _power(self, actions: Array) -> Array:
        """Share of the drive power, (R, steps, springs), for the coming environment step."""
        if self.action_mode == "switch":
            return np.repeat(actions[:, None, :], self._step_intervals * STEPS_PER_INTERVAL, axis=1)
        timings = GaitTimings.from_action(actions, self.gait_period_s, mirrored=self.symmetric)
        return np.tile(timings.power(SMA_STEP_S), (1, self._frame_skip, 1))

    def _met(self, rows: Rows) -> dict[str, NDArray[Any]]:
        """What randomised robots meet with, for `info`; nothing where nothing is randomised."""
        met = [c for c in (self.crawl.simulation.conditions[row] for row in rows) if c is not None]
        if not met:
            return {}
        strengths = np.empty(len(met), dtype=object)
        strengths[:] = [c.strengths for c in met]
        return {
            "friction": np.array([c.friction for c in met]),
            "spring_strengths": strengths,
            "mass": np.array([c.mass for c in met]),
            "ambient_c": np.array([c.ambient_c for c in met]),
        }

    def _observe(self, rows: Rows, state: BodyState, progress: Progress) -> NDArray[np.float32]:
        seen = observe(self.physics, state, progress.heading_rad, self._unit[rows], self._clock_s)
        # Only a diverging robot comes near the limit, or is seen as NaN.
        if not (np.abs(seen) < OBSERVATION_LIMIT).all():
            seen = np.clip(np.nan_to_num(seen), -OBSERVATION_LIMIT, OBSERVATION_LIMIT)
        return seen


def _info(
    state: BodyState, before: Progress, now: Progress, forward: Array, ctrl: Array
) -> dict[str, NDArray[Any]]:
    elapsed = np.maximum(now.time_s - before.time_s, CONTROL_INTERVAL_S)
    return {
        "x_position": state.com_m[:, 0],
        "y_position": state.com_m[:, 1],
        "distance": now.distance_m,
        "distance_from_origin": np.hypot(now.distance_m, now.lateral_m),
        "x_velocity": (now.distance_m - before.distance_m) / elapsed,
        "y_velocity": (now.lateral_m - before.lateral_m) / elapsed,
        "reward_forward": forward,
        "reward_ctrl": ctrl,
        "energy_j": now.energy_j,
        "body_load": now.body_load,
        "time_s": now.time_s,
        "failure": np.array([label(f) for f in now.failure], dtype=object),
    }


def morphologies_for(value: Any, num_envs: int) -> list[Morphology]:
    """One body for each of `num_envs` robots from one for all, a sequence of them, or an (N, 8) array.

    Raises:
        MorphologyError: neither, or not as many as robots.
    """
    if not isinstance(value, (Morphology, Mapping, Sequence)):
        value = np.atleast_1d(value)
    if isinstance(value, (Morphology, Mapping)) or (len(value) and np.isscalar(value[0])):
        return [Morphology.of(value)] * num_envs
    if len(value) != num_envs:
        raise MorphologyError(
            f"give one morphology for all, or {num_envs} of them (a list, or an array of shape "
            f"({num_envs}, 8)); got {len(value)}"
        )
    return [Morphology.of(v) for v in value]


def check_options(options: Mapping[str, Any] | None, known: tuple[str, ...]) -> dict[str, Any]:
    """The reset options as a new dict.

    Raises:
        SimulationError: not a mapping, or a key that is not in `known`.
    """
    if options is None:
        return {}
    if not isinstance(options, Mapping) or not set(options) <= set(known):
        got = sorted(map(str, set(options) - set(known))) if isinstance(options, Mapping) else options
        raise SimulationError(f"reset options are {', '.join(known)}; got {got}")
    return dict(options)
