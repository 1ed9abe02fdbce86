"""Simulates the best robot of each arm again: at a finer timestep, and with slightly changed physics."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, cast

from caterpillar_env.files import write_json
from caterpillar_env.robot import AnyRobot
from caterpillar_env.task import label
from evolution.study.analysis import Analysis
from evolution.study.config import Cell

REFERENCE_TIMESTEP_S = 0.00025  #: timestep of the reference simulation, see docs/physics.md
ARTEFACT_SHARE = 0.1  #: largest relative change of distance that is no artefact
FRICTIONS = (0.6, 0.7, 0.9, 1.0)
MISMATCH_SEEDS = (1001, 1002, 1003, 1004)


class Winner(NamedTuple):
    """The best robot of an arm, simulated again. Ranges are minimum and maximum distances."""

    arm: str
    seed: int
    recorded_m: float
    reference_m: float  #: distance at the reference timestep
    failure: str  #: failure at the reference timestep, or "ok"
    friction_m: list[float]  #: range over `FRICTIONS`; a failure counts as 0
    mismatch_m: list[float] | None  #: range over `MISMATCH_SEEDS`, for random springs only

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
    known = json.loads(file.read_text(encoding="utf-8")) if file.exists() else {}
    winners = []
    for arm, runs in analysis.runs.items():
        best = max(runs, key=lambda run: run.best_m[-1])
        best_m = float(best.best_m[-1])
        run_folder = Cell(arm, best.seed).folder(folder)
        if best_m > 0 and run_folder.exists() and known.get(arm, {}).get("recorded_m") != best_m:
            robot = analysis.config.arms[arm].robot(run_folder, int(best.best_m.argmax()))
            file.parent.mkdir(exist_ok=True)
            robot.save(file.with_name(f"{arm}.json"))
            known[arm] = simulate_again(arm, best.seed, robot)._asdict()
            write_json(file, known)
        if arm in known:
            winners.append(Winner(**known[arm]))
    return winners


def simulate_again(arm: str, seed: int, robot: AnyRobot) -> Winner:
    """Simulate a robot at the reference timestep, and under other frictions and spring strengths."""
    fine = robot.simulate(REFERENCE_TIMESTEP_S)
    random_springs = robot.physics.spring_strengths is None and robot.physics.mismatch_std > 0

    def measure_range(name: str, values: Sequence[float]) -> list[float]:
        changed = [replace(robot.physics, **{name: value}) for value in values]  # type: ignore[arg-type]
        robots = [replace(cast(Any, robot), physics=physics) for physics in changed]
        distances_m = [float(other.simulate().fitness()[0]) for other in robots]
        return [min(distances_m), max(distances_m)]

    return Winner(
        arm=arm,
        seed=seed,
        recorded_m=robot.fitness_m or 0.0,
        reference_m=float(fine.distance_m[0]),
        failure=label(fine.failure[0]),
        friction_m=measure_range("friction", FRICTIONS),
        mismatch_m=measure_range("mismatch_seed", MISMATCH_SEEDS) if random_springs else None,
    )
