"""What a training is asked to do, and its hyper-parameters in rl_zoo3's schema."""

from __future__ import annotations

import importlib
from collections.abc import Mapping
from copy import deepcopy
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
import yaml
from stable_baselines3.common.callbacks import BaseCallback
from stable_baselines3.common.utils import LinearSchedule

from caterpillar_env.errors import CaterpillarError, check_choice, from_mapping
from caterpillar_env.gait import GAIT_PERIOD_S
from caterpillar_env.morphology import Morphology
from caterpillar_env.physics import Physics
from caterpillar_env.randomization import Randomization
from caterpillar_env.task import EPISODE_S

AlgorithmName = Literal["ppo", "a2c", "sac", "tqc", "ars"]
Mode = Literal["timing", "switch"]
Design = Literal["fixed", "uniform", "preprocessed"]
ENVIRONMENTS: dict[str, str] = {"timing": "CaterpillarSMA-v0", "switch": "CaterpillarSMASwitch-v0"}
POPULATION = 8  #: bodies that CMA-ES proposes at a time
ROBOTS_PER_BODY = 2  #: that crawl in each of them
HYPERPARAMETERS = Path(__file__).with_name("hyperparams")
_SCHEDULED = ("learning_rate", "clip_range", "clip_range_vf", "delta_std")


class TrainingError(CaterpillarError):
    """A training cannot start or be read as asked."""


@dataclass(frozen=True)
class TrainConfig:
    """Everything that decides what a training computes.

    Raises:
        TrainingError: a value is out of range.
    """

    algorithm: AlgorithmName = "ppo"  #: of stable-baselines3 and its contrib package
    mode: Mode = "switch"  #: timing: a step is a gait period; switch: a step is 0.1 s or a multiple
    open_loop: bool = False  #: timing only: one action for the whole episode, a bandit
    design: Design = "fixed"  #: fixed: one body; else CMA-ES evolves it with the policy, from this prior
    seed: int = 0  #: of all that the training draws; the springs have --mismatch-seed
    budget_s: float = 30_000.0  #: simulated seconds, of training and evaluation together
    evaluations: int = 20  #: how often the policy is judged, spread over the budget
    morphology: Morphology = field(default_factory=Morphology)  #: the body, where it is fixed
    #: NAME LEAST MOST each, drawn evenly at every reset in training: friction, mismatch_std,
    #: spring_force, mass or ambient_c
    randomize: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    physics: Physics = field(default_factory=Physics)

    def __post_init__(self) -> None:
        for name, kind in (("algorithm", AlgorithmName), ("mode", Mode), ("design", Design)):
            check_choice(name, getattr(self, name), kind, TrainingError)
        if not 0 <= self.seed < 2**32:
            raise TrainingError(f"seed = {self.seed} must be a whole number from 0 to {2**32 - 1}")
        if not EPISODE_S <= self.budget_s < np.inf:
            raise TrainingError(
                f"budget_s = {self.budget_s:g} must be at least {EPISODE_S:g}, the simulated seconds of "
                "one episode"
            )
        if self.evaluations < 1:
            raise TrainingError(f"evaluations = {self.evaluations} must be at least 1")
        if self.open_loop and self.mode != "timing":
            raise TrainingError(
                f"open_loop holds one choice of timings: it needs mode timing; got {self.mode}"
            )
        if self.design != "fixed" and (self.algorithm != "ppo" or self.open_loop):
            raise TrainingError(
                f"design = {self.design!r}: a body is evolved around ppo's closed-loop policy only; "
                "choose algorithm ppo without open_loop, or design fixed"
            )
        if self.design != "fixed" and self.morphology != Morphology():
            raise TrainingError(
                f"design = {self.design!r} evolves the body: leave out the given one, or choose "
                "design fixed"
            )
        if (randomization := Randomization.of(self.randomize)) is not None:
            randomization.check(self.physics)
        object.__setattr__(self, "randomize", {k: tuple(v) for k, v in self.randomize.items()})
        hyperparameters(self)

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> TrainConfig:
        """The configuration in plain JSON, as `to_dict` gives it; what is missing is the default.

        Raises:
            CaterpillarError: a field is unknown or unusable.
        """
        made = dict(data)
        if "physics" in made:
            made["physics"] = Physics.of(made["physics"])
        if "morphology" in made:
            made["morphology"] = Morphology.of(made["morphology"])
        return from_mapping(cls, made, "a training", TrainingError)

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON."""
        return asdict(self) | {"randomize": {k: list(v) for k, v in self.randomize.items()}}

    @property
    def env_id(self) -> str:
        """The environment's name."""
        return ENVIRONMENTS[self.mode]

    @property
    def periods_per_step(self) -> int:
        """Gait periods in a step of a bandit: all of an episode."""
        return round(EPISODE_S / GAIT_PERIOD_S)


class Hyperparameters(NamedTuple):
    """What a training's file says, taken apart."""

    model: dict[str, Any]  #: keywords of the algorithm
    n_envs: int  #: robots that learn side by side
    normalize: dict[str, Any] | None  #: keywords of VecNormalize; None: not normalised
    env_kwargs: dict[str, Any]  #: of the environment
    callbacks: list[BaseCallback]

    def plain(self) -> dict[str, Any]:
        """As plain JSON, without the callbacks: to keep, and to compare."""
        shown = (int, float, str, dict)
        model = {k: v if isinstance(v, shown) else str(v) for k, v in self.model.items()}
        kept = deepcopy(self._replace(model=model, callbacks=[])._asdict())  # learners add to theirs
        del kept["callbacks"]
        return kept


def hyperparameters(config: TrainConfig) -> Hyperparameters:
    """What `hyperparams/ALGORITHM.yml` says of the environment, in rl_zoo3's schema.

    Raises:
        TrainingError: it says nothing of it; the algorithm cannot choose such actions.
    """
    path = HYPERPARAMETERS / f"{config.algorithm}.yml"
    table = yaml.safe_load(path.read_text(encoding="utf-8"))
    if config.env_id not in table:
        modes = ", ".join(mode for mode, env_id in ENVIRONMENTS.items() if env_id in table)
        raise TrainingError(
            f"{config.algorithm} cannot learn in mode {config.mode!r}; it can in {modes}"
        )
    settings: dict[str, Any] = table[config.env_id]
    settings.pop("n_timesteps")  # the budget ends a training here
    n_envs = settings.pop("n_envs", 1)
    env_kwargs = settings.pop("env_kwargs", {})
    normalize = settings.pop("normalize", False)
    callbacks = [_callback(entry) for entry in settings.pop("callback", [])]
    for name in _SCHEDULED:
        if isinstance(value := settings.get(name), str):
            settings[name] = LinearSchedule(float(value.removeprefix("lin_")), 0.0, 1.0)
    if config.design != "fixed":
        n_envs = POPULATION * ROBOTS_PER_BODY
    if config.open_loop:
        env_kwargs["frame_skip"] = config.periods_per_step
        for name in ("n_steps", "learning_starts"):  # as many episodes
            if name in settings:
                settings[name] = max(1, settings[name] // config.periods_per_step)
        if "gamma" in settings:
            settings["gamma"] = 0.0  # nothing comes after the one decision
    kwargs = None
    if normalize:
        kwargs = {"gamma": settings.get("gamma", 0.99)} | (
            normalize if isinstance(normalize, dict) else {}
        )
    return Hyperparameters(settings, n_envs, kwargs, env_kwargs, callbacks)


def _callback(entry: str | dict[str, dict[str, Any]]) -> BaseCallback:
    """An entry of `callback`: the path of a class, or that with its keywords."""
    path, keywords = (entry, {}) if isinstance(entry, str) else next(iter(entry.items()))
    module, name = path.rsplit(".", 1)
    made: BaseCallback = getattr(importlib.import_module(module), name)(**keywords)
    return made
