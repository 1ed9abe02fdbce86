"""The record of a run, read: a table of its evaluations, and its best robots."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from caterpillar_env.robot import Robot
from evolution.genome import gene_values
from evolution.run.database import JournalError
from evolution.run.journal import Journal, outcomes_of
from evolution.run.loop import read_configuration
from evolution.run.objective import scores

if TYPE_CHECKING:
    import polars


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
    encoding = config.encoding
    names = [gene.name for gene in encoding.genes]
    values = np.empty((0, len(names)))
    if rows:
        values = gene_values(*encoding.decode(np.array([e.genome for e in rows])))
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


def leaders(folder: Path) -> list[Robot]:
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
                config.encoding.robot(
                    rows[best].genome,
                    fitness_m=float(fitness_m[best]),
                    generation=rows[best].generation,
                )
            )
    return found
