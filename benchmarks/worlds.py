"""Robots in different worlds: their distances, the cost of their steps, and the winners of a study.

    python -m benchmarks.worlds scores                 # about five minutes on two cores
    python -m benchmarks.worlds costs                  # about two minutes
    python -m benchmarks.worlds matrix results/worlds  # three minutes; also takes other studies

Distances are those in 30 s. Robots that fail count as 0.
"""

from __future__ import annotations

import argparse
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from scipy import stats

from benchmarks.harness import Step, interval, report, spread, time_steps
from caterpillar_env.arrays import Array
from caterpillar_env.errors import CaterpillarError
from caterpillar_env.morphology import NAMES, segments_of
from caterpillar_env.physics import SMA_STEP_S, Physics
from caterpillar_env.robot import Outcomes, Robot, simulate, stack, wave_robot
from caterpillar_env.task import Crawl, Failure
from caterpillar_env.validation.robots import (
    evolved_robots,
    random_robots,
    stack_power,
)
from caterpillar_env.worlds import World
from evolution.study.arms import EvolutionArm
from evolution.study.config import Cell, load
from evolution.study.results import collect, read_runs
from evolution.study.statistics import holm
from evolution.study.winners import load_winner, save_winner

WORLDS = (
    "flat", "slope", "slope:direction=down", "slope:direction=across", "steps", "steps:direction=down",
    "rough", "patches",
)  # fmt: skip


def crawl(robots: Sequence[Robot], world: World) -> Outcomes:
    """Simulate robots in a world."""
    return simulate(*stack(robots), replace(robots[0].physics, world=world))


def fitness_mm(robots: Sequence[Robot], world: World) -> Array:
    """Return the distances of robots in a world, mm, (robots,)."""
    return 1000 * crawl(robots, world).fitness()


def compare_scores(count: int, worlds: Sequence[str] = WORLDS) -> None:
    """Print distances of a hand-made wave, of robots evolved on flat ground, and of random robots."""
    wave, evolved = wave_robot(), evolved_robots()[:count]
    genomes = random_robots(count, 0, Physics())
    rows: list[dict[str, Any]] = []
    for text in worlds:
        world = World.of(text)
        (wave_mm,) = fitness_mm([wave], world)
        evolved_mm, random_mm = fitness_mm(evolved, world), fitness_mm(genomes, world)
        rows.append(
            {
                "world": text,
                "hand-made wave, mm": float(wave_mm),
                "evolved, median mm": float(np.median(evolved_mm)),
                "evolved, best mm": float(evolved_mm.max()),
                "random, median mm": float(np.median(random_mm)),
                "random, best mm": float(random_mm.max()),
            }
        )
    report(f"distances: 1, {len(evolved)} and {count} robots", rows)


def compare_costs(count: int, repeats: int, worlds: Sequence[str] = WORLDS) -> None:
    """Print the cost of a gait period of crawling robots, relative to flat ground, on one thread."""
    bodies, power = stack_power([wave_robot()] * count)

    def begin(text: str) -> Step:
        crawl = Crawl(bodies, Physics(world=World.of(text)), threads=1, stop_on_failure=False)
        return lambda _: crawl.run(power)

    costs = time_steps({text: partial(begin, text) for text in worlds}, 3, repeats)
    steps = count * power.shape[1] * round(SMA_STEP_S / Physics().timestep_s)
    report(
        f"cost of a step: {count} robots",
        [
            {
                "world": text,
                "ratio to flat": spread(cost / costs["flat"]),
                "us per physics step": spread(1e6 * cost / steps),
            }
            for text, cost in costs.items()
        ],
    )


def compare_winners(folder: Path) -> None:
    """Test the best robot of every run of a study in the worlds of all arms, and print the distances.

    Random worlds are also tested with another seed. Further tables show the failures and the bodies of
    these robots.
    """
    config = load(folder)
    winners: dict[str, list[Robot]] = {}
    for name, runs in read_runs(collect(config, folder).table, config).items():
        for run in runs:
            robot = load_winner(config, folder, name, run) if run.best_at(config.budget_s) > 0 else None
            if isinstance(robot, Robot):
                save_winner(robot, folder, Cell(name, run.seed))
                winners.setdefault(name, []).append(robot)
    if not winners:
        raise CaterpillarError(f"no run of {folder} is finished; continue with caterpillar study")
    worlds = [arm.config.physics.world for arm in config.arms.values() if isinstance(arm, EvolutionArm)]
    worlds += [
        replace(world, seed=world.seed + 1000)  # type: ignore[call-arg]
        for world in worlds if hasattr(world, "seed")
    ]  # fmt: skip
    distances, failures = [], []
    for name, robots in winners.items():
        distance: dict[str, Any] = {"evolved on": name, "robots": len(robots)}
        failed = dict(distance)
        for world in dict.fromkeys(worlds):
            outcomes = crawl(robots, world)
            distance[str(world)] = interval(1000 * outcomes.fitness())
            kinds = Counter(Failure(code).label for code in outcomes.failure if code != Failure.NONE)
            failed[str(world)] = ", ".join(f"{count} {kind}" for kind, count in kinds.most_common())
        distances.append(distance)
        failures.append(failed)
    report("median distance in mm, with its 95 % interval", distances)
    report("robots that failed", failures)
    _compare_bodies(winners)


def _compare_bodies(winners: dict[str, list[Robot]]) -> None:
    """Print the median of each body parameter in mm, g or rad, and test whether the arms differ."""
    values = {
        name: np.array(
            [segments_of(robot.morphology, robot.physics.num_segments)[0].to_array() for robot in robots]
        )
        for name, robots in winners.items()
    }
    tested = len(values) > 1 and min(map(len, values.values())) > 1
    p = {}
    for column, gene in enumerate(NAMES):
        groups = [array[:, column] for array in values.values()]
        if tested and len(np.unique(np.concatenate(groups))) > 1:
            p[gene] = float(stats.kruskal(*groups).pvalue)
    corrected = holm(p)
    rows = []
    for column, gene in enumerate(NAMES):
        scale = 1.0 if gene.endswith("rad") else 1000.0
        row: dict[str, Any] = {"parameter (mm, g, rad)": gene}
        row |= {name: interval(scale * array[:, column]) for name, array in values.items()}
        rows.append(row | {"Kruskal-Wallis p (Holm)": corrected.get(gene, float("nan"))})
    report("bodies: median with its 95 % interval", rows)


def main() -> None:
    """Run one of the comparisons and print its table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    commands = parser.add_subparsers(dest="command", required=True)
    scores = commands.add_parser("scores", help="distances of hand-made, evolved and random robots")
    scores.add_argument("--robots", type=int, default=100, help="number of random robots")
    costs = commands.add_parser("costs", help="cost of a step relative to flat ground")
    costs.add_argument("--robots", type=int, default=8)
    costs.add_argument("--repeats", type=int, default=5)
    for command in (scores, costs):
        command.add_argument("--worlds", nargs="+", default=WORLDS, metavar="WORLD")
    matrix = commands.add_parser("matrix", help="winners of a study in every world")
    matrix.add_argument("study", type=Path, help="folder of the study")
    args = parser.parse_args()
    if args.command == "scores":
        compare_scores(args.robots, args.worlds)
    elif args.command == "costs":
        compare_costs(args.robots, args.repeats, ["flat", *(w for w in args.worlds if w != "flat")])
    else:
        compare_winners(args.study)


if __name__ == "__main__":
    main()
