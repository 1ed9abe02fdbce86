"""Simulates the best robot of each arm again, at a finer timestep."""

from __future__ import annotations

import json
from pathlib import Path
from typing import NamedTuple

from caterpillar_env.files import write_json
from caterpillar_env.task import Failure
from evolution.study.analysis import Analysis
from evolution.study.config import Cell

REFERENCE_TIMESTEP_S = 0.00025  #: timestep of the reference simulation, see docs/physics.md
ARTEFACT_SHARE = 0.1  #: largest relative change of distance that is not an artefact


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
    known = json.loads(file.read_text(encoding="utf-8")) if file.exists() else {}
    for arm, runs in analysis.runs.items():
        best = max(runs, key=lambda run: run.best_m[-1])
        best_m = float(best.best_m[-1])
        run_folder = Cell(arm, best.seed).folder(folder)
        if best_m > 0 and run_folder.exists() and known.get(arm, {}).get("recorded_m") != best_m:
            robot = analysis.config.arms[arm].robot(run_folder, int(best.best_m.argmax()))
            file.parent.mkdir(exist_ok=True)
            robot.save(file.with_name(f"{arm}.json"))
            end = robot.simulate(REFERENCE_TIMESTEP_S)
            failure = Failure(end.failure[0]).label
            known[arm] = Winner(arm, best.seed, best_m, float(end.distance_m[0]), failure)._asdict()
            write_json(file, known)
    return [Winner(**known[arm]) for arm in analysis.runs if arm in known]
