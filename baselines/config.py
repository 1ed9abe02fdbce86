"""Configuration of a training run, its hyperparameters in the schema of rl_zoo3, and its record."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple

import yaml

from baselines.interface import GaitPrior
from caterpillar_env.arguments import ActionMode
from caterpillar_env.errors import CaterpillarError, check_fields, check_number, from_mapping
from caterpillar_env.gait import GAIT_PERIOD_S
from caterpillar_env.morphology import Morphology
from caterpillar_env.physics import Physics
from caterpillar_env.randomization import Randomization
from caterpillar_env.task import EPISODE_S
from evolution.run.history import History
from evolution.run.journal import Evaluation

AlgorithmName = Literal["ppo", "td3"]
Design = Literal["fixed", "uniform", "body"]
ENVIRONMENTS: dict[ActionMode, str] = {
    "timing": "CaterpillarSMA-v0", "phase": "CaterpillarSMA-v0", "switch": "CaterpillarSMASwitch-v0",
}  # fmt: skip
POPULATION = 8  #: number of bodies that CMA-ES proposes per generation
ROBOTS_PER_BODY = 2  #: number of robots with each of these bodies
#: Hyperparameters that only matter if an episode has several steps.
_DISCOUNTED = ("gamma", "gae_lambda", "tau", "target_policy_noise", "target_noise_clip")
HYPERPARAMETERS = Path(__file__).with_name("hyperparams")
# Bounds of overridden values. Other floats are in [0, 1]; other integers are at least 1, or 0 if the
# default is 0.
_BOUNDS = {"log_std_init": (-20.0, 2.0), "reach": (0.0, 0.5), "batch_size": (2, 1_000_000)}
_MOST_LAYERS, _MOST_UNITS = 8, 4096  # of a network
_PERIODS_PER_EPISODE = round(EPISODE_S / GAIT_PERIOD_S)


@dataclass(frozen=True)
class TrainConfig:
    """Settings that affect the result of a training run.

    Raises:
        CaterpillarError: a value is out of range, or two settings exclude each other.
    """

    algorithm: AlgorithmName = "ppo"  #: learning algorithm of stable-baselines3
    #: actions. phase: delays and duties for a period; timing: on and off times for a period; switch:
    #: springs on or off for 0.5 s
    mode: ActionMode = "phase"
    #: gait: learn changes to the best wave of the prior; uniform: learn from scratch
    prior: GaitPrior = "gait"
    open_loop: bool = False  #: choose one action per episode (a bandit); not in switch mode
    design: Design = "fixed"  #: fixed: one body; uniform, body: CMA-ES evolves the body from this prior
    seed: int = 0  #: seed of the training run; for the forces of the springs, see --mismatch-seed
    budget_s: float = 30_000.0  #: simulated seconds of training and evaluation
    evaluations: int = 20  #: approximate number of evaluations of the policy, between rollouts
    morphology: Morphology = field(default_factory=Morphology)  #: body for design fixed
    #: domain randomization during training: NAME LOW HIGH for each randomized quantity (friction,
    #: mismatch_std, spring_force, mass, ambient_c), sampled uniformly at every reset
    randomize: Mapping[str, tuple[float, float]] = field(default_factory=dict)
    #: hyperparameters that differ from those in baselines/hyperparams/ALGORITHM.yml, as NAME=VALUE with
    #: dots for nested names, such as policy_kwargs.log_std_init=-2
    override: tuple[str, ...] = ()
    physics: Physics = field(default_factory=Physics)

    def __post_init__(self) -> None:
        check_fields(self, {"seed": (0, 2**32 - 1), "evaluations": (1, 2**63)})
        if self.budget_s < EPISODE_S:
            raise CaterpillarError(
                f"budget_s = {self.budget_s:g} must be at least {EPISODE_S:g}, the length of one episode"
            )
        if self.open_loop and self.mode == "switch":
            raise CaterpillarError("open_loop requires mode phase or timing; got mode switch")
        if self.design != "fixed" and (self.algorithm != "ppo" or self.open_loop):
            raise CaterpillarError(
                f"design = {self.design!r} requires algorithm ppo without open_loop; change these "
                "settings, or choose design fixed"
            )
        if self.design != "fixed" and self.morphology != Morphology():
            raise CaterpillarError(
                f"design = {self.design!r} evolves the body: remove the body that you gave, or choose "
                "design fixed"
            )
        if (randomization := Randomization.of(self.randomize)) is not None:
            randomization.check(self.physics)
        ranges = {name: tuple(bounds) for name, bounds in self.randomize.items() if bounds is not None}
        object.__setattr__(self, "randomize", ranges)
        self._check_overrides()
        hyperparameters(self)

    def _check_overrides(self) -> None:
        names = [entry.partition("=")[0] for entry in self.override]
        bandit = "open_loop" if self.open_loop else ""  # its episodes are single steps
        without_effect = {
            **dict.fromkeys(_DISCOUNTED, bandit),
            "n_envs": "design" if self.design != "fixed" else "",
            "n_steps": "design" if self.design != "fixed" else "",
            "interface.reach": "prior uniform" if self.prior == "uniform" else "",
        }
        for name in names:
            if names.count(name) > 1:
                raise CaterpillarError(f"override has {name} more than once; give it once")
            if reason := without_effect.get(name):
                raise CaterpillarError(f"override of {name} has no effect with {reason}; remove it")

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> TrainConfig:
        """Make a configuration from the plain JSON of `to_dict`. Missing fields get their defaults.

        Raises:
            CaterpillarError: a field is unknown or has an invalid value.
        """
        kinds: dict[str, Any] = {"physics": Physics, "morphology": Morphology}
        made: Any = data
        if isinstance(data, Mapping):
            made = {name: kinds[name].of(v) if name in kinds else v for name, v in data.items()}
        return from_mapping(cls, made, "a training run")

    def to_dict(self) -> dict[str, Any]:
        """Return the configuration as plain JSON."""
        return asdict(self) | {"randomize": {k: list(v) for k, v in self.randomize.items()}}

    @property
    def env_id(self) -> str:
        """Gymnasium id of the environment."""
        return ENVIRONMENTS[self.mode]

    @property
    def group(self) -> str:
        """Text that training runs share if they differ only in the seed."""
        return repr(replace(self, seed=0))

    @property
    def title(self) -> str:
        """Short description of the training run."""
        words: list[str] = [self.algorithm, self.mode]
        if self.prior == "uniform":
            words.append("without prior")
        if self.open_loop:
            words.append("bandit")
        if self.design != "fixed":
            words.append(f"{self.design} co-design")
        elif self.morphology != Morphology():
            words.append("given body")
        if self.randomize:
            words.append("randomized")
        words += self.override
        return " ".join(words)

    def env_kwargs(self) -> dict[str, Any]:
        """Return the environment arguments that training and evaluation share."""
        settings = {"physics": self.physics, "action_mode": self.mode}
        return settings | hyperparameters(self).env_kwargs


class Hyperparameters(NamedTuple):
    """Hyperparameters of a training run, as plain JSON."""

    n_envs: int  #: number of parallel robots
    env_kwargs: dict[str, Any]  #: arguments of the environment
    interface: dict[str, Any]  #: arguments of `Interface`
    callback: list[Any]  #: mappings from the class path of a callback to its arguments
    model: dict[str, Any]  #: arguments of the algorithm


def hyperparameters(config: TrainConfig) -> Hyperparameters:
    """Read `hyperparams/ALGORITHM.yml`, apply overrides, and adapt the values to bandits and co-design.

    Raises:
        CaterpillarError: the algorithm does not support the environment's action space, or an override
            is invalid.
    """
    path = HYPERPARAMETERS / f"{config.algorithm}.yml"
    table = yaml.safe_load(path.read_text(encoding="utf-8"))
    if config.env_id not in table:
        modes = ", ".join(mode for mode, env_id in ENVIRONMENTS.items() if env_id in table)
        raise CaterpillarError(
            f"{config.algorithm} does not support mode {config.mode!r}; it supports {modes}"
        )
    model: dict[str, Any] = table[config.env_id]
    model.pop("n_timesteps")  # only rl_zoo3 uses it; here the budget ends the training
    env_kwargs, callback = model.pop("env_kwargs", {}), model.pop("callback", [])
    ((_, interface),) = model.pop("vec_env_wrapper")[0].items()
    interface |= {"mode": config.mode, "prior": config.prior}
    if config.open_loop:
        env_kwargs["action_repeat"] = _PERIODS_PER_EPISODE
        model["gamma"] = 0.0  # an episode is a single step
        if "n_steps" in model:  # keep the number of episodes
            model["n_steps"] = max(model["n_steps"] // _PERIODS_PER_EPISODE, 1)
    for entry in config.override:
        _override(model, interface, entry)
    n_envs = model.pop("n_envs", 1)
    if config.prior == "uniform":
        callback = []  # the callbacks make a policy begin with the gait of the prior
    if config.design != "fixed":
        n_envs = POPULATION * ROBOTS_PER_BODY
    if "n_steps" in model:
        rollout = model["n_steps"] * n_envs
        if rollout < 2:
            raise CaterpillarError("a rollout of n_steps * n_envs = 1 is too short; choose 2 or more")
        # PPO warns of mini-batches that are larger than a rollout.
        model["batch_size"] = min(model["batch_size"], rollout)
    return Hyperparameters(n_envs, env_kwargs, interface, callback, model)


def _override(model: dict[str, Any], interface: dict[str, Any], entry: str) -> None:
    """Apply an override `NAME=VALUE`, whose value is a number or a list."""
    policy: dict[str, Any] = model["policy_kwargs"]
    tables = {"": model, "policy_kwargs.": policy, "interface.": {"observe": None} | interface}
    known = {
        prefix + name: old
        for prefix, table in tables.items()
        for name, old in table.items()
        if not isinstance(old, (str, dict)) and name != "action_repeat"
    }
    name, _, text = entry.partition("=")
    if name not in known:
        raise CaterpillarError(
            f"override {entry!r} must be NAME=VALUE, where NAME is one of: {', '.join(known)}"
        )
    try:
        new = json.loads(text)
    except (ValueError, RecursionError):
        new = text
    prefix, _, last = name.rpartition(".")
    old = known[name]
    if isinstance(old, (int, float)):
        whole = isinstance(old, int)
        default = (min(old, 1), 1_000_000) if whole else (0.0, 1.0)
        new = check_number(f"override {name}", new, *_BOUNDS.get(last, default), whole=whole)
    elif old is None:
        if not isinstance(new, list) or not all(isinstance(kind, str) for kind in new):
            raise CaterpillarError(f'override {name} must be a list like ["temperature"]; got {text}')
    elif not isinstance(new, list) or len(new) > _MOST_LAYERS:
        raise CaterpillarError(
            f"override {name} must be a list like {old} with at most {_MOST_LAYERS} entries; got {text}"
        )
    else:
        new = [check_number(f"override {name}", size, 1, _MOST_UNITS, whole=True) for size in new]
    {"": model, "policy_kwargs": policy, "interface": interface}[prefix][last] = new


def make_configuration(config: TrainConfig) -> dict[str, Any]:
    """Return the configuration that the journal of a training run stores."""
    settings = {"kind": "training", **config.to_dict()}
    settings["hyperparameters"] = hyperparameters(config)._asdict()
    plain: dict[str, Any] = json.loads(json.dumps(settings))  # as read from a journal: lists, no tuples
    return plain


def is_same(configuration: Mapping[str, Any], config: TrainConfig) -> bool:
    """Return whether a journal has the settings of `config` and the current hyperparameters."""
    try:
        recorded = read_settings(configuration)
    except CaterpillarError:
        return False
    expected = make_configuration(config)["hyperparameters"]
    return recorded == config and configuration.get("hyperparameters") == expected


def read_settings(configuration: Mapping[str, Any]) -> TrainConfig:
    """Return the settings in the configuration of a journal.

    Raises:
        CaterpillarError: a setting is unknown or invalid.
    """
    names = ("kind", "hyperparameters")
    return TrainConfig.from_dict({k: v for k, v in configuration.items() if k not in names})


def is_evaluated_as_recorded(configuration: Mapping[str, Any], config: TrainConfig) -> bool:
    """Return whether a journal has the current hyperparameters, except those that affect only learning.

    Args:
        configuration: configuration from the journal.
        config: configuration of the same training run.
    """

    def select(learning: Any) -> Any:
        model = learning["model"]
        return (
            learning["env_kwargs"], learning["interface"], model["policy"], model.get("policy_kwargs"),
        )  # fmt: skip

    try:
        same = select(configuration["hyperparameters"]) == select(hyperparameters(config)._asdict())
    except (LookupError, TypeError, AttributeError):
        return False
    return bool(same)


class Training(NamedTuple):
    """A training run and its record.

    Each evaluation of `history` is one episode of the deterministic policy. The genome of an evaluation
    encodes the body. Its `simulated_s` includes the training since the previous evaluation.
    """

    config: TrainConfig
    history: History

    @classmethod
    def read(cls, folder: Path) -> Training:
        """Read the folder of a training run, even while it is running.

        Raises:
            CaterpillarError: the folder contains no training run.
        """
        history = History.read(folder)
        if history.kind != "training":
            raise CaterpillarError(
                f"{folder} contains an evolutionary run; give a folder that caterpillar rl train made"
            )
        try:
            return cls(read_settings(history.configuration), history)
        except CaterpillarError as error:
            raise CaterpillarError(
                f"{folder}: {error}. If an earlier version of this package trained it, use that version"
            ) from None

    def body(self, evaluation: Evaluation) -> Morphology:
        """Return the body with which the policy was evaluated."""
        if self.config.design == "fixed":
            return self.config.morphology
        return Morphology.from_unit(evaluation.genome)
