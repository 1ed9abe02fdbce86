"""Arms of a study: the kinds of runs that it compares.

Each kind is an entry point of the group `caterpillar.arms`: a class with the methods of `Arm`. This
package provides the kind `evolution`; other packages can add kinds.
"""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from dataclasses import dataclass, replace
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, Protocol

from caterpillar_env.errors import CaterpillarError, show
from caterpillar_env.robot import AnyRobot, Robot
from evolution.config import RunConfig
from evolution.run.evaluators import Evaluator
from evolution.run.history import History
from evolution.run.journal import FILE
from evolution.run.loop import evolve, resume

_UNLIMITED = 1_000_000  # generations: the budget ends a run


class Arm(Protocol):
    """Settings of a run except its seed and budget. Equal arms produce equal runs.

    Every run is a folder with a journal (`evolution.run.journal`), and the study reads the evaluations
    from it. These methods cover everything that depends on the kind of the arm.
    """

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], base: Mapping[str, Any]) -> Arm:
        """Make an arm from plain data.

        Args:
            data: settings of this arm, without `kind`.
            base: settings shared by all arms. Each kind uses those that apply to it (see `merge`).

        Raises:
            CaterpillarError: a setting is invalid.
        """

    def run(self, folder: Path, seed: int, budget_s: float, evaluator: Evaluator) -> bool:
        """Run or resume, and return whether the run finished.

        Args:
            folder: run folder.
            seed: seed of the run.
            budget_s: simulated time to spend, s.
            evaluator: simulates genomes. Apart from it, a run uses one thread.
        """

    def matches(self, history: History, seed: int, budget_s: float) -> bool:
        """Return whether a recorded run has these settings."""

    def robot(self, folder: Path, evaluation: int) -> AnyRobot:
        """Return the robot of an evaluation of a finished run, by its number."""


def make_arm(name: str, data: Mapping[str, Any], base: Mapping[str, Any]) -> Arm:
    """Make the arm `name` of the kind that `data["kind"]` names ("evolution" by default).

    Args:
        name: name of the arm, for messages.
        data: settings of this arm.
        base: settings shared by all arms.

    Raises:
        CaterpillarError: the kind is unknown, or a setting is invalid.
    """
    if not isinstance(data, Mapping):
        raise CaterpillarError(f"arms.{name} must be a table; got {show(data)}")
    if reserved := {*data, *base} & {"seed", "generations", "budget_s"}:
        names = ", ".join(sorted(reserved))
        raise CaterpillarError(f"arms.{name}: remove {names}, which the study sets for every run")
    settings = dict(data)
    kind = settings.pop("kind", "evolution")
    known = {e.name: e for e in entry_points(group="caterpillar.arms")}
    try:
        if not isinstance(kind, str) or kind not in known:
            raise CaterpillarError(f"kind = {show(kind)} must be one of {', '.join(sorted(known))}")
        arm: Arm = known[kind].load().from_dict(settings, base)
        return arm
    except ImportError as error:
        raise CaterpillarError(
            f"arms.{name}: kind = {kind!r} needs a package that is missing: {error} (for 'rl': pip "
            "install 'caterpillar-sma[rl]')"
        ) from None
    except CaterpillarError as error:
        raise CaterpillarError(f"arms.{name}: {error}") from None


def merge(base: Mapping[str, Any], special: Mapping[str, Any]) -> dict[str, Any]:
    """Return `base` updated by `special`. Nested tables are merged, other values are replaced."""
    merged = dict(base)
    for key, value in special.items():
        old = merged.get(key)
        nested = isinstance(old, Mapping) and isinstance(value, Mapping)
        merged[key] = merge(old, value) if nested else value  # type: ignore[arg-type]
    return merged


@dataclass(frozen=True)
class EvolutionArm:
    """Runs of an optimizer: the genetic algorithm, SHADE, CMA-ES or random search. See `Arm`."""

    config: RunConfig

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], base: Mapping[str, Any]) -> EvolutionArm:
        """Make an arm from the fields of a run's configuration.

        Raises:
            CaterpillarError: a field is invalid, or is `target_m`, which ends runs before their budget.
        """
        config = RunConfig.from_dict(merge(base, data))
        if config.target_m is not None:
            raise CaterpillarError(
                f"target_m = {config.target_m:g} would end runs before their budget is spent; remove it "
                "(the targets of a study are its threshold_shares)"
            )
        return cls(config)

    def run_config(self, seed: int, budget_s: float) -> RunConfig:
        """Return the configuration of one run."""
        return replace(self.config, seed=seed, budget_s=budget_s, generations=_UNLIMITED)

    def run(self, folder: Path, seed: int, budget_s: float, evaluator: Evaluator) -> bool:
        """Evolve, or resume if there is a journal."""
        if (folder / FILE).exists():
            return resume(folder, evaluator=evaluator).finished
        shutil.rmtree(folder, ignore_errors=True)  # stopped before the journal was created
        return evolve(self.run_config(seed, budget_s), folder, evaluator=evaluator).finished

    def matches(self, history: History, seed: int, budget_s: float) -> bool:
        """Return whether the run has the configuration of this arm."""
        return history.config == self.run_config(seed, budget_s)

    def robot(self, folder: Path, evaluation: int) -> Robot:
        """Decode the genome of an evaluation."""
        history = History.read(folder)
        return history.robot(history.evaluations[evaluation])
