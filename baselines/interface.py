"""Interface between a learner and its robots: selects observations and interprets actions."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
from gymnasium import spaces
from numpy.typing import NDArray
from stable_baselines3.common.vec_env import VecEnv, VecEnvWrapper
from stable_baselines3.common.vec_env.base_vec_env import VecEnvObs, VecEnvStepReturn

from caterpillar_env.arguments import ActionMode, EpisodeConfig
from caterpillar_env.arrays import Array
from caterpillar_env.errors import CaterpillarError, check_choice, check_number
from caterpillar_env.gait import GAIT_PERIOD_S, GaitTimings
from caterpillar_env.morphology import NAMES
from caterpillar_env.physics import CONTROL_INTERVAL_S, Physics
from evolution.genome import Encoding
from evolution.priors import make_priors
from evolution.priors.distributions import Gaussian

GaitPrior = Literal["uniform", "gait"]


class Interface(VecEnvWrapper):
    """Wraps a `VecEnv` so that actions are changes to the gait at the peak of evolution's prior.

    With the prior `gait`, an action of zeros makes the wave at the peak of the key design parameters K_4
    (stroke) and K_5 (advance), see `best_wave`.
    In timing and phase mode, -1 and 1 move a time, a delay or a duty of this wave by `reach`. In
    switch mode, 0 leaves a spring as in the wave, and 1 inverts whether it is powered. With the prior
    `uniform`, actions are those of the environment.

    Args:
        venv: robots, for example a `CaterpillarVecEnv`.
        mode: action mode of the robots.
        prior: prior of the gait.
        reach: largest change, as a share of the period (of the largest duty for duties).
        action_repeat: `action_repeat` of the robots, in switch mode.
        observe: kinds of observation entries to keep; the kind is the part of an entry's name before the
            colon. By default, all entries are kept.

    Raises:
        CaterpillarError: a value is out of range, an entry is unknown, the prior has no peak, or the
            robots have other settings.
    """

    def __init__(
        self,
        venv: VecEnv,
        *,
        mode: ActionMode,
        prior: GaitPrior = "gait",
        reach: float = 0.3,
        action_repeat: int = 1,
        observe: Sequence[str] | None = None,
    ) -> None:
        check_number("reach", reach, 0.0, 0.5)
        check_choice("mode", mode, ActionMode)
        check_choice("prior", prior, GaitPrior)
        config: EpisodeConfig = venv.get_attr("config", [0])[0]
        expected: dict[str, Any] = {"action_mode": mode}
        if mode == "switch":
            expected["action_repeat"] = action_repeat
        if prior == "gait":
            expected |= {"gait_period_s": GAIT_PERIOD_S, "symmetric": True}
        for name, value in expected.items():
            if (given := getattr(config, name)) != value:
                raise CaterpillarError(
                    f"the robots must have {name} = {value!r} with mode = {mode!r} and prior = "
                    f"{prior!r}; got {given!r}. Give Interface the settings of the robots"
                )
        names: list[str] = venv.get_attr("observation_names", [0])[0]
        kinds = [name.split(":")[0] for name in names]
        if unknown := set(observe or ()) - set(kinds):
            known = ", ".join(dict.fromkeys(kinds))
            raise CaterpillarError(f"observe has {', '.join(sorted(unknown))}; choose from {known}")
        if observe is not None and not observe:
            raise CaterpillarError("observe is empty: it needs one or more parts of the observation")
        self._kept = [i for i, kind in enumerate(kinds) if observe is None or kind in observe]
        self._mode, self._reach = mode, 2.0 * reach
        self._repeat_s = action_repeat * CONTROL_INTERVAL_S
        self._wave: Wave | None = None
        if prior == "gait":
            self._wave = best_wave(config.physics, mode)
        self._clock = [i for i, kind in enumerate(kinds) if kind == "phase"]
        self._observations = np.empty((0, len(names)), dtype=np.float32)
        space = venv.observation_space
        assert isinstance(space, spaces.Box)
        low, high = space.low[self._kept], space.high[self._kept]
        super().__init__(venv, spaces.Box(low, high, dtype=np.float32))

    def observe(self, observations: NDArray[Any]) -> NDArray[Any]:
        """Return the entries that a policy observes, given observations (R, n) or (n,) of the robots."""
        return observations[..., self._kept]

    def act(self, actions: NDArray[Any], observations: NDArray[Any]) -> NDArray[Any]:
        """Return the actions of the robots for a policy's actions (R, m) and the observations (R, n)."""
        if self._wave is None:
            return actions
        if self._mode == "switch":
            cosine, sine = observations[:, self._clock].T
            phase_s = np.arctan2(sine, cosine) / (2 * np.pi) * GAIT_PERIOD_S + self._repeat_s / 2
            return np.where(_powered(self._wave.gait, phase_s), 1 - actions, actions)
        moved = self._wave.action + self._reach * actions
        return np.where(self._wave.circular, (moved + 1.0) % 2.0 - 1.0, np.clip(moved, -1.0, 1.0))

    def reset(self) -> VecEnvObs:
        """Reset the robots; see `VecEnv`."""
        self._observations = np.asarray(self.venv.reset())
        return self.observe(self._observations)

    def step_async(self, actions: NDArray[Any]) -> None:
        """Step the robots with the actions of a policy; see `VecEnv`."""
        self.venv.step_async(self.act(actions, self._observations))

    def step_wait(self) -> VecEnvStepReturn:
        """Return the outcome of the step; see `VecEnv`."""
        observations, rewards, dones, infos = self.venv.step_wait()
        self._observations = np.asarray(observations)
        for row in np.flatnonzero(dones):
            infos[row]["terminal_observation"] = self.observe(infos[row]["terminal_observation"])
        return self.observe(self._observations), rewards, dones, infos


class Wave(NamedTuple):
    """A wave, and the action that makes it."""

    gait: GaitTimings  #: times of every spring
    action: Array  #: one action in timing or phase mode; zeros in switch mode, where a gait takes many
    circular: NDArray[np.bool_]  #: entries of the action for which -1 and 1 mean the same


def best_wave(physics: Physics, mode: ActionMode) -> Wave:
    """Return the wave at the peak of the gait's prior. It begins with the first dorsal pair.

    Raises:
        CaterpillarError: K_4 and K_5 disagree on a gene, so that the prior has no peak.
    """
    encoding = Encoding(physics, timing="phase")
    rows = make_priors(encoding, "gait")[len(NAMES) :]
    peaks = []
    for row in rows:
        if row.gene.parameter == "start":
            peaks.append(0.0)
        elif isinstance(row.distribution, Gaussian):
            peaks.append(row.distribution.mu)
        else:
            raise CaterpillarError(
                f"the prior of the gait has no peak for {row.gene.name} with this physics; choose prior "
                "uniform"
            )
    wave = encoding.robot(np.array([0.5] * len(NAMES) + peaks)).timings
    if mode == "switch":
        zeros = np.zeros(physics.num_springs)
        return Wave(wave.mirrored(), zeros, zeros > 0)
    if mode == "timing":
        action = wave.to_action().astype(float)
        return Wave(wave.mirrored(), action, np.ones(len(action), dtype=bool))
    circular = np.array([row.gene.circular for row in rows])
    return Wave(wave.mirrored(), 2.0 * np.array(peaks) - 1.0, circular)


def _powered(wave: GaitTimings, time_s: Array) -> NDArray[np.bool_]:
    """Return whether each spring is on at times (R,) of the gait, (R, springs)."""
    since_s = (time_s[:, None] - wave.on_s) % wave.period_s
    return since_s < (wave.off_s - wave.on_s) % wave.period_s
