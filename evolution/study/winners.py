"""Each arm's best robot, looked at again: does it hold at a finer timestep, and as another robot?"""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple, cast

from caterpillar_env.files import write_json
from caterpillar_env.robot import AnyRobot
from caterpillar_env.task import label
from evolution.study.config import Cell, StudyConfig, is_finished

REFERENCE_TIMESTEP_S = 0.00025  #: see docs/physics.md
ARTEFACT_SHARE = 0.1  #: a winner whose distance changes by more at the reference timestep is one
FRICTIONS = (0.6, 0.7, 0.9, 1.0)
MISMATCH_SEEDS = (1001, 1002, 1003, 1004)


class Winner(NamedTuple):
    """An arm's best robot, looked at again."""

    arm: str
    seed: int
    recorded_m: float
    reference_m: float  #: at the reference timestep
    failure: str  #: there
    friction_m: tuple[float, float]  #: least and greatest over other frictions; a failure counts as 0
    mismatch_m: tuple[float, float] | None  #: likewise over other draws of the springs' strengths
    timestep_s: float  #: that it was evolved at
    friction: float  #: likewise

    @property
    def artefact(self) -> bool:
        """Whether it does not hold at the reference timestep."""
        change = abs(self.reference_m - self.recorded_m)
        return self.failure != "ok" or change > ARTEFACT_SHARE * self.recorded_m


def winners(config: StudyConfig, folder: Path) -> list[Winner]:
    """Each arm's best robot, simulated anew at the reference timestep and as slightly other robots.

    The robots are kept as `winners/ARM.json`, the results as `winners/winners.json`; what is known of
    a robot is not computed again.
    """
    kept = folder / "winners"
    file = kept / "winners.json"
    known = json.loads(file.read_text(encoding="utf-8")) if file.exists() else {}
    found = []
    for arm in config.arms:
        best = [_best(config, Cell(arm, seed), folder) for seed in config.seeds]
        robots = [robot for robot in best if robot is not None]
        if not robots:
            if arm in known:  # the runs themselves are not there
                found.append(_winner(known[arm]))
            continue
        seed, robot = max(robots, key=lambda pair: pair[1].fitness_m or 0.0)
        if arm not in known or known[arm]["recorded_m"] != robot.fitness_m:
            kept.mkdir(exist_ok=True)
            robot.save(kept / f"{arm}.json")
            known[arm] = _look_again(arm, seed, robot)._asdict()
            write_json(file, known)
        found.append(_winner(known[arm]))
    return found


def _best(config: StudyConfig, cell: Cell, folder: Path) -> tuple[int, AnyRobot] | None:
    """A finished run's seed and best robot within the budget, if one crawled forwards."""
    if not is_finished(config, cell, folder):
        return None
    robot = config.arms[cell.arm].best(cell.folder(folder), config.budget_s)
    return None if robot is None else (cell.seed, robot)


def _winner(data: dict[str, Any]) -> Winner:
    low_high = {name: data[name] and tuple(data[name]) for name in ("friction_m", "mismatch_m")}
    return Winner(**{**data, **low_high})


def _look_again(arm: str, seed: int, robot: AnyRobot) -> Winner:
    fine = robot.simulate(REFERENCE_TIMESTEP_S)
    drawn = robot.physics.spring_strengths is None and robot.physics.mismatch_std > 0

    def swing(name: str, values: Sequence[float]) -> tuple[float, float]:
        others = [
            replace(cast(Any, robot), physics=replace(robot.physics, **{name: value})).simulate()  # type: ignore[arg-type]
            for value in values
        ]
        distances = [float(o.fitness()[0]) for o in others]
        return min(distances), max(distances)

    return Winner(
        arm=arm,
        seed=seed,
        recorded_m=robot.fitness_m or 0.0,
        reference_m=float(fine.distance_m[0]),
        failure=label(fine.failure[0]),
        friction_m=swing("friction", FRICTIONS),
        # Measured or equal springs are not drawn.
        mismatch_m=swing("mismatch_seed", MISMATCH_SEEDS) if drawn else None,
        timestep_s=robot.physics.timestep_s,
        friction=robot.physics.friction,
    )
