"""Simulates the best robots of a study again, with more accurate settings."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from caterpillar_env.errors import CaterpillarError, to_number
from caterpillar_env.files import read, write_json
from caterpillar_env.robot import AnyRobot, Robot, simulate
from caterpillar_env.task import Failure
from caterpillar_env.validation.robots import stack_robots
from evolution.study.analysis import Analysis
from evolution.study.config import Cell
from evolution.study.results import Run

REFERENCE_TIMESTEP_S = 0.00025  #: timestep of the reference simulation, see docs/physics.md
_AGAIN = "remove it, and it is made again"
ARTEFACT_SHARE = 0.1  #: largest relative change of distance that is not an artefact


#: Settings of the simulations that all winners are compared with, by the name in tables.
REFERENCES: dict[str, dict[str, Any]] = {
    "0.25 ms": {"timestep_s": REFERENCE_TIMESTEP_S},
    "Runge-Kutta": {"timestep_s": REFERENCE_TIMESTEP_S, "integrator": "rk4"},
}


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


def find_winners(analysis: Analysis, folder: Path) -> list[Winner]:
    """Simulate each arm's best robot within the budget again, or read the results of an earlier call.

    Robots are saved as `winners/ARM.json` in the study's folder, and results as `winners/winners.json`.
    """
    file = folder / "winners" / "winners.json"
    known = read(file, _check_winners, _AGAIN) if file.exists() else {}
    for arm, runs in analysis.runs.items():
        best = max(runs, key=lambda run: run.best_m[-1])
        best_m = float(best.best_m[-1])
        is_new = best_m > 0 and known.get(arm, {}).get("recorded_m") != best_m
        robot = _load_best(analysis, arm, best, folder) if is_new else None
        if robot is not None:
            file.parent.mkdir(exist_ok=True)
            robot.save(file.with_name(f"{arm}.json"))
            end = robot.simulate(REFERENCE_TIMESTEP_S)
            failure = Failure(end.failure[0]).label
            known[arm] = Winner(arm, best.seed, best_m, float(end.distance_m[0]), failure)._asdict()
            write_json(file, known)
    return [Winner(**known[arm]) for arm in analysis.runs if arm in known]


def _check_winners(data: Any) -> dict[str, dict[str, Any]]:
    """Check the content of winners.json, and return it."""
    fields = set(Winner._fields)
    if not isinstance(data, dict) or not all(
        isinstance(row, dict) and set(row) == fields and _are_numbers(row, "recorded_m", "reference_m")
        for row in data.values()
    ):
        raise CaterpillarError(f"it must hold {', '.join(Winner._fields)} for each arm; {_AGAIN}")
    return data


def _check_rows(data: Any) -> list[dict[str, Any]]:
    """Check the content of all.json, and return it."""
    try:
        valid = all(
            _are_numbers(row, "seed", "recorded_m")
            and isinstance(row["arm"], str)
            and all(
                _are_numbers(row["references"][name], "distance_m")
                and isinstance(row["references"][name]["failure"], str)
                for name in REFERENCES
            )
            for row in data
        )
    except (TypeError, LookupError):
        valid = False
    if not valid or not isinstance(data, list):
        raise CaterpillarError(f"it must hold a list of robots with their references; {_AGAIN}")
    return data


def _are_numbers(row: Any, *names: str) -> bool:
    return all(to_number(row[name]) is not None for name in names)


class Comparison(NamedTuple):
    """The best robots of all runs of an arm, simulated again with other settings."""

    arm: str
    reference: str  #: see `REFERENCES`
    robots: int
    failed: int  #: number of robots that fail with these settings
    median_change: float  #: of the recorded distance, relative, by the others; NaN if there are none
    largest_change: float  #: the same


def compare_winners(analysis: Analysis, folder: Path) -> list[Comparison]:
    """Simulate the best robot of every run again with each of `REFERENCES`, on all cores.

    Results are saved as `winners/all.json`, and robots as `winners/ARM/seed-N.json`. Robots that an
    earlier call simulated are not simulated again. Policies are left out.
    """
    file = folder / "winners" / "all.json"
    known = read(file, _check_rows, _AGAIN) if file.exists() else []
    rows = {(row["arm"], row["seed"], row["recorded_m"]): row for row in known}
    found = []
    for arm, runs in analysis.runs.items():
        winners = {(arm, run.seed, float(run.best_m[-1])): run for run in runs if run.best_m[-1] > 0}
        missing = [key for key in winners if key not in rows]
        robots = {}
        for key in missing:
            robot = _load_best(analysis, arm, winners[key], folder)
            if isinstance(robot, Robot):
                robots[key] = robot
                path = folder / "winners" / arm / f"seed-{key[1]}.json"
                path.parent.mkdir(parents=True, exist_ok=True)
                robot.save(path)
        rows |= _simulate_again(robots)
        if robots:
            write_json(file, list(rows.values()))
        found += _compare(arm, [rows[key] for key in winners if key in rows])
    return found


def _load_best(analysis: Analysis, arm: str, run: Run, folder: Path) -> AnyRobot | None:
    """Return the best robot of a run within the budget, or None if its run folder is gone."""
    run_folder = Cell(arm, run.seed).folder(folder)
    if not run_folder.exists():
        return None
    return analysis.config.arms[arm].robot(run_folder, int(run.best_m.argmax()))


def _simulate_again(robots: dict[tuple[str, int, float], Robot]) -> dict[tuple[str, int, float], Any]:
    """Return the recorded distance of each robot, and its end with each of the references."""
    rows = {
        key: {"arm": key[0], "seed": key[1], "recorded_m": key[2], "references": {}} for key in robots
    }
    for name, settings in REFERENCES.items() if robots else ():
        bodies, timings = stack_robots(list(robots.values()))
        physics = replace(next(iter(robots.values())).physics, **settings)
        ends = simulate(bodies, timings, physics)
        for row, distance_m, failure in zip(rows.values(), ends.distance_m, ends.failure, strict=True):
            row["references"][name] = {  # type: ignore[index]
                "distance_m": float(distance_m), "failure": Failure(failure).label
            }  # fmt: skip
    return rows


def _compare(arm: str, rows: Iterable[dict[str, Any]]) -> list[Comparison]:
    found = []
    for name in REFERENCES if rows else ():
        ends = [row["references"][name] for row in rows]
        changes = [
            abs(end["distance_m"] / row["recorded_m"] - 1.0)
            for row, end in zip(rows, ends, strict=True)
            if end["failure"] == "ok"
        ]
        median, worst = (float(f(changes)) if changes else np.nan for f in (np.median, np.max))
        found.append(Comparison(arm, name, len(ends), len(ends) - len(changes), median, worst))
    return found
