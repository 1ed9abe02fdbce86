"""The native vector environment. It steps N robots, each with its own body, in one batch."""

from __future__ import annotations

import copy
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from gymnasium.utils import EzPickle
from gymnasium.utils.seeding import np_random
from gymnasium.vector import AutoresetMode, VectorEnv
from gymnasium.vector.utils import batch_space
from numpy.typing import NDArray

from caterpillar_env.arguments import (
    ActionMode,
    EpisodeConfig,
    check_options,
    check_render_mode,
    read_morphologies,
)
from caterpillar_env.arrays import Array, Rows
from caterpillar_env.drawing.rendering import Pictures, View
from caterpillar_env.drawing.scenery import Camera
from caterpillar_env.env import CaterpillarEnv, warn_of_no_render_mode
from caterpillar_env.episodes import Episodes, EpisodeState, WithSpec, check_rows, make_generator
from caterpillar_env.errors import CaterpillarError, check_number, show
from caterpillar_env.faults import Faults
from caterpillar_env.gait import GAIT_PERIOD_S
from caterpillar_env.morphology import Morphology
from caterpillar_env.physics import Physics
from caterpillar_env.randomization import Randomization
from caterpillar_env.task import EPISODE_S, OnInterval
from caterpillar_env.worlds import World

_SPACES = ("single_action_space", "single_observation_space", "action_space", "observation_space")


class CaterpillarVectorEnv(
    WithSpec, VectorEnv[NDArray[np.float32], NDArray[Any], NDArray[Any]], EzPickle
):
    """`num_envs` robots stepped together; row i equals a `CaterpillarEnv` reset with seed + i.

    `reset` has the options `morphology`, see below, and `reset_mask`, a bool array of shape (num_envs,).
    In SAME_STEP mode, the last observation and info of an episode are in `final_obs` and `final_info`.
    For arguments that are not listed here, see `CaterpillarEnv`.

    Args:
        num_envs: number of robots.
        morphology: one body for all robots (as for `CaterpillarEnv`), a list of `num_envs` bodies, or an
            array of shape (num_envs, 8).
        max_episode_steps: maximum number of steps in an episode, in addition to the limit `episode_s`;
            -1 or None for no other limit.
        threads: number of threads; 0 means all usable cores. The results do not depend on it.
        autoreset_mode: when to reset a robot whose episode has ended, see Gymnasium.
        render_mode: None or "rgb_array" (one frame per robot).

    Attributes:
        step_s: simulated length of an environment step, s.
        episode_s: simulated length of an episode without failure, s.
        observation_names: name of every entry of an observation, in order.
        config: settings of the episodes.
        crawl: the simulated robots: `crawl.progress()`, `crawl.simulation.state()` and so on.
        on_interval: function to call with the `Trace` of every control interval, or None. A trace has
            only the rows that moved in this interval.

    Raises:
        CaterpillarError: an argument has the wrong type or is out of range.
    """

    metadata: dict[str, Any] = {**CaterpillarEnv.metadata}  # noqa: RUF012
    _has_time_limit = False

    def __init__(
        self,
        num_envs: int = 1,
        morphology: Any = None,
        *,
        physics: Physics | Mapping[str, Any] | None = None,
        world: World | Mapping[str, Any] | str | None = None,
        action_mode: ActionMode = "timing",
        symmetric: bool = True,
        gait_period_s: float = GAIT_PERIOD_S,
        action_repeat: int = 1,
        episode_s: float = EPISODE_S,
        max_episode_steps: int | None = None,
        forward_reward_weight: float = 100.0,
        ctrl_cost_weight: float = 0.0,
        failure_cost: float = 5.0,
        reset_noise_scale: float = 0.0,
        goal_heading_rad: float = 0.0,
        randomization: Randomization | Mapping[str, Any] | None = None,
        faults: Faults | Mapping[str, Any] | int | None = None,
        terminate_on_failure: bool = True,
        threads: int = 0,
        autoreset_mode: AutoresetMode | str = AutoresetMode.NEXT_STEP,
        render_mode: str | None = None,
        width: int = 640,
        height: int = 480,
        camera_name: Camera = "track",
    ) -> None:
        arguments = {k: v for k, v in locals().items() if k not in ("self", "__class__")}
        EzPickle.__init__(self, **arguments)
        if isinstance(max_episode_steps, int) and max_episode_steps == -1:  # as in `gymnasium.make`
            arguments["max_episode_steps"] = None
        config = EpisodeConfig.of(arguments)
        check_render_mode(render_mode)
        bodies = read_morphologies({} if morphology is None else morphology, num_envs)
        self.num_envs = num_envs
        self._mode = _read_mode(autoreset_mode)
        self._episodes = Episodes(bodies, config, threads)
        self.crawl = self._episodes.crawl
        self.step_s, self.episode_s = self._episodes.step_s, self._episodes.episode_s
        self.observation_names = self._episodes.observation_names
        self.on_interval: OnInterval | None = None
        self.single_action_space = self._episodes.action_space
        self.single_observation_space = self._episodes.observation_space
        self.action_space = batch_space(self.single_action_space, num_envs)
        self.observation_space = batch_space(self.single_observation_space, num_envs)
        self.metadata = self.metadata | {"autoreset_mode": self._mode, "render_fps": 1 / self.step_s}
        self.render_mode = render_mode
        self._pictures = Pictures(self.crawl, View(width, height, camera_name))
        self._generators: list[np.random.Generator] = []
        self._seeds: list[int] = []
        self._running = False
        self._done = np.zeros(num_envs, dtype=bool)
        self._observations = np.zeros(self.observation_space.shape or (), dtype=np.float32)

    def get_state(self, rows: Sequence[int] | Rows | None = None) -> EpisodeState:
        """Return everything that the rest of the episodes depends on, for `set_state`.

        Args:
            rows: indices of the robots, (R,); all by default.

        Raises:
            CaterpillarError: `reset` has not been called yet, or an index is invalid.
        """
        if not self._running:
            raise CaterpillarError("call reset() before get_state()")
        index = check_rows(range(self.num_envs) if rows is None else rows, self.num_envs)
        return self._episodes.get_state(index, [self._generators[row] for row in index])

    def set_state(self, state: EpisodeState, rows: Sequence[int] | Rows | None = None) -> None:
        """Continue robots from a state, which may come from other rows or from a `CaterpillarEnv`.

        Args:
            state: state of R robots. `state.rows([0] * 64)` repeats the first robot 64 times.
            rows: different indices of the robots to change, (R,); all by default.

        Raises:
            CaterpillarError: the state has another number of robots or segments, an index is invalid,
                some rows have neither been reset nor get a state, or an episode has ended in SAME_STEP
                mode, in which only running episodes have a state. No robot changes.
        """
        index = check_rows(range(self.num_envs) if rows is None else rows, self.num_envs)
        if len(np.unique(index)) < len(index):
            raise CaterpillarError(f"rows must not repeat an index; got {show(rows)}")
        if not self._running and len(index) < self.num_envs:
            raise CaterpillarError("call reset() before set_state(), or set the state of all rows")
        if len(state.bodies) == len(index):  # otherwise, `Episodes.set_state` raises an error
            order = np.argsort(index)  # MuJoCo needs ascending rows
            index, state = index[order], state.rows(order)
        ended = self._episodes.find_ended(state)
        if self._mode is AutoresetMode.SAME_STEP and ended.any():
            raise CaterpillarError(
                f"the episodes of rows {index[ended].tolist()} have ended in this state; in SAME_STEP "
                "mode, reset these rows instead"
            )
        self._observations[index] = self._episodes.set_state(state, index)
        self._make_generators([None] * self.num_envs)
        for row, known in zip(index, state.generators, strict=True):
            if (generator := make_generator(known)) is not None:
                self._generators[row], self._seeds[row] = generator, -1
        self._done[index] = ended
        self._running = True

    @property  # type: ignore[misc]
    def np_random(self) -> tuple[np.random.Generator, ...]:  # type: ignore[override]
        """Random generator of each row, as in `SyncVectorEnv`."""
        self._make_generators([None] * self.num_envs)
        return tuple(self._generators)

    @property
    def np_random_seed(self) -> tuple[int, ...]:  # type: ignore[override]
        """Seed of each row, or -1 if it is not known because `set_state` changed the generator."""
        self._make_generators([None] * self.num_envs)
        return tuple(self._seeds)

    def _make_generators(self, seeds: Sequence[int | None]) -> None:
        """Make the generators, unless they exist already."""
        if not self._generators:
            made = [np_random(seed) for seed in seeds]
            self._generators, self._seeds = [g for g, _ in made], [seed for _, seed in made]

    def __getstate__(self) -> dict[str, Any]:
        """Return the arguments and the state, for `copy.deepcopy` and pickle."""
        state = (self.get_state(), self._observations) if self._running else None
        random = copy.deepcopy((self._generators, self._seeds))
        spaces = copy.deepcopy({name: getattr(self, name) for name in _SPACES})  # with their generators
        kept = {"spec": self._spec, "random": random, "spaces": spaces, "state": state}
        return {**EzPickle.__getstate__(self), **kept}

    def __setstate__(self, data: dict[str, Any]) -> None:
        EzPickle.__setstate__(self, data)
        self._spec = data["spec"]
        vars(self).update(data["spaces"])
        if data["state"] is not None:
            state, observations = data["state"]
            self.set_state(state)
            self._observations = observations.copy()
        self._generators, self._seeds = data["random"]

    def reset(
        self,
        *,
        seed: int | Sequence[int | None] | None = None,
        options: dict[str, Any] | None = None,
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Start episodes in all rows, or in those of `options["reset_mask"]`."""
        chosen = check_options(options, ("morphology", "reset_mask"))
        given_mask = chosen.get("reset_mask", np.ones(self.num_envs, dtype=bool))
        try:
            mask = np.asarray(given_mask)
        except ValueError:  # ragged
            mask = np.empty(0)
        if mask.shape != (self.num_envs,) or mask.dtype != np.bool_ or not mask.any():
            raise CaterpillarError(
                f"reset_mask must be a bool array of shape ({self.num_envs},) with at least one True; "
                f"got {show(given_mask)}"
            )
        if not self._running and not mask.all():
            raise CaterpillarError("call reset() without reset_mask first, to start all rows")
        rows, bodies = np.flatnonzero(mask), None
        if "morphology" in chosen:
            given = read_morphologies(chosen["morphology"], self.num_envs)
            bodies = [given[row] for row in rows]
        self._seed(seed, mask)
        self._running = True
        info: dict[str, Any] = {}
        self._start(rows, info, bodies)
        return self._observations.copy(), info

    def _seed(self, seed: int | Sequence[int | None] | None, mask: NDArray[np.bool_]) -> None:
        if seed is None or isinstance(seed, (int, np.integer)):
            seeds = [None if seed is None else int(seed) + i for i in range(self.num_envs)]
        else:
            listed = isinstance(seed, Sequence) or (isinstance(seed, np.ndarray) and seed.ndim)
            seeds = list(seed) if listed else []
        if len(seeds) != self.num_envs:
            raise CaterpillarError(
                f"seed must be an integer or a list of {self.num_envs} integers; got {show(seed)}"
            )
        seeds = [None if s is None else check_number("seed", s, 0, whole=True) for s in seeds]
        self._make_generators(seeds)
        for row in np.flatnonzero(mask):
            if seeds[row] is not None:
                self._generators[row], self._seeds[row] = np_random(seeds[row])

    def step(
        self, actions: Any
    ) -> tuple[NDArray[np.float32], Array, NDArray[np.bool_], NDArray[np.bool_], dict[str, Any]]:
        """Advance all rows by one step. Rows whose episode has ended follow `autoreset_mode`."""
        if not self._running:
            raise CaterpillarError("call reset() before step()")
        actions = self._episodes.check_actions(actions, self.num_envs)
        if self._mode is AutoresetMode.DISABLED and self._done.any():
            raise CaterpillarError(
                f"the episodes of environments {np.flatnonzero(self._done).tolist()} have ended: reset "
                'these environments with options={"reset_mask": ...} before step()'
            )
        going = np.flatnonzero(~self._done)
        stale = np.flatnonzero(self._done)  # only in NEXT_STEP mode
        rewards = np.zeros(self.num_envs)
        terminated = np.zeros(self.num_envs, dtype=bool)
        truncated = np.zeros(self.num_envs, dtype=bool)
        info: dict[str, Any] = {}
        if going.size:
            observations, reward, failed, timed_out, stepped = self._episodes.step(
                actions[going], going, self.on_interval
            )
            self._observations[going], rewards[going] = observations, reward
            terminated[going], truncated[going] = failed, timed_out
            self._merge(info, stepped, going)
        if stale.size:
            self._start(stale, info)
        self._done = terminated | truncated
        if self._mode is AutoresetMode.SAME_STEP and self._done.any():
            ended = np.flatnonzero(self._done)
            final_obs = np.empty(self.num_envs, dtype=object)
            for row in ended:
                final_obs[row] = self._observations[row].copy()
            final_info: dict[str, Any] = {}
            self._merge(final_info, {k: v[ended] for k, v in info.items() if k[0] != "_"}, ended)
            mask = self._done.copy()
            self._start(ended, info)
            info |= {"final_obs": final_obs, "_final_obs": mask}
            info |= {"final_info": final_info, "_final_info": mask.copy()}
        return self._observations.copy(), rewards, terminated, truncated, info

    def _start(
        self, rows: Rows, info: dict[str, Any], bodies: Sequence[Morphology] | None = None
    ) -> None:
        """Start new episodes in `rows` and write their first info into `info`."""
        observations, started = self._episodes.reset(rows, [self._generators[r] for r in rows], bodies)
        self._observations[rows] = observations
        self._done[rows] = False
        self._merge(info, started, rows)

    def _merge(self, info: dict[str, Any], new: dict[str, NDArray[Any]], rows: Rows) -> None:
        """Write rows of `new` into full-length arrays of `info`, with Gymnasium's `_key` masks."""
        for key, values in new.items():
            if key not in info:
                info[key] = np.zeros((self.num_envs, *values.shape[1:]), dtype=values.dtype)
                info[f"_{key}"] = np.zeros(self.num_envs, dtype=bool)
            info[key][rows] = values
            info[f"_{key}"][rows] = True

    def render(self) -> tuple[Any, ...] | None:
        """Return one frame per row, or None without a render mode or a drawing backend."""
        if self.render_mode is None:
            warn_of_no_render_mode()
            return None
        frames = tuple(self._pictures.draw(row) for row in range(self.num_envs))
        return None if frames[0] is None else frames

    def close_extras(self, **kwargs: Any) -> None:
        """Free the drawing contexts."""
        self._pictures.close()


def _read_mode(value: AutoresetMode | str) -> AutoresetMode:
    """Convert a string such as "NextStep" to an `AutoresetMode`; a mode is returned unchanged."""
    for mode in AutoresetMode:
        if isinstance(value, (str, AutoresetMode)) and value in (mode, mode.value):
            return mode
    known = ", ".join(mode.value for mode in AutoresetMode)
    raise CaterpillarError(f"autoreset_mode = {show(value)} must be one of {known}")
