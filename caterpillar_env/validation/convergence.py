"""Comparison of the default numerical settings with two references at a timestep of 0.25 ms.

One reference uses the default integrator. The independent one uses the fourth-order Runge-Kutta method.
"""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.stats import spearmanr

from caterpillar_env.arrays import Array
from caterpillar_env.physics import Physics
from caterpillar_env.robot import Outcomes, simulate
from caterpillar_env.task import EPISODE_S, Failure
from caterpillar_env.validation.check import Check, check_at_least, check_at_most
from caterpillar_env.validation.robots import (
    crawl_for,
    evolved_robots,
    farthest_robots,
    random_robots,
    stack_power,
    stack_robots,
)

SPREAD = 10  #: number of evolved robots whose intrinsic spread is measured
INDEPENDENT = 12  #: number of evolved robots for the independent reference, which is ten times slower


@dataclass(frozen=True)
class Comparison:
    """Outcomes of robots with the default settings and with the reference settings."""

    default: Outcomes
    reference: Outcomes
    evolved: NDArray[np.bool_]  #: True for evolved robots, False for random ones
    #: Reference distance changes of the first `SPREAD` evolved robots if the start moves by 1 um.
    spread_m: Array
    independent: Outcomes | None = None  #: Runge-Kutta results of the first evolved robots

    def agreement(self, evolved: bool) -> float:
        """Return the share of robots that fail in both simulations or in neither."""
        who = self.evolved == evolved
        failed = [o.failure[who] != Failure.NONE for o in (self.default, self.reference)]
        return float((failed[0] == failed[1]).mean())

    @property
    def healthy(self) -> NDArray[np.bool_]:
        """True for robots that fail in neither simulation."""
        failures = self.default.failure | self.reference.failure
        healthy: NDArray[np.bool_] = failures == Failure.NONE
        return healthy

    def errors(self) -> Array:
        """Return the relative distance errors of healthy evolved robots."""
        who = self.healthy & self.evolved
        fine = self.reference.distance_m[who]
        return np.abs(self.default.distance_m[who] - fine) / np.abs(fine)

    def independent_errors(self) -> Array:
        """Return the relative distance errors with respect to the independent reference."""
        assert self.independent is not None
        exact = self.independent.distance_m
        ours = self.default.distance_m[self.evolved][: len(exact)]
        healthy = self.healthy[self.evolved][: len(exact)] & (self.independent.failure == Failure.NONE)
        errors: Array = (np.abs(ours - exact) / np.abs(exact))[healthy]
        return errors

    def rank_correlation(self) -> float:
        """Return Spearman's rank correlation of the distances of all healthy robots."""
        who = self.healthy
        pair = (self.default.distance_m[who], self.reference.distance_m[who])
        return float(spearmanr(*pair).statistic)


def compare(*, quick: bool) -> Comparison:
    """Simulate random and evolved robots with the default and the reference settings."""
    physics, duration_s = Physics(), 10.0 if quick else EPISODE_S
    fine = replace(physics, timestep_s=0.001 if quick else 0.00025)
    exact = replace(fine, integrator="rk4", timestep_s=0.0005 if quick else 0.00025)
    evolved = farthest_robots(8) if quick else evolved_robots()
    robots = [*random_robots(32 if quick else 100, 3, physics), *evolved]
    is_evolved = np.arange(len(robots)) >= len(robots) - len(evolved)
    coarse_run, fine_run = (
        simulate(*stack_robots(robots), p, duration_s=duration_s) for p in (physics, fine)
    )
    nudged = crawl_for(duration_s, *stack_power(evolved[:SPREAD]), fine, offset_m=1e-6).progress()
    few = stack_robots(evolved[: 4 if quick else INDEPENDENT])
    spread_m = np.abs(nudged.distance_m - fine_run.distance_m[is_evolved][:SPREAD])
    independent = simulate(*few, exact, duration_s=duration_s)
    return Comparison(coarse_run, fine_run, is_evolved, spread_m, independent)


def check_timestep(result: Comparison) -> list[Check]:
    """Check failure agreement, rank correlation and distance errors."""
    errors = result.errors()
    fine = np.abs(result.reference.distance_m[result.evolved][: len(result.spread_m)])
    spread = float(np.median(result.spread_m / fine))
    return [
        check_at_least("agreement of failures, random robots", 0.95, result.agreement(False), ""),
        check_at_least("agreement of failures, evolved robots", 0.95, result.agreement(True), ""),
        check_at_least("rank correlation of distances, all robots", 0.95, result.rank_correlation(), ""),
        check_at_most(
            f"median relative error of evolved distances (from a start moved by 1 um: {spread:.4f})",
            0.05, float(np.median(errors)), "",
        ),
        check_at_most(
            "median relative error of evolved distances, against Runge-Kutta",
            0.05, float(np.median(result.independent_errors())), "",
        ),
    ]  # fmt: skip


def plot(result: Comparison, path: Path) -> None:
    """Plot default against reference distances, and the distributions of errors and spread."""
    figure = Figure(figsize=(10, 4.5), layout="constrained")
    left, right = figure.subplots(1, 2)
    fine, coarse = 1000 * result.reference.distance_m, 1000 * result.default.distance_m
    for who, colour, word in (
        (result.healthy & ~result.evolved, "tab:blue", "random"),
        (result.healthy & result.evolved, "tab:red", "evolved"),
    ):
        left.plot(fine[who], coarse[who], ".", color=colour, label=word)
    left.axline((0, 0), slope=1, color="black", linewidth=0.7)
    left.set(xlabel="distance at the reference (mm)", ylabel="distance at the default timestep (mm)")
    errors = np.sort(np.abs(coarse - fine)[result.healthy & result.evolved])
    spread = np.sort(1000 * result.spread_m)
    right.step(np.maximum(errors, 1e-4), np.linspace(0, 1, len(errors)), label="default timestep")
    right.step(
        np.maximum(spread, 1e-4), np.linspace(0, 1, len(spread)), label="1 um change of the start"
    )
    right.set(xlabel="difference from the reference (mm), evolved robots", ylabel="share of robots")
    right.set_xscale("log")
    for axis in (left, right):
        axis.legend()
        axis.grid(alpha=0.3)
    figure.savefig(path, dpi=110)


#: Settings to compare. Each is compared with a reference of the same physical parameters.
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


def compare_settings(count: int = 16, duration_s: float = EPISODE_S) -> list[dict[str, float | str]]:
    """Compare accuracy and cost of `SETTINGS` on the first `count` evolved robots.

    Returns:
        One row per setting: cost in microseconds per simulated millisecond and robot on one thread.
        Median relative error, rank correlation and failure agreement refer to a timestep of 0.5 ms.
    """
    robots = stack_robots(evolved_robots(count))
    references: dict[str, Outcomes] = {}
    rows: list[dict[str, float | str]] = []
    for name, changes in SETTINGS.items():
        physical = {k: v for k, v in changes.items() if k not in _NUMERICAL}
        key = repr(physical)
        if key not in references:
            fine = replace(Physics(), **physical, timestep_s=0.0005, solver_tolerance=1e-10)
            references[key] = simulate(*robots, fine, duration_s=duration_s)
        started = time.perf_counter()
        coarse = simulate(*robots, replace(Physics(), **changes), threads=1, duration_s=duration_s)
        wall_s = time.perf_counter() - started
        result = Comparison(coarse, references[key], np.ones(count, dtype=bool), np.zeros(count))
        rows.append(
            {
                "setting": name,
                "cost_us_per_ms": 1e3 * wall_s / float(coarse.simulated_s.sum()),
                "median_error": float(np.median(result.errors())),
                "rank_correlation": result.rank_correlation(),
                "failure_agreement": result.agreement(True),
            }
        )
    return rows
