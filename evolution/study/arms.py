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
from typing import Any, ClassVar, Protocol

import numpy as np
import polars

from caterpillar_env.errors import CaterpillarError, show
from caterpillar_env.robot import AnyRobot, Outcomes, Robot
from evolution.config import RunConfig
from evolution.objective import score
from evolution.run.evaluators import Evaluator
from evolution.run.history import History
from evolution.run.journal import FAILURES, FILE, Journal
from evolution.run.loop import evolve, resume

_UNLIMITED = 1_000_000  # maximum number of generations; the budget ends a run earlier


class Arm(Protocol):
    """Settings of a run except its seed and budget. Equal arms produce equal runs.

    Every run is a folder with a journal (`evolution.run.journal`), and the study reads the evaluations
    from it. These methods cover everything that depends on the kind of the arm.
    """

    #: Whether a run can be continued from its evaluations alone, see `restore`. Such a run ends after
    #: the generation in which its budget is spent.
    restorable: ClassVar[bool]

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
            evaluator: simulates genomes. The rest of the run uses one thread.
        """

    def matches(self, history: History, seed: int, budget_s: float) -> bool:
        """Return whether a recorded run has these settings."""

    def restore(self, rows: polars.DataFrame, folder: Path, seed: int, budget_s: float) -> None:
        """Recreate the folder of a run from its evaluations. Only for arms that are `restorable`.

        Args:
            rows: evaluations of completed generations, as in the table of a study.
            folder: run folder to create.
            seed: seed of the run.
            budget_s: budget of the run, simulated seconds.

        Raises:
            CaterpillarError: the replayed genomes differ from the recorded ones, because the package or
                NumPy has changed.
        """

    def robot(self, folder: Path, evaluation: int) -> AnyRobot:
        """Return the robot that has the evaluation number `evaluation` in a finished run."""

    def load(self, path: Path) -> AnyRobot:
        """Read a robot from the JSON file that its `save` wrote.

        Raises:
            CaterpillarError: the file is missing or invalid.
        """


def make_arm(name: str, data: Mapping[str, Any], base: Mapping[str, Any]) -> Arm:
    """Make the arm `name`. Its kind is `data["kind"]`, "evolution" by default.

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
        raise CaterpillarError(
            f"arms.{name} or base: remove {names}, which the study sets for every run"
        )
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
    """An arm that runs the genetic algorithm, SHADE, CMA-ES or random search. See `Arm`."""

    config: RunConfig
    restorable: ClassVar[bool] = True

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
                "(the targets of a study are its thresholds_m)"
            )
        return cls(config)

    def run_config(self, seed: int, budget_s: float) -> RunConfig:
        """Return the configuration of one run."""
        return replace(self.config, seed=seed, budget_s=budget_s, generations=_UNLIMITED)

    def run(self, folder: Path, seed: int, budget_s: float, evaluator: Evaluator) -> bool:
        """Start a run, or resume it from its journal. The journal may have a smaller budget."""
        if (folder / FILE).exists():
            return resume(folder, budget_s=budget_s, evaluator=evaluator).finished
        shutil.rmtree(folder, ignore_errors=True)  # stopped before the journal was created
        return evolve(self.run_config(seed, budget_s), folder, evaluator=evaluator).finished

    def matches(self, history: History, seed: int, budget_s: float) -> bool:
        """Return whether the run has the configuration of this arm. Its budget may be different."""
        return replace(history.config, budget_s=budget_s) == self.run_config(seed, budget_s)

    def restore(self, rows: polars.DataFrame, folder: Path, seed: int, budget_s: float) -> None:
        """Replay the optimizer with the recorded outcomes, which leads to the same genomes."""
        config = self.run_config(seed, budget_s)
        optimizer, encoding = config.make_optimizer(), config.encoding
        partial = folder.with_name(f".{folder.name}.partial")
        shutil.rmtree(partial, ignore_errors=True)
        partial.mkdir(parents=True)
        with Journal.create(partial, config.to_dict()) as journal:
            history = History(journal)
            history.begin()
            for generation in rows.partition_by("generation", maintain_order=True):
                genomes = encoding.check(optimizer.ask())
                genes = generation.select(gene.name for gene in encoding.genes).to_numpy()
                if not np.array_equal(encoding.values(genomes).astype(np.float32), genes):
                    raise CaterpillarError(
                        f"{folder} cannot be restored: the genomes of generation "
                        f"{len(history.generations)} differ from the recorded ones. The package or "
                        "NumPy has changed; install the versions of the study, or start a new study"
                    )
                history.append(genomes, _to_outcomes(generation))
                outcomes = history.complete()
                optimizer.tell(genomes, score(history.objective, outcomes, config.failed_fitness))
        shutil.rmtree(folder, ignore_errors=True)
        partial.rename(folder)

    def robot(self, folder: Path, evaluation: int) -> Robot:
        """Decode the genome of an evaluation."""
        history = History.read(folder)
        return history.robot(history.evaluations[evaluation])

    def load(self, path: Path) -> Robot:
        """Read a robot from its JSON file."""
        return Robot.load(path)


def _to_outcomes(rows: polars.DataFrame) -> Outcomes:
    failure = np.array([FAILURES[label] for label in rows["failure"]], dtype=np.int8)
    numbers = (rows[name].to_numpy() for name in ("distance_m", "energy_j", "simulated_s"))
    return Outcomes(failure, *numbers)
