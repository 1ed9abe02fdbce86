"""Test policies with new springs, friction and slopes: does feedback help?

    python -m benchmarks.feedback results/rl/winners/{ppo-bandit,ppo}/*.json
    python -m benchmarks.feedback studies/rl/cells/{ppo-bandit,ppo}/seed-*    # after the study `rl`

The best policy of each training run crawls under all combinations of the conditions. The preset `rl`
trains with a friction of 0.8, or of 0.5 to 1.1, and on flat ground. Distances are those in 30 s. A robot
that fails counts as 0. A training run without a best policy counts as 0 if its folder is given; it has
no JSON file, so a list of JSON files leaves it out. Runs that differ only in the seed form a group. The
first group is the reference.
"""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from itertools import product
from pathlib import Path
from typing import Any

import numpy as np

from baselines.config import TrainConfig, Training
from baselines.policy import TrainedRobot
from benchmarks.harness import interval, report
from caterpillar_env.arrays import Array
from caterpillar_env.robot import AnyRobot, wave_robot
from caterpillar_env.task import Failure
from caterpillar_env.worlds import World
from evolution.study.statistics import a12

FRICTIONS = (0.4, 0.8, 1.2)
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


def crawl(robot: AnyRobot, conditions: Sequence[dict[str, Any]]) -> tuple[Array, Array]:
    """Return the distances of a robot under each of the conditions, mm, and whether it failed."""
    outcomes = [robot.with_physics(**fields).simulate() for fields in conditions]
    fitness_mm = 1000 * np.concatenate([outcome.fitness() for outcome in outcomes])
    return fitness_mm, np.concatenate([outcome.failure for outcome in outcomes]) != Failure.NONE


def _load(path: Path) -> tuple[TrainConfig, TrainedRobot | None]:
    """Return the settings and the best robot of a training run, or those of a JSON file."""
    if path.is_file():
        robot = TrainedRobot.load(path)
        return robot.config, robot
    config, history = Training.read(path)
    return config, TrainedRobot.load(path) if history.best else None


def compare_policies(paths: Sequence[Path], conditions: Sequence[dict[str, Any]]) -> None:
    """Print distances of the best policies, under nominal and under unseen conditions.

    Distances are medians over the runs of a group: of the mean over all unseen conditions, of the mean
    over the conditions in each world, and of the worst condition. A12 is the probability that a run of
    the group crawls farther than a run of the reference. It compares the means over all unseen
    conditions.

    Raises:
        CaterpillarError: a path has neither a training run nor a robot with a policy.
    """
    groups: dict[str, list[AnyRobot | None]] = {}
    titles: dict[str, str] = {"": "hand-made wave"}
    groups[""] = [wave_robot()]
    for path in paths:
        config, robot = _load(path)
        titles[config.group] = config.title
        groups.setdefault(config.group, []).append(robot)
    rows: list[dict[str, Any]] = []
    reference: Array | None = None
    worlds = [str(fields.get("world", World.of("flat"))) for fields in conditions]
    for key, robots in groups.items():
        standing = np.zeros(len(conditions)), np.ones(len(conditions), dtype=bool)
        nominal_mm = np.array([0.0 if r is None else crawl(r, [{}])[0][0] for r in robots])
        tested = [standing if r is None else crawl(r, conditions) for r in robots]
        unseen_mm, failed = (np.stack(arrays) for arrays in zip(*tested, strict=True))
        mean_mm = unseen_mm.mean(axis=1)
        reference = mean_mm if reference is None and key else reference
        rows.append(
            {
                "policy": titles[key],
                "runs": len(robots),
                "nominal": interval(nominal_mm),
                "unseen": interval(mean_mm),
                **{
                    world: interval(unseen_mm[:, [w == world for w in worlds]].mean(axis=1))
                    for world in dict.fromkeys(worlds)
                },
                "worst": float(np.median(unseen_mm.min(axis=1))),
                "failures, %": float(100 * failed.mean()),
                "A12": "" if reference is None else a12(mean_mm, reference)._asdict(),
            }
        )
    report(f"policies under {len(conditions)} unseen conditions, distances in mm", rows)


def main() -> None:
    """Compare the policies of training runs."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("paths", type=Path, nargs="+", help="folders of training runs, or JSON files")
    parser.add_argument("--frictions", type=float, nargs="+", default=FRICTIONS)
    parser.add_argument("--mismatch-seeds", type=int, nargs="+", default=MISMATCH_SEEDS)
    parser.add_argument("--worlds", nargs="+", default=SLOPES)
    args = parser.parse_args()
    compare_policies(args.paths, make_conditions(args.frictions, args.mismatch_seeds, args.worlds))


if __name__ == "__main__":
    main()
