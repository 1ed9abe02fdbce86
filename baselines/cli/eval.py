"""`caterpillar rl eval`."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import product
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro

from baselines.policy import TrainedRobot, Which
from caterpillar_env.drawing.video import Recording
from caterpillar_env.task import Failure
from evolution import cli


@dataclass(frozen=True)
class EvalArgs:
    """Evaluate a trained policy, optionally under different conditions."""

    robot: Annotated[Path, tyro.conf.Positional]
    """Folder of the training run, or JSON file of a robot with a policy."""
    which: Which = "best"
    """Policy to evaluate: the best or the last one."""
    frictions: tuple[float, ...] = ()
    """Friction coefficients to evaluate with; by default, the one of the training run."""
    mismatch_seeds: tuple[int, ...] = ()
    """Seeds (`mismatch_seed`) of the spring-force factors; by default, the one of the training run."""
    timestep_s: float | None = None
    """Physics timestep in s; by default, the one of the training run."""
    json: bool = False
    """Print JSON instead of sentences."""
    video: bool = False
    """Write a video of the first condition: eval.mp4 in the folder, or ROBOT.mp4 beside ROBOT.json."""


def eval_command(argv: Sequence[str]) -> int:
    """Evaluate a trained policy, optionally under different conditions."""
    args = cli.parse(EvalArgs, argv, "rl eval")
    robot = TrainedRobot.load(args.robot, args.which)
    if args.timestep_s is not None:
        robot = robot.with_physics(timestep_s=args.timestep_s)
    physics = robot.physics
    robots = [
        robot.with_physics(friction=friction, mismatch_seed=mismatch_seed)
        for friction, mismatch_seed in product(
            args.frictions or (physics.friction,), args.mismatch_seeds or (physics.mismatch_seed,)
        )
    ]
    rows: list[dict[str, Any]] = []
    fitness_m: list[float] = []
    for variant in robots:
        outcome = variant.simulate()
        fitness_m += outcome.fitness().tolist()
        rows.append(
            {
                "friction": variant.physics.friction,
                "mismatch_seed": variant.physics.mismatch_seed,
                "distance_m": float(outcome.distance_m[0]),
                "energy_j": float(outcome.energy_j[0]),
                "time_s": float(outcome.simulated_s[0]),
                "failure": Failure(outcome.failure[0]).label,
            }
        )
    if args.json:
        print(json.dumps(rows, indent=2))
    else:
        for row in rows:
            print(
                f"{1000 * row['distance_m']:.1f} mm in {row['time_s']:.1f} s ({row['failure']}), "
                f"{row['energy_j']:.1f} J, friction {row['friction']:g}, "
                f"mismatch seed {row['mismatch_seed']}"
            )
        if len(rows) > 1:
            low, median, high = 1000 * np.quantile(fitness_m, [0.25, 0.5, 0.75])
            print(f"median {median:.1f} mm, quartiles {low:.1f} to {high:.1f} (failures count as 0)")
    if args.video:
        path = args.robot.with_suffix(".mp4") if args.robot.is_file() else args.robot / "eval.mp4"
        recording = Recording(robots[0])
        cli.film(recording, path, cli.console())
    return 0
