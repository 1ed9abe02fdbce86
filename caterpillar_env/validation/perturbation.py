"""How far evolved robots crawl when each of their genes is a little off, as hardware always is."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from caterpillar_env.arrays import Array
from caterpillar_env.gait import GaitTimings
from caterpillar_env.morphology import PARAMETERS, Morphology
from caterpillar_env.robot import Robot, simulate
from caterpillar_env.task import EPISODE_S
from caterpillar_env.validation.robots import together

SHARES = (0.01, 0.03, 0.10)  #: of a gene's range, the gait period being that of a time
_SEED = 12


def perturbed(robot: Robot, share: float, rng: np.random.Generator) -> list[Robot]:
    """One robot for each gene, with that gene off by `share` of its range, up or down.

    Genes of the body turn back at their bounds, times pass round the end of the period.
    """
    assert isinstance(robot.morphology, Morphology)
    unit, period_s = robot.morphology.to_unit(), robot.timings.period_s
    times = np.stack([robot.timings.on_s, robot.timings.off_s], axis=-1)
    robots = []
    for gene, sign in enumerate(rng.choice([-1.0, 1.0], len(unit) + times.size)):
        if gene < len(unit):
            off = unit.copy()
            off[gene] += sign * share if 0 <= off[gene] + sign * share <= 1 else -sign * share
            robots.append(replace(robot, morphology=Morphology.from_unit(off)))
        else:
            moved = times.copy()
            moved.flat[gene - len(unit)] += sign * share * period_s
            moved %= period_s
            timings = GaitTimings(period_s, moved[:, 0], moved[:, 1])
            robots.append(replace(robot, timings=timings))
    return robots


def sweep(robots: Sequence[Robot], duration_s: float = EPISODE_S) -> Array:
    """Distances over those of the unchanged robots, shape (shares, robots, genes); 0 for failed ones."""
    rng = np.random.default_rng(_SEED)
    every = [r for share in SHARES for robot in robots for r in perturbed(robot, share, rng)]
    bodies, timings = together([*robots, *every])
    fitness_m = simulate(bodies, timings, robots[0].physics, duration_s=duration_s).fitness()
    base_m, rest_m = np.split(fitness_m, [len(robots)])
    ratios: Array = rest_m.reshape(len(SHARES), len(robots), -1) / base_m[:, None]
    return ratios


def plot(ratios: Array, names: Sequence[str], path: Path) -> None:
    """Quartiles of the distance that is left, by gene and by the size of the change.

    Args:
        ratios: see `sweep`.
        names: of the genes, in words.
        path: of the picture.
    """
    figure = Figure(figsize=(9, 0.42 * len(names) + 1.6), layout="constrained")
    axis = figure.subplots()
    rows = np.arange(len(names))
    for place, (share, values, colour) in enumerate(
        zip(SHARES, ratios, ("tab:green", "tab:orange", "tab:red"), strict=True)
    ):
        low, middle, high = np.percentile(values, [25, 50, 75], axis=0)
        axis.errorbar(
            middle, rows + 0.22 * (place - 1), xerr=[middle - low, high - middle], fmt="o",
            color=colour, markersize=4, label=f"{100 * share:g} % of the range",
        )  # fmt: skip
    axis.axvline(1.0, color="black", linewidth=0.8)
    axis.axhline(len(PARAMETERS) - 0.5, color="grey", linewidth=0.6)  # below it the body, above the gait
    axis.set(yticks=rows, yticklabels=names)
    axis.set_xlabel("distance relative to the unchanged robot (median and quartiles; 0: failed)")
    axis.invert_yaxis()
    axis.grid(axis="x", alpha=0.3)
    axis.legend(loc="upper left")
    figure.savefig(path, dpi=110)
