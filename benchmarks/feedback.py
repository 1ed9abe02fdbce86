"""Policies under friction, springs and slopes that they have not seen: does feedback help?

    python -m benchmarks.feedback studies/rl/cells/ppo*/seed-*    # after caterpillar study --preset rl

The best policy of each training run crawls under all combinations of the conditions. Distances are those
in 30 s; a policy that fails counts as 0. Runs that differ only in the seed form a group.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import replace
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from baselines.config import Training
from baselines.policy import TrainedRobot
from benchmarks.harness import report
from benchmarks.worlds import hand_made_robot
from caterpillar_env.arrays import Array
from caterpillar_env.errors import CaterpillarError
from caterpillar_env.robot import Robot
from caterpillar_env.worlds import World
from evolution.study.statistics import Estimate, a12, bootstrap

FRICTIONS = (0.5, 0.65, 0.95, 1.1)
MISMATCH_SEEDS = (101, 102, 103, 104, 105)
SLOPES = ("flat", "slope:angle_deg=5", "slope:angle_deg=5,direction=down")


def make_conditions(
    frictions: Sequence[float] = FRICTIONS,
    mismatch_seeds: Sequence[int] = MISMATCH_SEEDS,
    worlds: Sequence[str] = SLOPES,
) -> list[dict[str, Any]]:
    """Return fields of `Physics` for each combination of the conditions."""
    return [
        {"friction": friction, "mismatch_seed": seed, "world": World.of(world)}
        for world, friction, seed in product(worlds, frictions, mismatch_seeds)
    ]


def fitness_mm(robot: Robot | TrainedRobot, conditions: Sequence[dict[str, Any]]) -> Array:
    """Return the distances of a robot under each of the conditions, mm, (conditions,)."""
    physics = robot.physics
    robots = [replace(robot, physics=replace(physics, **fields)) for fields in conditions]
    return 1000 * np.concatenate([robot.simulate().fitness() for robot in robots])


def compare_policies(folders: Sequence[Path], conditions: Sequence[dict[str, Any]]) -> None:
    """Print distances of the best policies, under nominal and under unseen conditions.

    The last column compares the mean over the unseen conditions with that of the first group: the
    probability that a run of the group crawls farther.

    Raises:
        CaterpillarError: no folder was given, or one contains no training run with a policy.
    """
    groups: dict[str, list[TrainedRobot]] = {}
    for folder in folders:
        title = Training.read(folder).config.title
        groups.setdefault(title, []).append(TrainedRobot.load(folder))
    if not groups:
        raise CaterpillarError("give at least one folder that caterpillar rl train made")
    wave = hand_made_robot()
    tested: dict[str, Sequence[Robot | TrainedRobot]] = {"hand-made wave": [wave], **groups}
    rows: list[dict[str, Any]] = []
    first: Array | None = None
    for title, robots in tested.items():
        nominal_mm = np.concatenate([fitness_mm(robot, [{}]) for robot in robots])
        unseen_mm = np.stack([fitness_mm(robot, conditions) for robot in robots])
        mean_mm = unseen_mm.mean(axis=1)
        first = mean_mm if first is None and title != "hand-made wave" else first
        rows.append(
            {
                "policy": title,
                "runs": len(robots),
                "nominal, median mm": _interval(nominal_mm),
                "unseen, median of means, mm": _interval(mean_mm),
                "worst condition, median mm": float(np.median(unseen_mm.min(axis=1))),
                "failures, %": float(100 * (unseen_mm == 0).mean()),
                "A12 against the first": "" if first is None else a12(mean_mm, first)._asdict(),
            }
        )
    report(f"policies under {len(conditions)} unseen conditions", rows)


def _interval(values: Array) -> dict[str, float]:
    """Return the median and its interval by the bootstrap."""
    if len(values) == 1:
        return Estimate(float(values[0]), float("nan"), float("nan"))._asdict()
    return bootstrap(lambda sample: float(np.median(sample)), (values,))._asdict()


def main() -> None:
    """Compare the policies of training runs."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("folders", type=Path, nargs="+", help="folders of training runs")
    parser.add_argument("--frictions", type=float, nargs="+", default=FRICTIONS)
    parser.add_argument("--mismatch-seeds", type=int, nargs="+", default=MISMATCH_SEEDS)
    parser.add_argument("--worlds", nargs="+", default=SLOPES)
    args = parser.parse_args()
    compare_policies(args.folders, make_conditions(args.frictions, args.mismatch_seeds, args.worlds))


if __name__ == "__main__":
    main()
