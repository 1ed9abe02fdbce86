"""Simulates the best robots of a study again, under other conditions, and measures how they crawl."""

from __future__ import annotations

import math
import tempfile
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from caterpillar_env.errors import CaterpillarError, to_number
from caterpillar_env.files import read, write_json
from caterpillar_env.robot import AnyRobot, Robot, simulate, stack
from caterpillar_env.sma import SmaSpring
from caterpillar_env.task import Failure
from caterpillar_env.validation.gaits import Gait, measure_gait
from evolution.run.database import JournalError
from evolution.study.analysis import Analysis
from evolution.study.arms import Arm
from evolution.study.config import Cell, StudyConfig
from evolution.study.results import Run, read_kept

FINE = "0.25 ms"
REFERENCE_TIMESTEP_S = 0.00025  #: timestep of the reference simulation, see docs/physics.md
ARTEFACT_SHARE = 0.1  #: larger relative changes of the distance mark an artefact

#: Changes to the physics under which winners are simulated again, by their names in tables.
CONDITIONS: dict[str, dict[str, Any]] = {
    FINE: {"timestep_s": REFERENCE_TIMESTEP_S},
    "Runge-Kutta": {"timestep_s": REFERENCE_TIMESTEP_S, "integrator": "rk4"},
    "friction 0.4": {"friction": 0.4},
    "friction 1.2": {"friction": 1.2},
    "other springs (seed 1001)": {"mismatch_seed": 1001},
    "other springs (seed 1002)": {"mismatch_seed": 1002},
    "coil shielding 0.5": {"spring": SmaSpring(coil_shielding=0.5)},
    "Ms 62, Mf 52 degC": {"spring": SmaSpring(martensite_start_c=62.0, martensite_finish_c=52.0)},
    "force limit 0.55 N": {"spring": SmaSpring(force_limit_n=0.55)},
}

_MEASURES = {
    "best_tenth": "distance covered in the best tenth of a period",
    "settled": "speed after the first third of the episode",
    "airborne": "distance covered in the air",
    "body_load": "body load",
    "overrun": "overrun of a joint",
    "slip": "slip",
}
_AGAIN = "remove this file; the next report recreates it"
_Key = tuple[str, int, float]  # arm, seed, recorded distance
_Row = dict[str, Any]


class Winner(NamedTuple):
    """The best robot of an arm, simulated again at the reference timestep."""

    arm: str
    seed: int
    recorded_m: float
    reference_m: float  #: distance at the reference timestep
    failure: str  #: failure at the reference timestep, or "ok"

    @property
    def artefact(self) -> bool:
        """Whether the robot fails, or its distance changes too much, at the reference timestep."""
        change = abs(self.reference_m - self.recorded_m)
        return self.failure != "ok" or change > ARTEFACT_SHARE * self.recorded_m


class Comparison(NamedTuple):
    """The best robot of each run of an arm, simulated again under one of the `CONDITIONS`."""

    arm: str
    condition: str
    robots: int
    failed: int  #: number of robots that fail
    #: Median ratio of the distance to the recorded one, over robots that do not fail; NaN if all fail.
    median_share: float
    smallest_share: float  #: minimum of this ratio
    largest_share: float  #: maximum of this ratio
    median_m: float  #: median distance of all robots, where a failure counts as 0


class Crawling(NamedTuple):
    """Distribution of one measure of `Gait` over the best robots of an arm, one from each run."""

    arm: str
    measure: str
    robots: int
    median: float
    low: float  #: first quartile
    high: float  #: third quartile


class Retest(NamedTuple):
    """Results of the best robots of a study."""

    winners: list[Winner]  #: the best robot of each arm
    comparisons: list[Comparison]  #: for robots that were simulated under all `CONDITIONS`
    crawling: list[Crawling]  #: how these robots crawl; policies are left out


def retest_winners(analysis: Analysis, folder: Path, *, every_run: bool = False) -> Retest:
    """Simulate the best robots again, and return the results.

    Only robots that were evaluated within the study's `budget_s` count. Robots that an earlier call
    simulated are not simulated again. Results are saved as `winners/winners.json` in the study's folder,
    the best robot of an arm as `winners/ARM.json`, and that of a run as `winners/ARM/seed-N.json`.

    Args:
        analysis: analysis of the study.
        folder: folder of the study.
        every_run: include the best robot of every run, under all `CONDITIONS`, and measure its gait.
            Gaits of policies are not measured. By default, only the best robot of each arm is simulated,
            at the reference timestep.
    """
    config, file = analysis.config, folder / "winners" / "winners.json"
    known = read(file, _check_rows, _AGAIN) if file.exists() else []
    rows: dict[_Key, _Row] = {(row["arm"], row["seed"], row["recorded_m"]): row for row in known}
    conditions = {FINE: {"timestep_s": REFERENCE_TIMESTEP_S}} | (CONDITIONS if every_run else {})
    retest = Retest([], [], [])
    for arm, runs in analysis.runs.items():
        found = {
            (arm, run.seed, best_m): run for run in runs if (best_m := run.best_at(config.budget_s)) > 0
        }
        if not found:
            continue
        best = max(found, key=lambda key: key[2])
        outdated = [key for key in rows if key[0] == arm and key not in found]
        for key in outdated:
            del rows[key]
        chosen = found if every_run else {best: found[best]}
        robots = _retest(config, folder, chosen, rows, conditions, measure=every_run)
        _save_best(config, folder, best, found[best], robots)
        if robots or outdated:
            write_json(file, list(rows.values()))
        if end := rows.get(best, {"references": {}})["references"].get(FINE):
            retest.winners.append(Winner(*best, end["distance_m"], end["failure"]))
        complete = [rows[key] for key in found if key in rows and _is_complete(rows[key], CONDITIONS)]
        retest.comparisons.extend(_compare(arm, complete))
        retest.crawling.extend(_measure(arm, complete))
    return retest


def _is_complete(row: _Row, conditions: Mapping[str, Any], *, measure: bool = True) -> bool:
    measured = "gait" in row and (row["gait"] is None or row["gait"].keys() >= set(Gait._fields))
    return (measured or not measure) and conditions.keys() <= row["references"].keys()


def _retest(
    config: StudyConfig, folder: Path, runs: dict[_Key, Run], rows: dict[_Key, _Row],
    conditions: Mapping[str, dict[str, Any]], *, measure: bool,
) -> dict[_Key, AnyRobot]:  # fmt: skip
    """Simulate the best robots of runs under the conditions that their rows lack.

    Args:
        config: the study.
        folder: folder of the study.
        runs: runs of one arm, by the keys of their best robots.
        rows: results so far, to which the new ones are added.
        conditions: changes to the physics by name.
        measure: whether to measure gaits, and to save the robots.

    Returns:
        The robots with new results.
    """
    robots: dict[_Key, AnyRobot] = {}
    for key, run in runs.items():
        if key in rows and _is_complete(rows[key], conditions, measure=measure):
            continue
        robot = load_winner(config, folder, key[0], run)
        if robot is not None:
            robots[key] = robot
            new = {"arm": key[0], "seed": key[1], "recorded_m": key[2], "references": {}}
            rows.setdefault(key, new)
    for name, changes in conditions.items():
        keys = [key for key in robots if name not in rows[key]["references"]]
        ends = _simulate([robots[key] for key in keys], changes)
        for key, (distance_m, failure) in zip(keys, ends, strict=True):
            rows[key]["references"][name] = _describe(distance_m, failure)
    for key, robot in robots.items() if measure else ():
        save_winner(robot, folder, Cell(key[0], key[1]))
        rows[key]["gait"] = measure_gait(robot)._asdict() if isinstance(robot, Robot) else None
    return robots


def _save_best(
    config: StudyConfig, folder: Path, best: _Key, run: Run, robots: Mapping[_Key, AnyRobot]
) -> None:
    """Save the best robot of an arm, unless it is saved already or cannot be recreated."""
    path = folder / "winners" / f"{best[0]}.json"
    if _load_saved(config.arms[best[0]], path, best[2]) is None:
        robot = robots.get(best) or load_winner(config, folder, best[0], run)
        if robot is not None:
            path.parent.mkdir(exist_ok=True)
            robot.save(path)


def _simulate(robots: Sequence[AnyRobot], changes: dict[str, Any]) -> list[tuple[float, int]]:
    """Simulate robots of one arm with changed physics. Return the distance and failure of each."""
    gaits = [robot for robot in robots if isinstance(robot, Robot)]
    if gaits and len(gaits) == len(robots):
        end = simulate(*stack(gaits), gaits[0].with_physics(**changes).physics)
        return list(zip(end.distance_m.tolist(), end.failure.tolist(), strict=True))
    ends = [robot.with_physics(**changes).simulate() for robot in robots]
    return [(float(end.distance_m[0]), int(end.failure[0])) for end in ends]


def save_winner(robot: AnyRobot, folder: Path, cell: Cell) -> None:
    """Write the best robot of a run into the folder of the study."""
    path = _file_of(folder, cell)
    path.parent.mkdir(parents=True, exist_ok=True)
    robot.save(path)


def _file_of(folder: Path, cell: Cell) -> Path:
    return folder / "winners" / cell.arm / f"seed-{cell.seed}.json"


def load_winner(config: StudyConfig, folder: Path, arm: str, run: Run) -> AnyRobot | None:
    """Return a run's best robot within `config.budget_s`, or None if it cannot be recreated."""
    cell, best_m = Cell(arm, run.seed), run.best_at(config.budget_s)
    number = int(np.searchsorted(run.best_m, best_m))
    file, run_folder = _file_of(folder, cell), cell.folder(folder)
    has_run = run_folder.exists()
    robot = _load_saved(config.arms[arm], file, best_m, strict=not has_run)
    if robot is not None:
        return robot
    if not config.arms[arm].restorable:
        return config.arms[arm].robot(run_folder, number) if has_run else None
    try:
        return config.arms[arm].robot(run_folder, number)
    except (JournalError, IndexError):  # the run folder is missing, or older than the study's table
        pass
    with tempfile.TemporaryDirectory() as scratch:
        rows = read_kept(folder)[cell]
        try:
            config.arms[arm].restore(rows, Path(scratch, "run"), run.seed, config.budget_of(cell))
        except JournalError:
            raise
        except CaterpillarError as error:  # the versions of the packages differ
            warnings.warn(f"the winner of {cell} is left out: {error}", stacklevel=2)
            return None
        return config.arms[arm].robot(Path(scratch, "run"), number)


def _load_saved(arm: Arm, file: Path, best_m: float, *, strict: bool = False) -> AnyRobot | None:
    """Return the robot in a file, or None if the file is missing or has a robot with another distance.

    Args:
        arm: arm of the robot.
        file: JSON file of the robot.
        best_m: recorded distance of the robot.
        strict: whether to raise an error if the file is damaged. By default, return None.
    """
    if not file.exists():
        return None
    try:
        robot = arm.load(file)
    except CaterpillarError:
        if strict:
            raise
        return None
    return robot if robot.fitness_m == best_m else None


def _describe(distance_m: float, failure: int) -> dict[str, Any]:
    return {"distance_m": float(distance_m), "failure": Failure(failure).label}


def _check_rows(data: Any) -> list[_Row]:
    """Check the content of winners.json, and return it."""
    try:
        valid = isinstance(data, list) and all(
            _are_numbers(row, "seed", "recorded_m")
            and isinstance(row["arm"], str)
            and all(
                _are_numbers(end, "distance_m") and isinstance(end["failure"], str)
                for end in row["references"].values()
            )
            and (row.get("gait") is None or _are_numbers(row["gait"], *row["gait"]))
            for row in data
        )
    except (TypeError, LookupError, AttributeError):
        valid = False
    if not valid:
        raise CaterpillarError(f"it must be a list of robots with their results; {_AGAIN}")
    rows: list[_Row] = data
    return rows


def _are_numbers(row: Any, *names: str) -> bool:
    return all(to_number(row[name]) is not None for name in names)


def _compare(arm: str, rows: Sequence[_Row]) -> list[Comparison]:
    found = []
    for name in CONDITIONS if rows else ():
        ends = [(row["references"][name], row["recorded_m"]) for row in rows]
        shares = [end["distance_m"] / before for end, before in ends if end["failure"] == "ok"]
        fitness_m = [max(end["distance_m"], 0.0) * (end["failure"] == "ok") for end, _ in ends]
        found.append(
            Comparison(
                arm=arm,
                condition=name,
                robots=len(ends),
                failed=sum(end["failure"] != "ok" for end, _ in ends),
                median_share=float(np.median(shares)) if shares else math.nan,
                smallest_share=min(shares, default=math.nan),
                largest_share=max(shares, default=math.nan),
                median_m=float(np.median(fitness_m)),
            )
        )
    return found


def _measure(arm: str, rows: Sequence[_Row]) -> list[Crawling]:
    found = []
    gaits = [row["gait"] for row in rows if row["gait"] is not None]
    for name, title in _MEASURES.items() if gaits else ():
        low, median, high = np.quantile([gait[name] for gait in gaits], [0.25, 0.5, 0.75])
        found.append(Crawling(arm, title, len(gaits), float(median), float(low), float(high)))
    return found
