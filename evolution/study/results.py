"""Results of a study: evaluations of its finished runs, and the progress of each run."""

from __future__ import annotations

import hashlib
import io
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import polars
from numpy.typing import NDArray

from caterpillar_env.arrays import Array
from caterpillar_env.errors import CaterpillarError
from caterpillar_env.files import COPY, write_bytes, writing
from evolution.run.database import JournalError
from evolution.run.history import History
from evolution.study.config import Cell, StudyConfig

DATA = "evaluations.parquet"  #: name of the file with all evaluations of a study
DIGEST = f"{DATA}.sha256"  #: name of the file with the digest of `DATA`, for `sha256sum --check`
_GROUP_ROWS = 10_000
_KEEP = "restore a copy of this file, or remove this file if the folders of all runs still exist"
_OUTCOME = ("evaluation", "generation", "failure", "stopped", "distance_m", "energy_j", "simulated_s")


class Results(NamedTuple):
    """Evaluations of the finished runs of a study."""

    table: polars.DataFrame  #: one row per evaluation: arm, seed, outcome, genes in SI units
    missing: list[Cell]  #: runs that are not finished


def read_run(config: StudyConfig, cell: Cell, study: Path) -> History | None:
    """Read a run of a study, or return None if it is missing or unreadable.

    Raises:
        CaterpillarError: the run was made with different settings.
    """
    folder = cell.folder(study)
    try:
        history = History.read(folder)
    except JournalError:
        return None  # running this cell reports the error
    if not config.arms[cell.arm].matches(history, cell.seed, config.budget_of(cell)):
        raise CaterpillarError(
            f"{folder} has settings that differ from those of the study; choose another study folder "
            "with --out"
        )
    return history


def read_kept(folder: Path) -> dict[Cell, polars.DataFrame]:
    """Read the evaluations of finished and unfinished runs that `collect` wrote into `DATA`.

    Raises:
        CaterpillarError: the file cannot be read, or does not match its digest.
    """
    file, digest = folder / DATA, folder / DIGEST
    if not file.is_file():
        return {}
    try:
        content = file.read_bytes()
        if digest.is_file() and digest.read_bytes() != _digest(content):
            raise CaterpillarError(f"{file} is damaged: it does not match {DIGEST}; {_KEEP}")
        table = polars.read_parquet(io.BytesIO(content))
        if missing := {"arm", "seed", *_OUTCOME} - set(table.columns):
            raise CaterpillarError(f"{file} lacks these columns: {', '.join(sorted(missing))}; {_KEEP}")
        return dict(_split(table))
    except (OSError, polars.exceptions.PolarsError, polars.exceptions.PanicException) as error:
        raise CaterpillarError(f"cannot read {file}: {error}; {_KEEP}") from None


def read_all(config: StudyConfig, folder: Path) -> dict[Cell, polars.DataFrame]:
    """Return the recorded evaluations of all runs, from their folders or the file `DATA`.

    If a run is in both, the longer record counts. Only completed generations are included. A folder with
    an unfinished run is read only if its arm is `restorable`.
    """
    kept, found = read_kept(folder), {}
    for cell in config.cells():
        rows, history = kept.pop(cell, None), read_run(config, cell, folder)
        if history is not None and (history.finished or config.arms[cell.arm].restorable):
            recorded = _to_table(cell, history)
            if len(recorded) and (rows is None or len(recorded) > len(rows)):
                rows = recorded
        if rows is not None:
            found[cell] = rows
    return found | kept  # keep the rows of runs that are no longer part of the study


def is_finished(config: StudyConfig, cell: Cell, rows: polars.DataFrame | None) -> bool:
    """Return whether a run is finished, given its evaluations from `read_all`.

    A restorable run is finished when its evaluations use up its budget. Of the other runs, `read_all`
    returns the finished ones only.
    """
    if rows is None:
        return False
    spent_s = round(float(rows["simulated_s"].sum()), 6)  # the run adds these times in another order
    return not config.arms[cell.arm].restorable or spent_s >= config.budget_of(cell)


def collect(config: StudyConfig, folder: Path) -> Results:
    """Read all runs of a study, write their evaluations into `DATA`, and return those of finished runs.

    Runs whose folders were deleted are taken from this file if an earlier call wrote it. The file also
    has the completed generations of unfinished runs, from which `run_study` can continue.
    """
    found, file, digest = read_all(config, folder), folder / DATA, folder / DIGEST
    if found:
        table = polars.concat(found.values(), how="diagonal")
        if not (file.exists() and polars.read_parquet(file).equals(table)):
            content = io.BytesIO()
            # With small groups, a version-control system stores only the groups that change.
            table.write_parquet(
                content, compression="zstd", compression_level=15, row_group_size=_GROUP_ROWS
            )
            # Delete the old digest first: a process that is killed must not leave a wrong one.
            with writing(digest, COPY):
                digest.unlink(missing_ok=True)
            write_bytes(file, content.getvalue(), COPY)
        if not digest.exists():
            write_bytes(digest, _digest(file.read_bytes()), COPY)
    cells = config.cells()
    finished = {cell: found[cell] for cell in cells if is_finished(config, cell, found.get(cell))}
    tables = list(finished.values())
    return Results(
        polars.concat(tables, how="diagonal") if tables else polars.DataFrame(),
        [cell for cell in cells if cell not in finished],
    )


def _digest(content: bytes) -> bytes:
    """Return the content of the file `DIGEST`."""
    return f"{hashlib.sha256(content).hexdigest()}  {DATA}\n".encode()


def _to_table(cell: Cell, history: History) -> polars.DataFrame:
    rows = history.table()
    genes = rows.columns[rows.columns.index("session") + 1 :]
    return rows.filter(polars.col("generation") < len(history.generations)).select(
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
    spent_s: Array  #: simulated seconds after which the outcome of each evaluation is known, (E,)
    best_m: Array  #: largest distance so far of a robot that did not fail, at least 0, (E,)
    failure: NDArray[Any]  #: "ok", "stopped" (by racing) or the kind of failure, (E,)
    generation: NDArray[np.int64]  #: number of the generation, (E,)
    generations: int  #: number of generations completed within the budget
    budget_s: float  #: simulated seconds at which the run is censored

    @classmethod
    def of(cls, rows: polars.DataFrame, seed: int, budget_s: float) -> Run:
        """Compute the progress of a run from its evaluations, ordered as in `History.table`."""
        generation, stopped = rows["generation"].to_numpy(), rows["stopped"].to_numpy()
        spent_s = _find_ends(rows["simulated_s"].to_numpy(), generation, stopped)
        count = int(np.searchsorted(spent_s, budget_s, side="right"))
        failure = np.where(stopped, "stopped", rows["failure"].to_numpy())
        crawled_m = np.where(failure == "ok", np.maximum(rows["distance_m"].to_numpy(), 0.0), 0.0)
        return cls(
            seed=seed,
            spent_s=spent_s[:count],
            best_m=np.maximum.accumulate(crawled_m)[:count],
            failure=failure[:count],
            generation=generation[:count],
            generations=int(generation[count] if count < len(rows) else generation[-1] + 1),
            budget_s=budget_s,
        )

    def time_to(self, distance_m: float) -> float:
        """Return the simulated time (s) at which the run reaches a distance; infinite if never."""
        place = int(np.searchsorted(self.best_m, distance_m))
        return float(self.spent_s[place]) if place < len(self.best_m) else float("inf")

    def generations_to(self, distance_m: float) -> float:
        """Return the number of generations that the run needs to reach a distance; infinite if never.

        Only generations that were completed within the budget count.
        """
        place = int(np.searchsorted(self.best_m, distance_m))
        if place == len(self.best_m) or self.generation[place] >= self.generations:
            return float("inf")
        return float(self.generation[place] + 1)

    def best_after(self, generations: int) -> float:
        """Return the best distance (m) after a number of generations, or NaN beyond the budget."""
        if generations > self.generations:
            return float("nan")
        count = int(np.searchsorted(self.generation, generations, side="left"))
        return float(self.best_m[count - 1]) if count else 0.0

    def best_at(self, time_s: float) -> float:
        """Return the best distance (m) at a simulated time."""
        return float(self.best_at_times(np.array(time_s)))

    def best_at_times(self, time_s: Array) -> Array:
        """Return the best distances (m) at simulated times, in the shape of `time_s`."""
        counts = np.searchsorted(self.spent_s, time_s, side="right")
        return np.append(0.0, self.best_m)[counts]


def _find_ends(simulated_s: Array, generation: NDArray[np.int64], stopped: NDArray[np.bool_]) -> Array:
    """Return the simulated seconds after which the outcome of each evaluation is known, (E,).

    Racing has two phases. First, all robots of a generation crawl until the slower ones are stopped.
    Then the remaining robots crawl to the end, one after the other.
    """
    stop_s = simulated_s[stopped].max(initial=0.0)
    early_s = np.minimum(simulated_s, stop_s)
    _, first, place = np.unique(generation, return_index=True, return_inverse=True)
    race_s = np.add.reduceat(early_s, first)[place] if len(first) else early_s
    before_s = (np.cumsum(early_s) - early_s)[first][place]  # races of earlier generations
    ends_s: Array = before_s + race_s + np.cumsum(simulated_s - early_s)
    return ends_s


def read_runs(table: polars.DataFrame, config: StudyConfig) -> dict[str, list[Run]]:
    """Return the runs of each arm, in the order of the table."""
    runs: dict[str, list[Run]] = {arm: [] for arm in config.arms}
    for cell, rows in _split(table):
        if cell.arm not in runs or cell.seed not in config.seeds:
            continue
        runs[cell.arm].append(Run.of(rows, cell.seed, config.budget_of(cell)))
    return runs
