"""Arms of a study: the kinds of runs that it compares.

Kinds of arms are entry points of the group `caterpillar.arms`: classes with the methods of `Arm`.
`evolution` is the one of this package; other packages can add theirs.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, Protocol

from caterpillar_env.errors import CaterpillarError
from caterpillar_env.robot import AnyRobot, Robot
from evolution.config import OPTIMIZERS, PRIORS, RunConfig
from evolution.run.evaluators import LocalEvaluator
from evolution.run.history import History
from evolution.run.journal import FILE
from evolution.run.loop import evolve, resume

_UNLIMITED = 1_000_000  # generations: the budget ends a run


class ArmError(CaterpillarError):
    """An arm's settings cannot be used, or its run was made with other settings."""


class Arm(Protocol):
    """Settings of a run except its seed and budget. Equal arms run alike.

    A run of any kind is a folder with a journal (`evolution.run.journal`), from which the study reads
    everything except what these methods say.
    """

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], base: Mapping[str, Any]) -> Arm:
        """Make an arm from plain data.

        Args:
            data: the arm's own settings, without `kind`.
            base: settings shared by all arms; each kind takes those that concern it (see `merge`).

        Raises:
            CaterpillarError: a setting cannot be used.
        """
        ...

    @property
    def title(self) -> str:
        """The arm in a few words."""
        ...

    def run(self, folder: Path, seed: int, budget_s: float) -> bool:
        """Run or resume on one thread; return whether the run finished."""
        ...

    def matches(self, history: History, seed: int, budget_s: float) -> bool:
        """Return whether a recorded run has these settings."""
        ...

    def robot(self, folder: Path, evaluation: int) -> AnyRobot:
        """Return the robot of a finished run's best evaluation within the budget, by its number."""
        ...


def make_arm(data: Mapping[str, Any], base: Mapping[str, Any]) -> Arm:
    """Make an arm of the kind that `data["kind"]` names ("evolution" by default).

    Args:
        data: the arm's own settings.
        base: settings shared by all arms.

    Raises:
        CaterpillarError: the kind is unknown, or a setting cannot be used.
    """
    settings = dict(data)
    name = settings.pop("kind", "evolution")
    known = {e.name: e for e in entry_points(group="caterpillar.arms")}
    if name not in known:
        raise ArmError(f"kind = {name!r} must be one of {', '.join(sorted(known))}")
    try:
        kind: type[Arm] = known[name].load()
    except ImportError as error:
        package = dist.name if (dist := known[name].dist) else "its package"
        raise ArmError(
            f"kind {name!r} of {package} cannot be used: {error}; install what {package} needs for it "
            "(for 'rl': pip install 'caterpillar-sma[rl]')"
        ) from None
    return kind.from_dict(settings, base)


def merge(base: Mapping[str, Any], special: Mapping[str, Any]) -> dict[str, Any]:
    """Merge settings into those of `base`: nested tables are merged, other values replaced."""
    merged = dict(base)
    for key, value in special.items():
        old = merged.get(key)
        nested = isinstance(old, Mapping) and isinstance(value, Mapping)
        merged[key] = merge(old, value) if nested else value  # type: ignore[arg-type]
    return merged


@dataclass(frozen=True)
class EvolutionArm:
    """Runs of an optimizer: the genetic algorithm, CMA-ES or random search. See `Arm`."""

    config: RunConfig

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], base: Mapping[str, Any]) -> EvolutionArm:
        """Make an arm from the fields of a run's configuration.

        Raises:
            CaterpillarError: a field cannot be used; `target_m` would end a run before its budget.
        """
        config = RunConfig.from_dict(merge(base, data))
        if config.target_m is not None:
            raise ArmError(
                f"target_m = {config.target_m:g} would end runs before their budget is spent; remove it "
                "(the targets of a study are its threshold_shares)"
            )
        return cls(config)

    @property
    def title(self) -> str:
        """The optimizer and its prior."""
        return f"{OPTIMIZERS[self.config.optimizer]} with {PRIORS[self.config.prior]}"

    def run_config(self, seed: int, budget_s: float) -> RunConfig:
        """Return the configuration of one run."""
        return replace(self.config, seed=seed, budget_s=budget_s, generations=_UNLIMITED)

    def run(self, folder: Path, seed: int, budget_s: float) -> bool:
        """Evolve, or resume where a journal exists."""
        if (folder / FILE).exists():
            return resume(folder, evaluator=LocalEvaluator(1)).finished
        shutil.rmtree(folder, ignore_errors=True)  # stopped before the journal was created
        return evolve(self.run_config(seed, budget_s), folder, evaluator=LocalEvaluator(1)).finished

    def matches(self, history: History, seed: int, budget_s: float) -> bool:
        """Compare the configuration of a run."""
        return history.config == self.run_config(seed, budget_s)

    def robot(self, folder: Path, evaluation: int) -> Robot:
        """Decode the genome of an evaluation."""
        history = History.read(folder)
        return history.robot(history.evaluations[evaluation])
