"""Looking at the records of runs: the subcommands `export` and `runs`."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import numpy as np
import tyro
from rich.console import Console
from rich.table import Table

from caterpillar_env.errors import CaterpillarError
from evolution import cli
from evolution.genome import decode
from evolution.individual import Individual
from evolution.journal import FILE, Journal, JournalError, is_in_use, outcomes_of
from evolution.run import read_configuration, scores

if TYPE_CHECKING:
    import polars

Format = Literal["csv", "parquet", "json"]


def table(folder: Path) -> polars.DataFrame:
    """A row per evaluation of a run: outcome, fitness as the optimizer was told it, genes in SI units.

    Fitness by an objective of the user's own is in no journal, and empty.

    Raises:
        JournalError: no journal, damaged, or of a newer version.
    """
    import polars

    with Journal(folder, read_only=True) as journal:
        config, own = read_configuration(journal)
        rows = list(journal.evaluations())
    names = [g.name for g in config.genes()]
    genomes = np.array([e.genome for e in rows]).reshape(-1, len(names))
    bodies, timings = decode(genomes, config.physics.num_segments, config.gait_period_s, config.genome)
    times = np.stack([timings.on_s, timings.off_s], axis=-1)
    times = times.reshape(len(rows), 2 * timings.on_s.shape[1])
    segments = [m.to_array() for b in bodies for m in (b if isinstance(b, tuple) else (b,))]
    values = np.reshape(segments, (len(rows), len(names) - times.shape[1]))
    values = np.concatenate([values, times], axis=1)
    outcomes = outcomes_of(rows)
    columns: dict[str, Any] = {
        "evaluation": np.array([e.number for e in rows], dtype=np.int64),
        "generation": np.array([e.generation for e in rows], dtype=np.int64),
        "failure": [e.failure.label for e in rows],
        "fitness": scores(outcomes, config) if own.objective is None else [None] * len(rows),
        "distance_m": outcomes.distance_m,
        "energy_j": outcomes.energy_j,
        "simulated_s": outcomes.simulated_s,
        "session": np.array([e.session for e in rows], dtype=np.int64),
    }
    return polars.DataFrame(columns | {name: values[:, i] for i, name in enumerate(names)})


def leaders(folder: Path) -> list[Individual]:
    """The best robot of a run so far after each of its generations; `generation` is its own.

    As long as nobody has crawled forwards without failing, it is the one that came furthest.

    Raises:
        JournalError: no journal, damaged, of a newer version, or without any evaluation.
    """
    with Journal(folder, read_only=True) as journal:
        config, _ = read_configuration(journal)
        rows = list(journal.evaluations())
    if not rows:
        raise JournalError(f"{folder} holds no evaluations yet; `caterpillar resume {folder}` goes on")
    outcomes = outcomes_of(rows)
    crawled = scores(outcomes, replace(config, failed_fitness=0.0))
    merits = list(zip(crawled.tolist(), outcomes.distance_m.tolist(), strict=True))
    fitness_m = outcomes.fitness()
    best, found = 0, []
    for number, row in enumerate(rows):
        if merits[number] > merits[best]:
            best = number
        if number + 1 == len(rows) or rows[number + 1].generation != row.generation:
            found.append(
                Individual.of_genome(
                    rows[best].genome,
                    config.physics,
                    config.gait_period_s,
                    config.genome,
                    fitness_m=float(fitness_m[best]),
                    generation=rows[best].generation,
                )
            )
    return found


@dataclass(frozen=True)
class ExportArgs:
    """Write the evaluations of a run as a table, one row each, genes in SI units."""

    folder: Annotated[Path, tyro.conf.Positional]
    """The run folder."""
    to: Format = "csv"
    """Kind of file."""
    out: Path | None = None
    """File to write; by default evaluations.csv, .parquet or .json in the run folder."""


def export_command(argv: Sequence[str]) -> int:
    """`caterpillar export`."""
    args = cli.parse(ExportArgs, argv, "export")
    rows = table(args.folder)
    out = args.out or args.folder / f"evaluations.{args.to}"
    try:
        with out.open("wb") as file:
            getattr(rows, f"write_{args.to}")(file)
    except OSError as error:
        raise CaterpillarError(
            f"cannot write {out}: {error.strerror}; choose another file with --out"
        ) from None
    print(f"{len(rows)} evaluations in {out}", file=sys.stderr)
    return 0


@dataclass(frozen=True)
class RunsArgs:
    """List the runs in a folder: what they are, how far they are, how good."""

    folder: Annotated[Path, tyro.conf.Positional] = Path("runs")
    """Where to look, the folders in it too."""
    json: bool = False
    """Print data instead of a table."""


def runs_command(argv: Sequence[str]) -> int:
    """`caterpillar runs`."""
    args = cli.parse(RunsArgs, argv, "runs")
    if not args.folder.is_dir():
        raise CaterpillarError(f"{args.folder} is no folder; give the one that holds the runs")
    found = [_summary(path.parent) for path in sorted(args.folder.glob(f"**/{FILE}"))]
    if args.json:
        print(json.dumps(found, indent=2))
        return 0
    if not found:
        print(f"no runs in {args.folder}", file=sys.stderr)
        return 0
    shown = Table()
    for heading in found[0]:
        shown.add_column(heading)
    for row in found:
        shown.add_row(*("" if value is None else str(value) for value in row.values()))
    Console(width=None if sys.stdout.isatty() else 150).print(shown)
    return 0


def _summary(folder: Path) -> dict[str, Any]:
    row: dict[str, Any] = dict.fromkeys(
        ("run", "state", "optimizer", "prior", "seed", "generation", "evaluations", "best, mm")
    )
    row["run"] = str(folder)
    try:
        with Journal(folder, read_only=True) as journal:
            config, own = read_configuration(journal)
            evaluations = list(journal.evaluations())
            finished = journal.finished
    except JournalError as error:
        row["state"] = str(error)
        return row
    done = 1 + evaluations[-1].generation if evaluations else 0
    row |= {
        "state": "running" if is_in_use(folder) else "finished" if finished else "stopped",
        "optimizer": own.optimizer or config.optimizer,
        "prior": config.prior,
        "seed": config.seed,
        "generation": f"{done} of {config.generations}" if config.budget_s is None else str(done),
        "evaluations": len(evaluations),
        "best, mm": _best_mm(folder),
    }
    return row


def _best_mm(folder: Path) -> float | None:
    try:
        fitness_m = Individual.load(folder).fitness_m
    except CaterpillarError:
        return None  # nobody has crawled forwards yet
    return None if fitness_m is None else round(1000 * fitness_m, 1)
