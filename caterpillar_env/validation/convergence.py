"""Comparison of the default numerical settings with two references at a timestep of 0.25 ms.

One reference uses the default integrator. The other, called independent, uses the fourth-order
Runge-Kutta method.
"""

from __future__ import annotations

import time
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.stats import spearmanr

from caterpillar_env.arrays import Array
from caterpillar_env.physics import Physics
from caterpillar_env.robot import Outcomes, simulate, stack
from caterpillar_env.task import EPISODE_S, Failure
from caterpillar_env.validation.check import Check, check_at_least, check_at_most
from caterpillar_env.validation.robots import (
    crawl_for,
    evolved_robots,
    farthest_robots,
    random_robots,
    stack_power,
)

SPREAD = 10  #: number of evolved robots that are also simulated from a start moved by 1 um
INDEPENDENT = 12  #: number of evolved robots for the independent reference, which is slow


class Pair(NamedTuple):
    """Outcomes of the same robots with two settings."""

    ours: Outcomes
    reference: Outcomes

    @property
    def failed(self) -> NDArray[np.bool_]:
        """Whether each robot fails in each simulation, (2, robots)."""
        return np.stack([outcomes.failure != Failure.NONE for outcomes in self])

    def agreement(self) -> float:
        """Return the share of robots that fail in both simulations or in neither."""
        return float((self.failed[0] == self.failed[1]).mean())

    def distances_m(self) -> Array:
        """Return the distances of the robots that fail in neither simulation, (2, robots)."""
        return np.stack([outcomes.distance_m for outcomes in self])[:, ~self.failed.any(axis=0)]

    def median_error(self) -> float:
        """Return the median relative error of the distance of robots that fail in neither simulation."""
        ours_m, reference_m = self.distances_m()
        return float(np.median(np.abs(ours_m - reference_m) / np.abs(reference_m)))


def rank_correlation(*pairs: Pair) -> float:
    """Return Spearman's rank correlation of the distances of robots that fail in neither simulation."""
    return float(spearmanr(*np.hstack([pair.distances_m() for pair in pairs])).statistic)


class Comparison(NamedTuple):
    """Outcomes of random and evolved robots."""

    random: Pair
    evolved: Pair
    independent: Pair  #: the first evolved robots with default settings, and with Runge-Kutta
    #: the first evolved robots with reference settings, from a start moved by 1 um and the usual start
    nudged: Pair


def compare(*, quick: bool) -> Comparison:
    """Simulate random and evolved robots with the default and the reference settings."""
    physics, duration_s = Physics(), 10.0 if quick else EPISODE_S
    fine = replace(physics, timestep_s=0.001 if quick else 0.00025)
    exact = replace(fine, integrator="rk4", timestep_s=0.0005 if quick else 0.00025)
    robots = random_robots(24 if quick else 100, 3, physics)
    evolved = farthest_robots(6) if quick else evolved_robots()
    random_pair, evolved_pair = (
        Pair(*(simulate(*stack(group), p, duration_s=duration_s) for p in (physics, fine)))
        for group in (robots, evolved)
    )
    few = evolved[: 3 if quick else INDEPENDENT]
    independent = simulate(*stack(few), exact, duration_s=duration_s)
    nudged = crawl_for(duration_s, *stack_power(evolved[:SPREAD]), fine, offset_m=1e-6).progress()
    return Comparison(
        random_pair,
        evolved_pair,
        Pair(evolved_pair.ours.rows(slice(len(few))), independent),
        Pair(Outcomes.of(nudged), evolved_pair.reference.rows(slice(SPREAD))),
    )


def check_timestep(result: Comparison) -> list[Check]:
    """Check failure agreement, rank correlation and distance errors."""
    spread = result.nudged.median_error()
    return [
        check_at_least("agreement of failures, random robots", 0.95, result.random.agreement(), ""),
        check_at_least("agreement of failures, evolved robots", 0.95, result.evolved.agreement(), ""),
        check_at_least(
            "rank correlation of distances, all robots",
            0.95, rank_correlation(result.random, result.evolved), "",
        ),
        check_at_most(
            f"median relative error of evolved distances (for a start moved by 1 um: {spread:.4f})",
            0.05, result.evolved.median_error(), "",
        ),
        check_at_most(
            "median relative error of evolved distances, against Runge-Kutta",
            0.05, result.independent.median_error(), "",
        ),
    ]  # fmt: skip


def plot(result: Comparison, path: Path) -> None:
    """Plot default against reference distances, and the distributions of errors and spread."""
    figure = Figure(figsize=(10, 4.5), layout="constrained")
    left, right = figure.subplots(1, 2)
    for pair, colour, word in (
        (result.random, "tab:blue", "random"),
        (result.evolved, "tab:red", "evolved"),
    ):
        coarse, fine = 1000 * pair.distances_m()
        left.plot(fine, coarse, ".", color=colour, label=word)
    left.axline((0, 0), slope=1, color="black", linewidth=0.7)
    left.set(xlabel="distance at the reference (mm)", ylabel="distance at the default timestep (mm)")
    for pair, word in (
        (result.evolved, "default timestep"),
        (result.nudged, "1 um change of the start"),
    ):
        ours, reference = 1000 * pair.distances_m()
        errors = np.sort(np.abs(ours - reference))
        right.step(np.maximum(errors, 1e-4), np.linspace(0, 1, len(errors)), label=word)
    right.set(xlabel="difference from the reference (mm), evolved robots", ylabel="share of robots")
    right.set_xscale("log")
    for axis in (left, right):
        axis.legend(loc="upper left")
        axis.grid(alpha=0.3)
    figure.savefig(path, dpi=110)


#: Changes of `Physics` to compare. The reference for each has the same physical parameters.
SETTINGS: dict[str, dict[str, Any]] = {
    "default": {},
    "timestep 10 ms": {"timestep_s": 0.01},
    "timestep 5 ms": {"timestep_s": 0.005},
    "timestep 2 ms": {"timestep_s": 0.002},
    "timestep 1 ms": {"timestep_s": 0.001},
    "CG": {"solver": "cg"},
    "implicitfast": {"integrator": "implicitfast"},
    "implicitfast, 1 ms": {"integrator": "implicitfast", "timestep_s": 0.001},
    "pyramidal cone": {"cone": "pyramidal"},
    "tolerance 1e-10": {"solver_tolerance": 1e-10},
    "tolerance 1e-6": {"solver_tolerance": 1e-6},
    "impratio 10": {"impratio": 10.0},
    "impratio 30": {"impratio": 30.0},
    "contact time constant 5 ms": {"contact_time_constant_s": 0.005},
    "contact time constant 20 ms": {"contact_time_constant_s": 0.02},
    "stop time constant 10 ms": {"stop_time_constant_s": 0.01},
    "no stiffening of the neck": {"neck_stiffening": 0.0},
    "neck damping 1e-4": {"neck_damping_n_m_s_rad": 1e-4},
    "neck damping 5e-5": {"neck_damping_n_m_s_rad": 5e-5},
}
_NUMERICAL = ("timestep_s", "solver", "integrator", "solver_tolerance")


def compare_settings() -> list[dict[str, float | str]]:
    """Compare accuracy and cost of `SETTINGS` on 16 evolved robots.

    Returns:
        One row per setting. `cost_us_per_ms` is the computing time on one thread, in microseconds per
        simulated millisecond and robot. The other columns compare the distances and failures with a
        reference at a timestep of 0.5 ms.
    """
    robots = stack(evolved_robots(16))
    references: dict[str, Outcomes] = {}
    rows: list[dict[str, float | str]] = []
    for name, changes in SETTINGS.items():
        physical = {k: v for k, v in changes.items() if k not in _NUMERICAL}
        key = repr(physical)
        if key not in references:
            fine = replace(Physics(), **physical, timestep_s=0.0005, solver_tolerance=1e-10)
            references[key] = simulate(*robots, fine)
        started = time.perf_counter()
        coarse = simulate(*robots, replace(Physics(), **changes), threads=1)
        wall_s = time.perf_counter() - started
        pair = Pair(coarse, references[key])
        rows.append(
            {
                "setting": name,
                "cost_us_per_ms": 1e3 * wall_s / float(coarse.simulated_s.sum()),
                "median_error": pair.median_error(),
                "rank_correlation": rank_correlation(pair),
                "failure_agreement": pair.agreement(),
            }
        )
    return rows
