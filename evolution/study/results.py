"""What the finished runs of a study came to: their evaluations, and how each got along."""

from __future__ import annotations

import json
import os
import statistics
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
import polars
from numpy.typing import NDArray

from caterpillar_env.arrays import Array
from caterpillar_env.files import write_json
from evolution.study.arms import COLUMNS
from evolution.study.config import Cell, StudyConfig, is_finished

DATA = "evaluations.parquet"  #: all evaluations of a study in one table


def collect(config: StudyConfig, folder: Path) -> tuple[polars.DataFrame, list[Cell]]:
    """All evaluations of the finished cells in one table, and the cells that are not finished.

    Of runs that are not there, what the table of an earlier call holds is kept.
    """
    file = folder / DATA
    kept = dict(_cells(polars.read_parquet(file))) if file.exists() else {}
    parts, missing, new = [], [], False
    for cell in config.cells():
        if not is_finished(config, cell, folder):
            if cell in kept:
                parts.append(kept[cell])
            else:
                missing.append(cell)
            continue
        new = True
        arm, run = config.arms[cell.arm], cell.folder(folder)
        rows = arm.evaluations(run).cast(COLUMNS)
        outcome = rows.columns[: rows.columns.index("simulated_s") + 1]
        genes = [polars.col(name).cast(polars.Float32) for name in rows.columns[len(outcome) :]]
        who = (polars.lit(cell.arm).alias("arm"), polars.lit(cell.seed, polars.Int64).alias("seed"))
        wall_s = polars.lit(arm.wall_s(run), polars.Float64).alias("wall_s")
        parts.append(rows.select(*who, wall_s, *outcome, *genes))
    frame = polars.concat(parts, how="diagonal") if parts else polars.DataFrame()
    if new:
        partial = folder / f".{DATA}.partial"
        frame.write_parquet(partial, compression="zstd", compression_level=19)
        os.replace(partial, file)
    return frame, missing


def versions(config: StudyConfig, folder: Path) -> list[dict[str, str]]:
    """The different versions and machines that finished cells ran under: one, if all compare."""
    found: list[dict[str, str]] = []
    for cell in config.cells():
        if is_finished(config, cell, folder):
            for session in config.arms[cell.arm].versions(cell.folder(folder)):
                # Kinds of arms tell of different packages: only what both tell of can differ.
                for one in found:
                    if all(one.get(name, version) == version for name, version in session.items()):
                        one.update(session)
                        break
                else:
                    found.append(dict(session))
    return found


def thresholds(config: StudyConfig, folder: Path, frame: polars.DataFrame) -> list[float] | None:
    """The distances (m) that runs are timed to: frozen when the pilot seeds are through, and kept.

    Returns:
        None as long as they are not; none at all if most pilot runs never crawled forwards.
    """
    file = folder / "thresholds.json"
    if file.exists():
        kept: list[float] = json.loads(file.read_text(encoding="utf-8"))["thresholds_m"]
        return kept
    finals = [
        course.best_m[-1] for course in courses(frame, config, config.pilot_seeds)[config.reference]
    ]
    if len(finals) < len(config.pilot_seeds):
        return None
    middle = statistics.median(finals)
    if middle <= 0:
        return []
    found = [float(share * middle) for share in config.threshold_shares]
    data = {"thresholds_m": found, "reference": config.reference, "pilot_seeds": config.pilot_seeds}
    write_json(file, data)
    return found


class Course(NamedTuple):
    """One run over its simulated time; E evaluations within the budget."""

    seed: int
    spent_s: Array  #: simulated seconds after each evaluation, (E,)
    best_m: Array  #: best distance so far, (E,)
    generation: NDArray[np.int64]  #: of each evaluation, (E,)
    generations: int  #: that were through within the budget

    def reaches(self, distance_m: float, horizon_s: float) -> tuple[float, bool]:
        """When it gets that far, s, and True; or `horizon_s` and False."""
        there = np.flatnonzero(self.best_m >= distance_m)
        return (float(self.spent_s[there[0]]), True) if there.size else (horizon_s, False)

    def at_generation(self, number: int) -> float:
        """Best distance by the end of a generation, m; NaN if the budget ended before that."""
        if number >= self.generations:
            return float("nan")
        return float(self.best_m[np.searchsorted(self.generation, number, side="right") - 1])


def courses(
    frame: polars.DataFrame, config: StudyConfig, seeds: tuple[int, ...]
) -> dict[str, list[Course]]:
    """The runs of each arm with these seeds."""
    found: dict[str, list[Course]] = {arm: [] for arm in config.arms}
    for (arm, seed), rows in _cells(frame):
        if arm not in found or seed not in seeds:
            continue
        spent = np.cumsum(rows["simulated_s"].to_numpy())
        inside = spent <= config.budget_s
        generation = rows["generation"].to_numpy()
        through = int(generation[len(spent[inside])]) if not inside.all() else int(generation[-1]) + 1
        healthy = (rows["failure"] == "ok").to_numpy()
        crawled = np.where(healthy, np.maximum(rows["distance_m"].to_numpy(), 0.0), 0.0)
        found[arm].append(
            Course(
                seed,
                spent[inside],
                np.maximum.accumulate(crawled)[inside],
                generation[inside],
                through,
            )
        )
    return found


def _cells(frame: polars.DataFrame) -> Iterator[tuple[Cell, polars.DataFrame]]:
    if frame.is_empty():
        return
    for (arm, seed), rows in frame.group_by("arm", "seed", maintain_order=True):
        yield Cell(str(arm), int(seed)), rows.sort("evaluation")
