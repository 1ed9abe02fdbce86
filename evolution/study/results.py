"""Results of a study: evaluations of its finished runs, and the progress of each run."""

from __future__ import annotations

import os
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import polars
from numpy.typing import NDArray

from caterpillar_env.arrays import Array
from caterpillar_env.errors import CaterpillarError, show, to_number
from caterpillar_env.files import read, write_json
from evolution.run.database import JournalError
from evolution.run.history import History
from evolution.study.config import Cell, StudyConfig

DATA = "evaluations.parquet"  #: name of the file with all evaluations of a study
_KEEP = "restore a copy of it, or remove it if the folders of all runs are there"
_OUTCOME = ("evaluation", "generation", "failure", "stopped", "distance_m", "energy_j", "simulated_s")


class Results(NamedTuple):
    """Evaluations of the finished runs of a study."""

    table: polars.DataFrame  #: one row per evaluation: arm, seed, outcome, genes in SI units
    missing: list[Cell]  #: runs that are not finished


def read_finished(config: StudyConfig, cell: Cell, study: Path) -> History | None:
    """Read a run of a study, or return None if it is missing, unfinished or unreadable.

    Raises:
        CaterpillarError: the run was made with different settings.
    """
    folder = cell.folder(study)
    try:
        history = History.read(folder)
    except JournalError:
        return None  # running this cell reports the error
    if not config.arms[cell.arm].matches(history, cell.seed, config.budget_s):
        raise CaterpillarError(
            f"{folder} was run with other settings; choose another folder for the study, or remove it"
        )
    return history if history.finished else None


def read_kept(folder: Path) -> dict[Cell, polars.DataFrame]:
    """Read the evaluations of the runs that an earlier `collect` wrote into the file `DATA`."""
    file = folder / DATA
    if not file.is_file():
        return {}
    try:
        table = polars.read_parquet(file)
        if missing := {"arm", "seed", *_OUTCOME} - {"stopped"} - set(table.columns):
            raise CaterpillarError(f"{file} has no columns {', '.join(sorted(missing))}; {_KEEP}")
        return dict(_split(table))
    except (OSError, polars.exceptions.PolarsError) as error:
        raise CaterpillarError(f"cannot read {file}: {error}; {_KEEP}") from None


def collect(config: StudyConfig, folder: Path) -> Results:
    """Read all finished runs of a study, and write their evaluations into the file `DATA`.

    Runs whose folders were deleted are taken from this file if an earlier call wrote it.
    """
    file, kept = folder / DATA, read_kept(folder)
    tables, missing, new = [], [], False
    for cell in config.cells():
        history = read_finished(config, cell, folder)
        if history is not None:
            new = True
            tables.append(_to_table(cell, history))
        elif cell in kept:
            tables.append(kept[cell])
        else:
            missing.append(cell)
    table = polars.concat(tables, how="diagonal") if tables else polars.DataFrame()
    if new:
        partial = folder / f".{DATA}.partial"
        table.write_parquet(partial, compression="zstd", compression_level=19)
        os.replace(partial, file)
    return Results(table, missing)


def _to_table(cell: Cell, history: History) -> polars.DataFrame:
    rows = history.table()
    genes = rows.columns[rows.columns.index("session") + 1 :]
    return rows.select(
        polars.lit(cell.arm).alias("arm"),
        polars.lit(cell.seed, polars.Int64).alias("seed"),
        polars.col(_OUTCOME),
        polars.col(genes).cast(polars.Float32),
    )


def _split(table: polars.DataFrame) -> Iterator[tuple[Cell, polars.DataFrame]]:
    """Yield the rows of each run, ordered by evaluation."""
    if table.is_empty():
        return
    for (arm, seed), rows in table.group_by("arm", "seed", maintain_order=True):
        yield Cell(str(arm), int(seed)), rows.sort("evaluation")


class Run(NamedTuple):
    """Progress of one run, in arrays over its E evaluations within the budget."""

    seed: int
    spent_s: Array  #: simulated seconds after each evaluation, (E,)
    best_m: Array  #: largest distance so far of a robot that did not fail, at least 0, (E,)
    failure: NDArray[Any]  #: "ok" or the kind of failure, (E,)
    generation: NDArray[np.int64]  #: number of the generation, (E,)
    generations: int  #: number of generations completed within the budget

    def time_to(self, distance_m: float) -> float:
        """Return the simulated time (s) at which the run reaches a distance; infinite if never."""
        reached = self.spent_s[self.best_m >= distance_m]
        return float(reached[0]) if reached.size else float("inf")

    def at_generation(self, number: int) -> float:
        """Return the best distance (m) at the end of a generation, or NaN beyond the budget."""
        if number >= self.generations:
            return float("nan")
        return float(self.best_m[np.searchsorted(self.generation, number, side="right") - 1])


def read_runs(
    table: polars.DataFrame, config: StudyConfig, seeds: Sequence[int]
) -> dict[str, list[Run]]:
    """Return the runs of each arm with these seeds."""
    runs: dict[str, list[Run]] = {arm: [] for arm in config.arms}
    for (arm, seed), rows in _split(table):
        if arm not in runs or seed not in seeds:
            continue
        spent_s = np.cumsum(rows["simulated_s"].to_numpy())
        count = int(np.searchsorted(spent_s, config.budget_s, side="right"))
        generation, failure = rows["generation"].to_numpy(), rows["failure"].to_numpy()
        complete = failure == "ok"
        if "stopped" in rows.columns:  # earlier versions had no racing
            complete &= ~rows["stopped"].fill_null(value=False).to_numpy()
        crawled_m = np.where(complete, np.maximum(rows["distance_m"].to_numpy(), 0.0), 0.0)
        runs[arm].append(
            Run(
                seed=seed,
                spent_s=spent_s[:count],
                best_m=np.maximum.accumulate(crawled_m)[:count],
                failure=failure[:count],
                generation=generation[:count],
                generations=int(generation[count] if count < len(rows) else generation[-1] + 1),
            )
        )
    return runs


def _check_thresholds(data: Any) -> list[float]:
    """Return the thresholds (m) in the content of thresholds.json."""
    values = data.get("thresholds_m") if isinstance(data, dict) else None
    numbers = [to_number(value) or 0.0 for value in values] if isinstance(values, list) else []
    if min(numbers, default=0.0) <= 0:
        raise CaterpillarError(f"thresholds_m = {show(values)} must be a list of positive numbers")
    return numbers


def read_thresholds(config: StudyConfig, folder: Path, table: polars.DataFrame) -> list[float] | None:
    """Return the threshold distances (m). Those from pilot runs are written into a file once.

    Returns:
        None until all pilot runs are finished, or an empty list if most of them never crawled forwards.
    """
    if config.thresholds_m:
        return list(config.thresholds_m)
    file = folder / "thresholds.json"
    if file.exists():
        return read(file, _check_thresholds, "remove it, and it is made again")
    runs = read_runs(table, config, config.pilot_seeds)[config.reference]
    if len(runs) < len(config.pilot_seeds):
        return None
    median_m = float(np.median([run.best_m[-1] for run in runs]))
    if median_m <= 0:
        return []
    found = [share * median_m for share in config.threshold_shares]
    write_json(file, {"thresholds_m": found})
    return found
