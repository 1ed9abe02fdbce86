"""`caterpillar rl eval`."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import product
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tyro

from baselines.policy import Policy, RandomActor, TrainedRobot, Which, make_env
from caterpillar_env.drawing.video import Recording
from caterpillar_env.errors import CaterpillarError
from caterpillar_env.task import Failure
from evolution import cli


@dataclass(frozen=True)
class EvalArgs:
    """Evaluate a trained policy, optionally under different conditions."""

    robot: Annotated[Path, tyro.conf.Positional]
    """Folder of the training run, or JSON file of a robot with a policy."""
    which: Literal["best", "last", "random"] = "best"
    """Policy to evaluate: the best one, the last one, or random actions."""
    episodes: int = 1
    """Number of episodes, only for random actions; a policy would repeat the same episode."""
    frictions: tuple[float, ...] = ()
    """Friction coefficients to evaluate with; by default, the one of the training run."""
    mismatch_seeds: tuple[int, ...] = ()
    """Seeds (`mismatch_seed`) of the spring-force factors; by default, the one of the training run."""
    timestep_s: float | None = None
    """Physics timestep in s; by default, the one of the training run."""
    json: bool = False
    """Print JSON instead of sentences."""
    video: bool = False
    """Write a video of the first episode: eval.mp4 in the folder, or ROBOT.mp4 beside ROBOT.json."""

    def __post_init__(self) -> None:
        if self.episodes < 1:
            raise CaterpillarError(f"episodes = {self.episodes} must be at least 1")
        if self.video and self.which == "random":
            raise CaterpillarError("--video cannot be combined with --which random")
        if self.episodes > 1 and self.which != "random":
            raise CaterpillarError(
                f"episodes = {self.episodes} would repeat the same episode, because a policy is "
                "deterministic; remove --episodes, or add --which random"
            )


def eval_command(argv: Sequence[str]) -> int:
    """Evaluate a trained policy, optionally under different conditions."""
    args = cli.parse(EvalArgs, argv, "rl eval")
    # Random actions need only the settings, so load a policy that exists: a run may have no best policy,
    # and a JSON file has no last one.
    which: Which = "best" if args.robot.is_file() else "last"
    robot = TrainedRobot.load(args.robot, which if args.which == "random" else args.which)
    if args.timestep_s is not None:
        robot = robot.with_physics(timestep_s=args.timestep_s)
    physics, seed = robot.physics, robot.config.seed
    if args.which == "random":
        actor = RandomActor(make_env(robot.config).action_space, seed)
        robot = replace(robot, policy=Policy(actor, None))
    robots = [
        robot.with_physics(friction=friction, mismatch_seed=mismatch_seed)
        for friction, mismatch_seed in product(
            args.frictions or (physics.friction,), args.mismatch_seeds or (physics.mismatch_seed,)
        )
    ]
    rows: list[dict[str, Any]] = []
    fitness_m: list[float] = []
    for variant, episode in product(robots, range(args.episodes)):
        outcome = variant.simulate(seed=seed + episode)
        fitness_m += outcome.fitness().tolist()
        rows.append(
            {
                "friction": variant.physics.friction,
                "mismatch_seed": variant.physics.mismatch_seed,
                "episode": episode,
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
