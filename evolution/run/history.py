"""The history of a run: the content of its journal, and the summaries made from it."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from caterpillar_env.arrays import Array
from caterpillar_env.errors import CaterpillarError
from caterpillar_env.morphology import NAMES, Morphology
from caterpillar_env.robot import Outcomes, Robot
from caterpillar_env.task import Failure
from evolution.config import RunConfig
from evolution.objective import OBJECTIVES, Objective, distance, find_best, score, stopped
from evolution.run.database import damaged
from evolution.run.journal import Completion, Evaluation, Journal

if TYPE_CHECKING:
    import polars


class Generation(NamedTuple):
    """Summary of a completed generation."""

    number: int
    best_m: float  #: distance of the best robot so far; 0 if there is none
    mean_m: float  #: mean distance of its robots that were not stopped early; a failure counts as 0
    failures: dict[str, int]  #: number of genomes of this generation that failed, by failure
    evaluations: int  #: number of evaluations of the run so far
    simulated_s: float  #: simulated time of the run so far, s
    replayed: bool = False  #: whether all of its evaluations were in the journal already
    farthest_m: float = 0.0  #: largest distance so far of a robot that did not fail
    stopped: int = 0  #: number of genomes of this generation that racing stopped early


class History:
    """The evaluations, generations and best robot of a run.

    Read a run with `History.read(folder)`. To record a run, repeat for each generation: find out with
    `count_recorded` how many evaluations the journal has already, `append` the others, then `complete`
    the generation.

    Args:
        journal: open journal of the run.
        objective: the user's own objective, if the run maximizes one.
    """

    def __init__(self, journal: Journal, objective: Objective | None = None) -> None:
        self._journal, self._objective = journal, objective
        self.folder = journal.path.parent
        self.configuration = journal.configuration
        self.kind: str = self.configuration.get("kind", "evolution")  #: or "training"
        #: Names of the user's own optimizer and objective, if the run has them.
        self.own_optimizer: str | None = self.configuration.get("own_optimizer")
        self.own_objective: str | None = self.configuration.get("own_objective")
        self.sessions = journal.sessions
        # Read these before the evaluations, because another process may complete a generation meanwhile.
        self._completions = journal.generations()
        self.evaluations: list[Evaluation] = list(journal.evaluations())
        if self._completions and len(self.evaluations) < self._completions[-1].evaluations:
            raise damaged(journal.path, f"evaluation {len(self.evaluations)} is missing")
        self._recorded = len(self.evaluations)  # number of evaluations of earlier sessions
        self.generations: list[Generation] = []
        self.best: Evaluation | None = None  #: the best evaluation so far, see `objective.find_best`

    @classmethod
    def read(cls, folder: Path | str) -> History:
        """Read the journal of a run folder, even while another process writes to it.

        Raises:
            JournalError: the journal cannot be read, see `Journal`.
        """
        with Journal(Path(folder), read_only=True) as journal:
            history = cls(journal)
        for _ in range(len(history._completions)):
            history._advance()
        return history

    @cached_property
    def objective(self) -> Objective:
        """The objective that defines the best robot.

        This is the user's own objective if it was given to `History`, else the configured one. Training
        runs maximize the distance.
        """
        if self._objective is not None:
            return self._objective
        return OBJECTIVES[self.config.objective] if self.kind == "evolution" else distance

    @property
    def finished(self) -> bool:
        """Whether the run ended in its last session."""
        return bool(self.sessions) and self.sessions[-1].finished is not None

    @cached_property
    def config(self) -> RunConfig:
        """The configuration of an evolutionary run.

        Raises:
            CaterpillarError: the folder holds a training run.
        """
        if self.kind != "evolution":
            raise CaterpillarError(
                f"{self.folder} holds a {self.kind} run, not an evolutionary run; use `caterpillar rl`"
            )
        data = {k: v for k, v in self.configuration.items() if not k.startswith("own_")}
        try:
            return RunConfig.from_dict(data)
        except CaterpillarError as error:
            raise CaterpillarError(f"{self._journal.path}: {error}") from None

    def change(self, **fields: Any) -> None:
        """Change fields of the configuration, such as `generations`. `begin` records the changes."""
        self.config = replace(self.config, **fields)
        self.configuration |= self.config.to_dict()

    def begin(self, packages: Sequence[str] = ()) -> None:
        """Begin a session, see `Journal.begin`."""
        changed = self.configuration != self._journal.configuration
        self._journal.begin(packages, self.configuration if changed else None)
        self.sessions = self._journal.sessions

    @property
    def replaying(self) -> bool:
        """Whether the next generation is complete in the journal."""
        return len(self.generations) < len(self._completions)

    @property
    def simulated_s(self) -> float:
        """Simulated time of the completed generations, s."""
        return self.generations[-1].simulated_s if self.generations else 0.0

    @property
    def farthest_m(self) -> float:
        """Largest distance of a robot that did not fail, in m; 0 if there is none."""
        return self.generations[-1].farthest_m if self.generations else 0.0

    def stop_reason(self, generations: int | None = None) -> str | None:
        """Return why the run is over, or None if another generation follows.

        Args:
            generations: total number of generations; by default, the configured one.
        """
        config = self.config
        if generations is not None:
            config = replace(config, generations=generations)
        return config.stop_reason(len(self.generations), self.simulated_s, self.farthest_m)

    @property
    def best_robot(self) -> Robot | None:
        """The best robot so far, or None if no robot qualifies; see `objective.find_best`."""
        return None if self.best is None else self.robot(self.best)

    def robot(self, evaluation: Evaluation) -> Robot:
        """Return the robot of an evaluation, with its recorded results."""
        return self.config.encoding.robot(
            evaluation.genome, fitness_m=evaluation.fitness_m, generation=evaluation.generation,
            evaluation=evaluation.number,
        )  # fmt: skip

    def leaders(self) -> list[Robot]:
        """Return the best robot so far after each completed generation.

        Until a robot qualifies as the best, the robot with the largest distance takes its place.

        Raises:
            CaterpillarError: no generation is complete.
        """
        if not self.generations:
            raise CaterpillarError(
                f"{self.folder} has no completed generation; continue with "
                f"`caterpillar resume {shlex.quote(str(self.folder))}`"
            )
        leaders = []
        for completion in self._completions[: len(self.generations)]:
            if completion.best is None:
                before = self.evaluations[: completion.evaluations]
                leader = max(before, key=lambda e: e.distance_m)
            else:
                leader = self.evaluations[completion.best]
            leaders.append(self.robot(leader))
        return leaders

    def table(self) -> polars.DataFrame:
        """Return one row per evaluation: outcome, fitness and all genes in SI units.

        The fitness is null in training runs, and in runs that maximize the user's own objective.
        """
        import polars

        names, values = self._gene_values()
        outcomes = to_outcomes(self.evaluations)
        fitness: Any = [None] * len(self.evaluations)
        if self.kind == "evolution" and self.own_objective is None:
            fitness = score(self.objective, outcomes, self.config.failed_fitness)
        columns: dict[str, Any] = {
            "evaluation": np.array([e.number for e in self.evaluations], dtype=np.int64),
            "generation": np.array([e.generation for e in self.evaluations], dtype=np.int64),
            "failure": [e.failure.label for e in self.evaluations],
            "stopped": stopped(outcomes),
            "fitness": fitness,
            "distance_m": outcomes.distance_m,
            "energy_j": outcomes.energy_j,
            "simulated_s": outcomes.simulated_s,
            "session": np.array([e.session for e in self.evaluations], dtype=np.int64),
        }
        return polars.DataFrame(columns | {name: values[:, i] for i, name in enumerate(names)})

    def _gene_values(self) -> tuple[list[str], Array]:
        """Return gene names, and values (E, n) in SI units. Training runs have morphology genes only."""
        genomes = [e.genome for e in self.evaluations]
        if self.kind == "training":
            if genomes and len(genomes[0]) != len(NAMES):
                raise damaged(self._journal.path, "the bodies have the wrong number of genes")
            bodies = [Morphology.from_unit(genome).to_array() for genome in genomes]
            return list(NAMES), np.reshape(bodies, (len(genomes), len(NAMES)))
        names = [gene.name for gene in self.config.encoding.genes]
        if not genomes:
            return names, np.empty((0, len(names)))
        return names, self.config.encoding.values(np.array(genomes))

    def count_recorded(self, genomes: Array) -> int:
        """Return how many genomes (P, n) of the next generation are in the journal already.

        Raises:
            CaterpillarError: the journal has different genomes, or another number of genomes.
        """
        recorded, number = self._next_rows(), len(self.generations)
        differing = (
            evaluation.number
            for evaluation, genome in zip(recorded, genomes, strict=False)
            if not np.array_equal(evaluation.genome, genome)
        )
        if len(recorded) > len(genomes) or (self.replaying and len(recorded) < len(genomes)):
            difference = (
                f"generation {number} in {self._journal.path} has {len(recorded)} genomes, but the "
                f"optimizer proposes {len(genomes)} genomes now"
            )
        elif (first := next(differing, None)) is not None:
            difference = (
                f"evaluation {first} in {self._journal.path} has a different genome from the one that "
                "the optimizer proposes now"
            )
        else:
            return len(recorded)
        raise CaterpillarError(
            f"{difference}. The package, NumPy or your own optimizer has changed, or the journal "
            "belongs to a different run. Install the package versions listed in the journal's table "
            "`sessions`, or start a new run"
        )

    def append(self, genomes: Array, outcomes: Outcomes) -> None:
        """Record evaluations of the next generation: genomes (P, n) in [0, 1] and their outcomes."""
        first, generation, session = len(self.evaluations), len(self.generations), len(self.sessions)
        columns = (column.tolist() for column in outcomes)
        rows = [
            Evaluation._make((first + i, generation, genome, Failure(failure), *values, session))
            for i, (genome, failure, *values) in enumerate(zip(genomes, *columns, strict=True))
        ]
        self._journal.append(rows)
        self.evaluations += rows

    def complete(self) -> Outcomes:
        """Complete the next generation, and return the outcomes of its genomes.

        This records the completion, and writes the best robot to best.json if it changed.
        """
        number, before, replayed = len(self.generations), self.best, self.replaying
        outcomes = self._advance()
        if self.best is not None and self.kind == "evolution":
            file = self.folder / "best.json"
            is_better = self.best is not before and not replayed
            is_missing = not self.replaying and not file.exists()
            if is_better or is_missing:
                advice = f"free some space and run `caterpillar resume {shlex.quote(str(self.folder))}`"
                self.robot(self.best).save(file, advice)
        if not replayed:  # last, so that a resumed run repeats a failed write of best.json
            self._journal.complete(self._completions[number])
        return outcomes

    def finish(self) -> None:
        """Record that the run has ended."""
        self._journal.finish()
        self.sessions = self._journal.sessions

    def _next_rows(self) -> list[Evaluation]:
        """Return the evaluations of the next generation that are already in the journal."""
        first = self.generations[-1].evaluations if self.generations else 0
        number, end = len(self.generations), first
        while end < len(self.evaluations) and self.evaluations[end].generation == number:
            end += 1
        return self.evaluations[first:end]

    def _find_completion(self, rows: Sequence[Evaluation], outcomes: Outcomes) -> Completion:
        """Return the completion of the next generation, given all of its evaluations."""
        number, end, best, value = len(self.generations), rows[-1].number + 1, None, None
        if self._completions:
            best, value = self._completions[-1].best, self._completions[-1].value
        found = find_best(self.objective, outcomes)
        if found is not None and (value is None or found[1] > value):
            best, value = rows[found[0]].number, found[1]
        return Completion(number, end, best, value)

    def _advance(self) -> Outcomes:
        """Add the next generation to `generations`, update `best`, and return the outcomes."""
        number, rows = len(self.generations), self._next_rows()
        if not rows:
            raise damaged(self._journal.path, f"generation {number} has no evaluations")
        outcomes = to_outcomes(rows)
        if number == len(self._completions):
            self._completions.append(self._find_completion(rows, outcomes))
        completion = self._completions[number]
        if rows[-1].number + 1 != completion.evaluations or (completion.best or 0) > rows[-1].number:
            raise damaged(self._journal.path, f"generation {number} does not match its evaluations")
        if completion.best is not None:
            self.best = self.evaluations[completion.best]
        early = stopped(outcomes)
        crawled_m = outcomes.fitness()[~early]
        counts = np.bincount(outcomes.failure, minlength=len(Failure))
        self.generations.append(
            Generation(
                number=number,
                best_m=0.0 if self.best is None else max(self.best.distance_m, 0.0),
                mean_m=float(crawled_m.mean()),
                failures={f.label: int(counts[f]) for f in Failure if f is not Failure.NONE},
                evaluations=completion.evaluations,
                simulated_s=self.simulated_s + float(outcomes.simulated_s.sum()),
                replayed=rows[-1].number < self._recorded,
                farthest_m=max(self.farthest_m, crawled_m.max(initial=0.0)),
                stopped=int(early.sum()),
            )
        )
        return outcomes


def to_outcomes(evaluations: Sequence[Evaluation]) -> Outcomes:
    """Return the outcomes of P recorded evaluations as arrays of shape (P,)."""
    return Outcomes(
        np.array([e.failure for e in evaluations], dtype=np.int8),
        np.array([e.distance_m for e in evaluations], dtype=np.float64),
        np.array([e.energy_j for e in evaluations], dtype=np.float64),
        np.array([e.simulated_s for e in evaluations], dtype=np.float64),
    )


load = History.read
