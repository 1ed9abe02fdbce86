"""A run: ask, evaluate, tell, record, until the generations are through or somebody stops it."""

from __future__ import annotations

import csv
import io
import json
import time
from collections.abc import Callable
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from caterpillar_env.errors import CaterpillarError
from caterpillar_env.gait import GAIT_PERIOD_S, GaitTimings
from caterpillar_env.model import CONTROL_INTERVAL_S, Physics
from caterpillar_env.morphology import Morphology
from caterpillar_env.task import EPISODE_S, Failure
from evolution.distributions import Distribution, Uniform
from evolution.fitness import Outcomes, simulate
from evolution.genome import decode, genes
from evolution.individual import Individual
from evolution.optimizers.ga import GaConfig, GeneticAlgorithm
from evolution.preprocessor import paper_priors

Array = NDArray[np.float64]
Prior = Literal["preprocessed", "uniform"]


class RunError(CaterpillarError):
    """A run cannot start or be read as asked."""


@dataclass(frozen=True)
class RunConfig:
    """Everything that decides what a run computes; threads and folders do not.

    Raises:
        RunError: a value is out of range.
    """

    seed: int = 0  #: of the optimizer; the robot's own is mismatch_seed
    generations: int = 50
    prior: Prior = "preprocessed"  #: what genes are drawn from, at first and by mutation
    floor_ratio: float = 3.0  #: greatest over least density of a preprocessed gene
    failed_fitness: float = 0.0  #: "low fitness" of a robot that fails, in metres
    gait_period_s: float = GAIT_PERIOD_S
    ga: GaConfig = field(default_factory=GaConfig)
    physics: Physics = field(default_factory=Physics)

    def __post_init__(self) -> None:
        if self.seed < 0:
            raise RunError(f"seed = {self.seed} must not be negative")
        if self.generations < 1:
            raise RunError(f"generations = {self.generations} must be at least 1")
        if self.prior not in ("preprocessed", "uniform"):
            raise RunError(f'prior = {self.prior!r} must be "preprocessed" or "uniform"')
        if not 0 <= self.failed_fitness < np.inf:
            raise RunError(f"failed_fitness = {self.failed_fitness} must be finite and not negative")
        paper_priors(self.physics, self.gait_period_s, self.floor_ratio)

    def to_dict(self) -> dict[str, Any]:
        """Plain JSON."""
        return asdict(self)

    def distributions(self) -> list[Distribution]:
        """What each gene is drawn from."""
        rows = paper_priors(self.physics, self.gait_period_s, self.floor_ratio)
        return [row.distribution if self.prior == "preprocessed" else Uniform() for row in rows]

    def evaluations(self) -> int:
        """How many genomes the whole run evaluates."""
        ga = self.ga
        return ga.population + (self.generations - 1) * (ga.population - ga.hall_of_fame)


class Generation(NamedTuple):
    """What is told of each generation."""

    number: int
    best_m: float  #: fitness of the best genome so far
    mean_m: float  #: mean fitness of the genomes evaluated in this generation
    failures: dict[str, int]  #: how many of them failed, by reason
    evaluations: int  #: so far
    simulated_s: float  #: so far
    elapsed_s: float  #: wall time so far


class RunResult(NamedTuple):
    """What a run leaves in memory; the folder holds the same and more."""

    best: Individual | None
    generations: list[Generation]
    finished: bool


def evolve(
    config: RunConfig,
    folder: Path,
    *,
    threads: int = 0,
    on_generation: Callable[[Generation], None] | None = None,
    on_progress: Callable[[float], None] | None = None,
) -> RunResult:
    """Run the genetic algorithm and keep its record in a new folder.

    Writes `config.json`, `evaluations.csv` (as generations finish) and `best.json` (whenever there is a
    better one). A KeyboardInterrupt ends the run after the last whole generation.

    Args:
        config: what to compute.
        folder: made here; must not hold anything yet.
        threads: 0 means all cores; the record does not depend on it.
        on_generation: told of each finished generation.
        on_progress: told the share of the current generation that is done.

    Raises:
        RunError: the folder is not empty or cannot be written.
    """
    _prepare(folder, config)
    optimizer = GeneticAlgorithm(config.distributions(), config.ga, np.random.default_rng(config.seed))
    started = time.monotonic()
    best: Individual | None = None
    history: list[Generation] = []
    evaluations, simulated_s = 0, 0.0
    try:
        for number in range(config.generations):
            genomes = optimizer.ask()
            outcomes, bodies, timings = _evaluate(config, genomes, threads, on_progress)
            fitness = outcomes.fitness(config.failed_fitness)
            optimizer.tell(genomes, fitness)
            _append(folder / "evaluations.csv", number, bodies, timings, outcomes, fitness)
            # The best robot is one that did not fail, whatever a failure is worth.
            crawled = outcomes.fitness(0.0)
            top = int(np.argmax(crawled))
            if crawled[top] > (best.fitness_m or 0.0 if best else 0.0):
                best = Individual.of_genome(
                    genomes[top], config.physics, config.gait_period_s,
                    fitness_m=float(fitness[top]), generation=number,
                )  # fmt: skip
                best.save(folder / "best.json")
            evaluations += len(genomes)
            simulated_s += float(outcomes.simulated_s.sum())
            counts = np.bincount(outcomes.failure, minlength=len(Failure))
            told = Generation(
                number=number,
                best_m=(best.fitness_m or 0.0) if best else 0.0,
                mean_m=float(fitness.mean()),
                failures={f.label: int(counts[f]) for f in Failure if f is not Failure.NONE},
                evaluations=evaluations,
                simulated_s=simulated_s,
                elapsed_s=time.monotonic() - started,
            )
            history.append(told)
            if on_generation is not None:
                on_generation(told)
    except KeyboardInterrupt:
        return RunResult(best, history, finished=False)
    return RunResult(best, history, finished=True)


def _prepare(folder: Path, config: RunConfig) -> None:
    try:
        folder.mkdir(parents=True, exist_ok=True)
        if any(folder.iterdir()):
            raise RunError(f"{folder} is not empty; choose another folder with --out")
        text = json.dumps(config.to_dict(), indent=2) + "\n"
        (folder / "config.json").write_text(text, encoding="utf-8")
        names = [g.name for g in genes(config.physics.num_segments, config.gait_period_s)]
        with (folder / "evaluations.csv").open("w", newline="", encoding="utf-8") as file:
            csv.writer(file, lineterminator="\n").writerow([*_COLUMNS, *names])
    except OSError as error:
        raise RunError(
            f"cannot write the run folder {folder}: {error.strerror}; choose another with --out"
        ) from None


_COLUMNS = (
    "generation", "index", "failure", "fitness_m", "distance_m", "energy_j", "simulated_s",
)  # fmt: skip


def _evaluate(
    config: RunConfig,
    genomes: Array,
    threads: int,
    on_progress: Callable[[float], None] | None,
) -> tuple[Outcomes, list[Morphology], GaitTimings]:
    bodies, timings = decode(genomes, config.physics.num_segments, config.gait_period_s)
    done = 0

    def tick(_: object) -> None:
        nonlocal done
        done += 1
        if on_progress is not None:
            on_progress(done * CONTROL_INTERVAL_S / EPISODE_S)

    outcomes = simulate(bodies, timings, config.physics, threads=threads, on_interval=tick)
    return outcomes, bodies, timings


def _append(
    path: Path,
    generation: int,
    bodies: list[Morphology],
    timings: GaitTimings,
    outcomes: Outcomes,
    fitness: Array,
) -> None:
    """One row per evaluation, SI units; repr keeps every bit of a float."""
    times = np.stack([timings.on_s, timings.off_s], axis=-1).reshape(len(bodies), -1)
    rows = io.StringIO()
    writer = csv.writer(rows, lineterminator="\n")
    for i, body in enumerate(bodies):
        writer.writerow(
            [generation, i, Failure(outcomes.failure[i]).label]
            + [repr(float(a[i])) for a in (fitness, *outcomes[1:])]
            + [repr(float(v)) for v in (*body.to_array(), *times[i])]
        )
    with path.open("a", newline="", encoding="utf-8") as file:
        file.write(rows.getvalue())
