"""Arms of a study: what is run, whoever runs it, as the study sees it.

Arms are entry points of the group `caterpillar.arms`: classes with the methods of `Arm`. `evolution` is
the one of this package; other packages add theirs in the same way.
"""

from __future__ import annotations

import shutil
import sqlite3
from collections.abc import Mapping
from contextlib import closing
from dataclasses import dataclass, replace
from importlib.metadata import entry_points
from pathlib import Path
from typing import Any, NamedTuple, Protocol

import numpy as np
import polars

from caterpillar_env.errors import CaterpillarError
from caterpillar_env.robot import AnyRobot, Robot
from caterpillar_env.task import Failure
from evolution.config import RunConfig
from evolution.run.database import JournalError
from evolution.run.evaluators import LocalEvaluator
from evolution.run.history import History
from evolution.run.journal import FILE
from evolution.run.loop import evolve, resume

_FOREVER = 1_000_000  # generations: the budget ends a run


class ArmError(CaterpillarError):
    """An arm is not described as it must be, or its run has other settings."""


#: What every arm tells of an evaluation; genes may follow.
COLUMNS = polars.Schema({
    "evaluation": polars.Int64, "generation": polars.Int64, "failure": polars.String,
    "distance_m": polars.Float64, "energy_j": polars.Float64, "simulated_s": polars.Float64,
})  # fmt: skip


class Standing(NamedTuple):
    """How far a run is."""

    simulated_s: float
    best_m: float


class Arm(Protocol):
    """What is run, but for the seed and the budget; equal arms run alike."""

    @property
    def role(self) -> str | None:
        """What the arm is there for, in words."""
        ...

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> Arm:
        """The arm of plain data, without `kind`, `seed` and `budget_s`."""
        ...

    @classmethod
    def shared(cls, base: Mapping[str, Any]) -> Mapping[str, Any]:
        """Of what a study's arms have in common, the part that concerns this kind."""
        ...

    def run(self, folder: Path, seed: int, budget_s: float) -> None:
        """Run on one thread, or go on; raises ArmError if the folder's run has other settings."""
        ...

    def is_finished(self, folder: Path, seed: int, budget_s: float) -> bool:
        """Whether the folder holds a finished run; raises ArmError if it has other settings."""
        ...

    def standing(self, folder: Path) -> Standing:
        """How far a run is that may be running."""
        ...

    def evaluations(self, folder: Path) -> polars.DataFrame:
        """A finished run: `COLUMNS` in their order, and genes."""
        ...

    def wall_s(self, folder: Path) -> float | None:
        """Wall time of a finished run that was never interrupted, s."""
        ...

    def versions(self, folder: Path) -> list[dict[str, str]]:
        """The versions and machines that a finished run ran under."""
        ...

    def best(self, folder: Path, budget_s: float) -> AnyRobot | None:
        """The best robot of a finished run within the budget, if one crawled forwards."""
        ...


def make(data: Mapping[str, Any], base: Mapping[str, Any]) -> Arm:
    """The arm of plain data: `kind` ("evolution" by default), and that kind's settings.

    Args:
        data: of the arm.
        base: what all arms have in common; tables within tables are merged, anything else replaced.

    Raises:
        CaterpillarError: no such kind, or an unusable setting.
    """
    special = dict(data)
    name = special.pop("kind", "evolution")
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
    return kind.from_dict(_merged(kind.shared(base), special))


def _merged(base: Mapping[str, Any], special: Mapping[str, Any]) -> dict[str, Any]:
    merged = dict(base)
    for key, value in special.items():
        old = merged.get(key)
        both = isinstance(old, Mapping) and isinstance(value, Mapping)
        merged[key] = _merged(old, value) if both else value  # type: ignore[arg-type]
    return merged


@dataclass(frozen=True)
class EvolutionArm:
    """An arm that evolves genomes: a run of the genetic algorithm, CMA-ES or random search."""

    config: RunConfig

    @property
    def role(self) -> str | None:
        """See `Arm`."""
        return _ROLES.get((self.config.optimizer, self.config.prior))

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> EvolutionArm:
        """See `Arm`; raises ArmError where a target would end runs before their budget is spent."""
        config = RunConfig.from_dict(dict(data))
        if config.target_m is not None:
            raise ArmError(
                f"target_m = {config.target_m:g} would end runs early, and a study compares them over "
                "the whole budget; leave it out (the study's threshold_shares are targets of its own)"
            )
        return cls(config)

    @classmethod
    def shared(cls, base: Mapping[str, Any]) -> Mapping[str, Any]:
        """See `Arm`."""
        return base

    def run_config(self, seed: int, budget_s: float) -> RunConfig:
        """What a run computes."""
        return replace(self.config, seed=seed, budget_s=budget_s, generations=_FOREVER)

    def run(self, folder: Path, seed: int, budget_s: float) -> None:
        """See `Arm`."""
        config = self.run_config(seed, budget_s)
        if not (folder / FILE).exists():
            shutil.rmtree(folder, ignore_errors=True)  # begun, but nothing evaluated
            result = evolve(config, folder, evaluator=LocalEvaluator(1))
        else:
            history = History.read(folder)
            _same_settings(history, config, folder)
            if history.finished:
                return
            result = resume(folder, evaluator=LocalEvaluator(1))
        if not result.finished:
            raise ArmError(f"{folder} was interrupted; it goes on when the study is started again")

    def is_finished(self, folder: Path, seed: int, budget_s: float) -> bool:
        """See `Arm`."""
        if not (folder / FILE).exists():
            return False
        try:
            history = History.read(folder)
            _same_settings(history, self.run_config(seed, budget_s), folder)
            return history.finished
        except JournalError:
            return False  # whoever runs it will say why

    def standing(self, folder: Path) -> Standing:
        """See `Arm`."""
        try:
            path = f"{(folder / FILE).resolve().as_uri()}?mode=ro"
            with closing(sqlite3.connect(path, uri=True)) as db:
                spent, best = db.execute(
                    "SELECT total(simulated_s), max(CASE failure WHEN 'ok' THEN distance_m ELSE 0 END) "
                    "FROM evaluations"
                ).fetchone()
        except sqlite3.Error:
            return Standing(0.0, 0.0)  # not begun
        return Standing(spent, max(best or 0.0, 0.0))

    def evaluations(self, folder: Path) -> polars.DataFrame:
        """See `Arm`."""
        return History.read(folder).table().drop("session", "fitness")

    def wall_s(self, folder: Path) -> float | None:
        """See `Arm`."""
        return History.read(folder).wall_s

    def versions(self, folder: Path) -> list[dict[str, str]]:
        """See `Arm`."""
        return [session.fingerprint for session in History.read(folder).sessions]

    def best(self, folder: Path, budget_s: float) -> Robot | None:
        """See `Arm`."""
        rows = History.read(folder).evaluations
        spent_s = np.cumsum([row.simulated_s for row in rows])
        able = [
            row
            for row, spent in zip(rows, spent_s, strict=True)
            if spent <= budget_s and row.failure is Failure.NONE and row.distance_m > 0
        ]
        if not able:
            return None
        top = max(able, key=lambda row: row.distance_m)
        return self.config.encoding.robot(
            top.genome, fitness_m=top.distance_m, generation=top.generation
        )


def _same_settings(history: History, config: RunConfig, folder: Path) -> None:
    if history.config != config:
        raise ArmError(
            f"{folder} was run with other settings; choose another folder for the study, or remove it"
        )


_ROLES = {
    ("ga", "uniform"): "The genetic algorithm without preprocessing",
    ("ga", "preprocessed"): "Preprocessing",
    ("ga", "init-only"): "Preprocessed initialisation alone",
    ("ga", "mutation-only"): "Preprocessed mutation alone",
    ("ga", "mirrored"): "A prior that misleads on purpose",
    ("random", "uniform"): "Random search",
    ("random", "preprocessed"): "Random search from the prior",
    ("cma-es", "uniform"): "CMA-ES",
    ("cma-es", "preprocessed"): "CMA-ES from the prior",
}
