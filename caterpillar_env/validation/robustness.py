"""Sensitivity of evolved robots to changes of physics parameters and genes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from caterpillar_env.arrays import Array
from caterpillar_env.gait import GaitTimings
from caterpillar_env.morphology import PARAMETERS, Morphology
from caterpillar_env.physics import Physics
from caterpillar_env.robot import Robot, simulate
from caterpillar_env.task import EPISODE_S
from caterpillar_env.validation.check import Check, check_near
from caterpillar_env.validation.robots import stack_robots

STOPS = "softness of the joint stops 2.5 / 10 ms"
SHARES = (0.01, 0.03, 0.10)  #: gene changes, relative to the gene range or to the gait period
SEED = 12

#: Label, field of `Physics` or of its spring, low value, high value.
_PARAMETERS: tuple[tuple[str, str, float, float], ...] = (
    ("friction 0.4 / 1.2", "friction", 0.4, 1.2),
    ("neck stiffness 3e-3 / 12e-3 N m/rad", "neck_stiffness_n_m_rad", 3e-3, 12e-3),
    ("neck damping 1e-4 / 3e-4 N m s/rad", "neck_damping_n_m_s_rad", 1e-4, 3e-4),
    ("neck stiffening 3 / 8", "neck_stiffening", 3.0, 8.0),
    (STOPS, "stop_time_constant_s", 0.0025, 0.01),
    ("softness of the ground 5 / 20 ms", "contact_time_constant_s", 0.005, 0.02),
    ("coil shielding 0.5 / 1", "spring.coil_shielding", 0.5, 1.0),
    ("austenite stiffness 25 / 45 N/m", "spring.austenite_stiffness_n_m", 25.0, 45.0),
    ("martensite stiffness 12 / 17 N/m", "spring.martensite_stiffness_n_m", 12.0, 17.0),
    ("martensite rest length 20 / 24 mm", "spring.martensite_rest_length_m", 0.020, 0.024),
    ("ambient 15 / 35 degC", "spring.ambient_c", 15.0, 35.0),
    ("mismatch: two other seeds", "mismatch_seed", 1001, 1002),
)


class Swing(NamedTuple):
    """Distances with a low and a high value of one parameter, m, (robots,); 0 for failed robots."""

    name: str
    low_m: Array
    high_m: Array


def _change(physics: Physics, field: str, value: float) -> Physics:
    if field.startswith("spring."):
        spring = replace(physics.spring, **{field.removeprefix("spring."): value})
        return replace(physics, spring=spring)
    return replace(physics, **{field: value})  # type: ignore[arg-type]


def vary_parameters(robots: Sequence[Robot]) -> tuple[Array, list[Swing]]:
    """Return the unchanged distances, m, (robots,), and the distances with changed parameters."""
    bodies, timings = stack_robots(robots)
    physics = robots[0].physics

    def distances_m(physics: Physics, timings: GaitTimings = timings) -> Array:
        return simulate(bodies, timings, physics).fitness()

    swings = [
        Swing(name, *(distances_m(_change(physics, field, value)) for value in (low, high)))
        for name, field, low, high in _PARAMETERS
    ]
    paces = (
        GaitTimings(factor * timings.period_s, factor * timings.on_s, factor * timings.off_s)
        for factor in (0.8, 1.2)
    )
    paced_m = (distances_m(physics, pace) for pace in paces)
    swings.append(Swing("gait period 4 / 6 s, same shares", *paced_m))
    return distances_m(physics), swings


def check_stops(robots: Sequence[Robot]) -> list[Check]:
    """Check that the softness of the joint stops has little effect on the median distance."""
    bodies, timings = stack_robots(robots)
    medians_m = []
    for factor in (0.5, 1.0, 2.0):
        time_constant_s = factor * robots[0].physics.stop_time_constant_s
        physics = replace(robots[0].physics, stop_time_constant_s=time_constant_s)
        medians_m.append(float(np.median(simulate(bodies, timings, physics).fitness())))
    hard_m, base_m, soft_m = medians_m
    return [
        check_near(
            f"median distance with {word} the time constant of the joint stops",
            1000 * base_m, 1000 * got_m, "mm", rel=0.1,
        )
        for word, got_m in (("half", hard_m), ("twice", soft_m))
    ]  # fmt: skip


def plot_parameters(base_m: Array, swings: Sequence[Swing], path: Path) -> None:
    """Plot distances relative to the unchanged robots, with one dot per robot and median bars."""
    figure = Figure(figsize=(9, 0.55 * len(swings) + 1.4), layout="constrained")
    axis = figure.subplots()
    order = sorted(
        swings,
        key=lambda s: float(np.ptp([np.median(s.low_m / base_m), np.median(s.high_m / base_m), 1.0])),
    )
    for row, swing in enumerate(order):
        for values, colour in ((swing.low_m / base_m, "tab:blue"), (swing.high_m / base_m, "tab:red")):
            axis.barh(row, np.median(values) - 1, left=1, color=colour, alpha=0.4, height=0.6)
            axis.plot(values, np.full(len(values), row), ".", color=colour)
    axis.axvline(1.0, color="black", linewidth=0.8)
    axis.set(yticks=range(len(order)), yticklabels=[s.name for s in order])
    axis.set_xlabel(
        "distance relative to the unchanged robot (blue: low, red: high; 0: failed or backwards)"
    )
    axis.grid(axis="x", alpha=0.3)
    figure.savefig(path, dpi=110)


def perturb_genes(robot: Robot, share: float, rng: np.random.Generator) -> list[Robot]:
    """Return one robot per gene, with that gene changed up or down by `share` of its range.

    A body gene changes in the opposite direction if it would leave its bounds. Times wrap around the
    gait period.
    """
    assert isinstance(robot.morphology, Morphology)
    unit, period_s = robot.morphology.to_unit(), robot.timings.period_s
    times = np.stack([robot.timings.on_s, robot.timings.off_s], axis=-1)
    robots = []
    for gene, sign in enumerate(rng.choice([-1.0, 1.0], len(unit) + times.size)):
        if gene < len(unit):
            changed = unit.copy()
            changed[gene] += sign * share if 0 <= unit[gene] + sign * share <= 1 else -sign * share
            robots.append(replace(robot, morphology=Morphology.from_unit(changed)))
        else:
            moved = times.copy()
            moved.flat[gene - len(unit)] += sign * share * period_s
            moved %= period_s
            timings = GaitTimings(period_s, moved[:, 0], moved[:, 1])
            robots.append(replace(robot, timings=timings))
    return robots


def vary_genes(robots: Sequence[Robot], duration_s: float = EPISODE_S) -> Array:
    """Return distances relative to the unchanged robots, (shares, robots, genes); 0 for failures."""
    rng = np.random.default_rng(SEED)
    changed = [r for share in SHARES for robot in robots for r in perturb_genes(robot, share, rng)]
    bodies, timings = stack_robots([*robots, *changed])
    fitness_m = simulate(bodies, timings, robots[0].physics, duration_s=duration_s).fitness()
    base_m, changed_m = np.split(fitness_m, [len(robots)])
    ratios: Array = changed_m.reshape(len(SHARES), len(robots), -1) / base_m[:, None]
    return ratios


def plot_genes(ratios: Array, names: Sequence[str], path: Path) -> None:
    """Plot quartiles of the relative distances for each gene and each change.

    Args:
        ratios: result of `vary_genes`.
        names: names of the genes.
        path: image file to write.
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
    axis.axhline(len(PARAMETERS) - 0.5, color="grey", linewidth=0.6)  # separates body and gait
    axis.set(yticks=rows, yticklabels=names)
    axis.set_xlabel("distance relative to the unchanged robot (median and quartiles; 0: failed)")
    axis.invert_yaxis()
    axis.grid(axis="x", alpha=0.3)
    axis.legend(loc="upper left")
    figure.savefig(path, dpi=110)
