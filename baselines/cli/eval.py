"""`caterpillar rl eval`."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
import tyro

from baselines.policy import AtRandom, Policy, TrainedRobot, judge
from caterpillar_env.errors import CaterpillarError
from caterpillar_env.physics import Physics
from caterpillar_env.robot import Outcomes
from caterpillar_env.task import label
from evolution import cli
from evolution.cli.running import film


@dataclass(frozen=True)
class EvalArgs:
    """Let a trained policy crawl: as it was judged, drawing its actions, or on other ground."""

    folder: Annotated[Path, tyro.conf.Positional]
    """A training's folder."""
    which: Literal["best", "last", "random"] = "best"
    """Which of the policies that were kept; random: no policy, actions drawn evenly."""
    stochastic: bool = False
    """Draw actions as in training, instead of taking the likeliest."""
    episodes: int = 1
    """How many episodes; for more than one draw actions, or all would be alike."""
    frictions: tuple[float, ...] = ()
    """Crawl at each of these friction coefficients, instead of the training's."""
    mismatch_seeds: tuple[int, ...] = ()
    """Crawl as each of these robots, instead of the training's: draws of springs' strengths."""
    timestep_s: float | None = None
    """Another timestep than the training's, in s."""
    json: bool = False
    """Print JSON instead of sentences."""
    video: bool = False
    """Write eval.mp4 into the folder, of the first episode."""

    def __post_init__(self) -> None:
        if self.episodes < 1:
            raise CaterpillarError(f"episodes = {self.episodes} must be at least 1")
        if self.video and self.drawn:
            raise CaterpillarError(
                "--video shows the likeliest actions: leave it out, or leave out --stochastic and "
                "--which random"
            )
        if self.episodes > 1 and not self.drawn:
            raise CaterpillarError(
                f"{self.episodes} episodes of the likeliest actions are all alike: add --stochastic to "
                "draw actions, or leave out --episodes"
            )

    @property
    def drawn(self) -> bool:
        """Whether actions are drawn."""
        return self.stochastic or self.which == "random"


def eval_command(argv: Sequence[str]) -> int:
    """`caterpillar rl eval`."""
    args = cli.parse(EvalArgs, argv, "rl eval")
    drawn = args.drawn
    robot = TrainedRobot.load(args.folder, "last" if args.which == "last" else "best")
    if args.which == "random":
        space = judge(robot.config).action_space
        robot = replace(robot, policy=Policy(AtRandom(space, robot.config.seed), None))
    rows = []
    for physics in _settings(robot.physics, args):
        for episode in range(args.episodes):
            outcome = replace(robot, physics=physics).simulate(
                args.timestep_s, seed=robot.config.seed + episode, deterministic=not drawn
            )
            rows.append(_row(physics, episode, outcome))
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
            fitness = [row["distance_m"] if row["failure"] == "ok" else 0.0 for row in rows]
            low, middle, high = 1000 * np.quantile(fitness, [0.25, 0.5, 0.75])
            print(f"median {middle:.1f} mm, quartiles {low:.1f} to {high:.1f}, failures counted as 0")
    if args.video:
        first = replace(robot, physics=_settings(robot.physics, args)[0])
        film(first, args.folder / "eval.mp4", cli.console(), args.timestep_s)
    return 0


def _settings(physics: Physics, args: EvalArgs) -> list[Physics]:
    """Every friction on every robot asked for."""
    return [
        replace(physics, friction=friction, mismatch_seed=seed)
        for friction in args.frictions or (physics.friction,)
        for seed in args.mismatch_seeds or (physics.mismatch_seed,)
    ]


def _row(physics: Physics, episode: int, outcome: Outcomes) -> dict[str, Any]:
    return {
        "friction": physics.friction,
        "mismatch_seed": physics.mismatch_seed,
        "episode": episode,
        "distance_m": float(outcome.distance_m[0]),
        "energy_j": float(outcome.energy_j[0]),
        "time_s": float(outcome.simulated_s[0]),
        "failure": label(outcome.failure[0]),
    }
