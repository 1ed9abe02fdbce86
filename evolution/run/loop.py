"""A run: ask, evaluate, record and tell, until the last generation, the target or the budget is reached.

Resuming is replaying: the optimizer is made anew and asks the same questions, which the journal answers
as far as it goes.
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable, Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from caterpillar_env.arrays import Array
from caterpillar_env.errors import CaterpillarError
from caterpillar_env.files import make_folder
from caterpillar_env.robot import Outcomes, Robot
from caterpillar_env.task import Failure
from evolution.config import RunConfig
from evolution.optimizers.base import Optimizer
from evolution.run.evaluators import CHUNK, Evaluator, LocalEvaluator
from evolution.run.journal import Evaluation, Journal, fingerprint, outcomes_of
from evolution.run.objective import Score, scores


class RunError(CaterpillarError):
    """A run cannot start, go on or be read as asked."""


class Generation(NamedTuple):
    """What is told of each generation."""

    number: int
    best_m: float  #: distance of the best robot so far
    mean_m: float  #: mean distance of the genomes evaluated in this generation, 0 for a failure
    failures: dict[str, int]  #: how many of them failed, by reason
    evaluations: int  #: so far
    simulated_s: float  #: so far
    elapsed_s: float  #: wall time of this session so far
    replayed: bool = False  #: whether all of it came out of the journal
    farthest_m: float = 0.0  #: greatest distance so far of a robot that did not fail; of any objective


class RunResult(NamedTuple):
    """What a run leaves in memory; the folder holds the same and more."""

    best: Robot | None
    generations: list[Generation]
    finished: bool


Told = Callable[[Generation], None]


class Own(NamedTuple):
    """Names of what drove a run from outside of its configuration; None where nothing did."""

    optimizer: str | None = None
    objective: str | None = None


def evolve(
    config: RunConfig,
    folder: Path,
    *,
    evaluator: Evaluator | None = None,
    optimizer: Optimizer | None = None,
    objective: Score | None = None,
    on_generation: Told | None = None,
    on_progress: Callable[[float], None] | None = None,
) -> RunResult:
    """Run an optimizer and keep its record in a new folder.

    Writes `journal.sqlite` (as evaluations finish) and `best.json` (whenever there is a better robot). A
    KeyboardInterrupt ends the run; `resume` goes on where it ended. `config.target_m` ends it after the
    first generation in which a robot gets that far without failing.

    Args:
        config: what to compute.
        folder: made here; must not hold anything yet.
        evaluator: where to compute it; all threads of this machine by default.
        optimizer: one of your own instead of `config.optimizer`: it asks for genomes in [0, 1] and is
            told their fitness, see `evolution.optimizers.base.Optimizer`.
        objective: one of your own instead of `config.objective`: takes the `Outcomes` of P robots, gives
            their fitness, (P,), finite and not negative. What it gives for a failure is replaced by
            `config.failed_fitness`.
        on_generation: told of each finished generation.
        on_progress: told the share of the current generation that is done.

    Raises:
        FileError: the folder is not empty or cannot be written.
        GenomeError: the optimizer asks for what is no genome.
        RunError: an objective of your own gives something else than told above.
        EvaluationError: an evaluation raised an exception.
    """
    own = Own(
        None if optimizer is None else type(optimizer).__qualname__,
        None if objective is None else getattr(objective, "__qualname__", type(objective).__qualname__),
    )
    with evaluator or LocalEvaluator() as workers:  # a cluster that is not there leaves no folder behind
        make_folder(folder, f", or go on with a run by `caterpillar resume {folder}`")
        with Journal.create(folder, _described(config, own)) as journal:
            return _run(journal, config, optimizer, objective, workers, on_generation, on_progress)


def resume(
    folder: Path,
    *,
    generations: int | None = None,
    evaluator: Evaluator | None = None,
    optimizer: Optimizer | None = None,
    objective: Score | None = None,
    on_generation: Told | None = None,
    on_progress: Callable[[float], None] | None = None,
    on_warning: Callable[[str], None] | None = None,
) -> RunResult:
    """Go on with a run, or go through a finished one again; one at its target evaluates nothing more.

    Args:
        folder: the run folder.
        generations: a new number of generations, for a run that is to go on for longer.
        evaluator: see `evolve`.
        optimizer: the optimizer at its beginning, where the run was driven by one of your own.
        objective: likewise.
        on_generation: see `evolve`; generations out of the journal are told too.
        on_progress: see `evolve`.
        on_warning: told what may make the result another than that of the uninterrupted run.

    Raises:
        JournalError: no journal, in use by another process, damaged, or of a newer version.
        RunError: the optimizer asks for other genomes than those of the journal.
    """
    with Journal(folder) as journal:
        config, own = read_configuration(journal)
        for what, name, given in zip(Own._fields, own, (optimizer, objective), strict=True):
            if name is not None and given is None:
                raise RunError(
                    f"{folder} was driven by an {what} of your own ({name}); resume it from Python with "
                    f"evolution.run.loop.resume(folder, {what}=...)"
                )
        if generations is not None:
            if generations < config.generations:
                raise RunError(
                    f"a run can only be made longer: generations is {config.generations} so far, and "
                    f"{generations} is less"
                )
            config = replace(config, generations=generations)
            journal.configure(_described(config, own))
        if on_warning is not None:
            _warn_of_versions(journal, on_warning)
        with evaluator or LocalEvaluator() as workers:
            return _run(journal, config, optimizer, objective, workers, on_generation, on_progress)


def read_configuration(journal: Journal) -> tuple[RunConfig, Own]:
    """The configuration, and the names of what was the user's own."""
    data = journal.configuration
    own = Own(*(data.pop(f"own_{what}", None) for what in Own._fields))
    return RunConfig.from_dict(data), own


def _described(config: RunConfig, own: Own) -> dict[str, Any]:
    return config.to_dict() | {f"own_{what}": name for what, name in own._asdict().items()}


def _warn_of_versions(journal: Journal, warn: Callable[[str], None]) -> None:
    now = fingerprint()
    for number, _, _, then in journal.sessions:
        other = [f"{k} {then.get(k)} (now {v})" for k, v in now.items() if then.get(k) != v]
        if other:
            rows = [e.number for e in journal.evaluations() if e.session == number]
            which = f"evaluations {rows[0]} to {rows[-1]}" if rows else "no evaluations"
            warn(
                f"session {number} ({which}) ran under {', '.join(other)}: from here on the run may "
                "differ in the last bits, and then altogether, from one under one version"
            )


def _run(
    journal: Journal,
    config: RunConfig,
    optimizer: Optimizer | None,
    objective: Score | None,
    workers: Evaluator,
    on_generation: Told | None,
    on_progress: Callable[[float], None] | None,
) -> RunResult:
    optimizer, encoding = optimizer or config.make_optimizer(), config.encoding
    known = list(journal.evaluations())
    session = journal.begin()
    record = _Record(config, objective, journal.path.parent)
    try:
        while config.ending(len(record.history), record.simulated_s, record.farthest_m) is None:
            number = len(record.history)
            genomes = encoding.check(optimizer.ask())
            first = record.evaluations
            parts = _replayed(known[first : first + len(genomes)], genomes, journal.path)
            replayed = sum(len(part.failure) for part in parts)
            for outcomes in _evaluated(config, genomes[replayed:], workers, on_progress):
                done = sum(len(part.failure) for part in parts)
                part_of = genomes[done : done + len(outcomes.failure)]
                journal.append(first + done, number, part_of, outcomes, session)
                parts.append(outcomes)
            outcomes = Outcomes(*(np.concatenate(column) for column in zip(*parts, strict=True)))
            optimizer.tell(genomes, scores(outcomes, config, objective))
            told = record.add(number, genomes, outcomes, replayed=replayed == len(genomes))
            if on_generation is not None:
                on_generation(told)
        journal.finish(session)
    except KeyboardInterrupt:
        return RunResult(record.best, record.history, finished=False)
    return RunResult(record.best, record.history, finished=True)


def _replayed(known: Sequence[Evaluation], genomes: Array, path: Path) -> list[Outcomes]:
    """The journal's answers to the first of these genomes."""
    for evaluation, genome in zip(known, genomes, strict=False):
        if not np.array_equal(evaluation.genome, genome):
            raise RunError(
                f"evaluation {evaluation.number} in {path} is of another genome than the optimizer asks "
                "for now: the package or NumPy has changed since, or it belongs to another run. "
                "Install the versions of its table `sessions`, or start anew"
            )
    return [outcomes_of(known)] if known else []


def _evaluated(
    config: RunConfig,
    genomes: Array,
    workers: Evaluator,
    on_progress: Callable[[float], None] | None,
) -> Iterator[Outcomes]:
    if not len(genomes):
        return
    chunks = [genomes[i : i + CHUNK] for i in range(0, len(genomes), CHUNK)]
    done = 0

    def progress(share: float) -> None:
        if on_progress is not None:
            on_progress((done + share * min(CHUNK, len(genomes) - done)) / len(genomes))

    for outcomes in workers.map(config.encoding, chunks, progress):
        yield outcomes
        done += len(outcomes.failure)


def history(config: RunConfig, evaluations: Sequence[Evaluation]) -> list[Generation]:
    """What was told of the generations of a record; their wall time is not in it."""
    record = _Record(config)
    for number, rows in itertools.groupby(evaluations, key=lambda e: e.generation):
        generation = list(rows)
        genomes = np.array([e.genome for e in generation])
        record.add(number, genomes, outcomes_of(generation), replayed=True)
    return record.history


class _Record:
    """What has come out so far; the best robot is kept in a file, where there is a folder."""

    def __init__(
        self, config: RunConfig, objective: Score | None = None, folder: Path | None = None
    ) -> None:
        self._config, self._objective, self._folder = config, objective, folder
        self._started = time.monotonic()
        self._top = 0.0
        self.best: Robot | None = None
        self.history: list[Generation] = []
        self.evaluations, self.simulated_s, self.farthest_m = 0, 0.0, 0.0

    def add(self, number: int, genomes: Array, outcomes: Outcomes, *, replayed: bool) -> Generation:
        config = self._config
        # The best robot is one that did not fail, whatever a failure is worth.
        crawled = scores(outcomes, replace(config, failed_fitness=0.0), self._objective)
        top = int(np.argmax(crawled))
        if crawled[top] > self._top:
            self._top = float(crawled[top])
            fitness_m = float(outcomes.distance_m[top])
            self.best = config.encoding.robot(genomes[top], fitness_m=fitness_m, generation=number)
            if self._folder is not None:
                self.best.save(self._folder / "best.json")
        self.evaluations += len(genomes)
        self.simulated_s += float(outcomes.simulated_s.sum())
        self.farthest_m = max(self.farthest_m, float(outcomes.fitness(0.0).max()))
        counts = np.bincount(outcomes.failure, minlength=len(Failure))
        told = Generation(
            number=number,
            best_m=(self.best.fitness_m or 0.0) if self.best else 0.0,
            mean_m=float(outcomes.fitness(0.0).mean()),
            failures={f.label: int(counts[f]) for f in Failure if f is not Failure.NONE},
            evaluations=self.evaluations,
            simulated_s=self.simulated_s,
            elapsed_s=time.monotonic() - self._started,
            replayed=replayed,
            farthest_m=self.farthest_m,
        )
        self.history.append(told)
        return told
