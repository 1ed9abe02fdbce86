"""Does a finer timestep tell the same story? The default numerics against two references of 0.25 ms.

One has the default integrator, the other, independent one Runge and Kutta's of fourth order.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from scipy.stats import spearmanr

from caterpillar_env.arrays import Array
from caterpillar_env.gait import GaitTimings
from caterpillar_env.morphology import Body
from caterpillar_env.physics import SMA_STEP_S, Physics
from caterpillar_env.robot import Outcomes, simulate
from caterpillar_env.task import EPISODE_S, Failure
from caterpillar_env.validation.check import Check, at_least, at_most
from caterpillar_env.validation.mechanics import crawl_for
from caterpillar_env.validation.robots import evolved_robots, farthest_robots, random_robots, together

SPREAD = 10  #: evolved robots whose intrinsic spread is measured
INDEPENDENT = 12  #: evolved robots that the independent reference takes on: it is ten times as dear


def reference(physics: Physics, *, quick: bool) -> Physics:
    """The same robot on a timestep of 0.25 ms (1 ms when quick)."""
    return replace(physics, timestep_s=0.001 if quick else 0.00025)


@dataclass(frozen=True)
class Comparison:
    """Distances and failures of robots at the default numerics and at the reference."""

    default: Outcomes
    reference: Outcomes
    evolved: NDArray[np.bool_]  #: which of them are evolved, the others being random
    spread_m: Array  #: of the first `SPREAD` evolved ones at the reference, after a change of 1 um
    independent: Outcomes | None = None  #: the first evolved ones with the Runge-Kutta integrator

    def agreement(self, evolved: bool) -> float:
        """Share of the robots whose verdict (failed or not) is the same."""
        who = self.evolved == evolved
        failed = [o.failure[who] != Failure.NONE for o in (self.default, self.reference)]
        return float((failed[0] == failed[1]).mean())

    @property
    def healthy(self) -> NDArray[np.bool_]:
        """Robots that fail in neither."""
        sound: NDArray[np.bool_] = (self.default.failure == Failure.NONE) & (
            self.reference.failure == Failure.NONE
        )
        return sound

    def errors(self) -> Array:
        """Relative errors of the distances of healthy evolved robots."""
        who = self.healthy & self.evolved
        fine = self.reference.distance_m[who]
        return np.abs(self.default.distance_m[who] - fine) / np.abs(fine)

    def independent_errors(self) -> Array:
        """Relative errors of the distances against the independent reference."""
        assert self.independent is not None
        exact = self.independent.distance_m
        ours = self.default.distance_m[self.evolved][: len(exact)]
        healthy = self.healthy[self.evolved][: len(exact)] & (self.independent.failure == Failure.NONE)
        errors: Array = (np.abs(ours - exact) / np.abs(exact))[healthy]
        return errors

    def rank_correlation(self) -> float:
        """Spearman's, over healthy robots of both kinds."""
        who = self.healthy
        pair = (self.default.distance_m[who], self.reference.distance_m[who])
        return float(spearmanr(*pair).statistic)


def compare(*, quick: bool) -> Comparison:
    """Run random and evolved robots at both timesteps."""
    physics = Physics()
    fine = reference(physics, quick=quick)
    evolved = farthest_robots(8) if quick else evolved_robots()
    bodies, timings = _joined(random_robots(32 if quick else 100, 3, physics), together(evolved))
    duration_s = 10.0 if quick else EPISODE_S
    coarse_run = simulate(bodies, timings, physics, duration_s=duration_s)
    fine_run = simulate(bodies, timings, fine, duration_s=duration_s)
    best, gaits = together(evolved[:SPREAD])
    nudged = crawl_for(
        duration_s, best, gaits.mirrored().power(SMA_STEP_S), fine, offset_m=1e-6
    ).progress()
    runge_kutta = replace(fine, integrator="rk4", timestep_s=0.0005 if quick else 0.00025)
    few = together(evolved[: 4 if quick else INDEPENDENT])
    independent = simulate(*few, runge_kutta, duration_s=duration_s)
    is_evolved = np.arange(len(bodies)) >= len(bodies) - len(evolved)
    return Comparison(
        coarse_run,
        fine_run,
        is_evolved,
        np.abs(nudged.distance_m - fine_run.distance_m[is_evolved][: len(best)]),
        independent,
    )


def _joined(
    first: tuple[Sequence[Body], GaitTimings], second: tuple[Sequence[Body], GaitTimings]
) -> tuple[list[Body], GaitTimings]:
    (bodies, a), (more, b) = first, second
    on, off = np.concatenate([a.on_s, b.on_s]), np.concatenate([a.off_s, b.off_s])
    return [*bodies, *more], GaitTimings(a.period_s, on, off)


def checks(result: Comparison) -> list[Check]:
    """The figures that the choice of numerics must keep."""
    errors = result.errors()
    fine = np.abs(result.reference.distance_m[result.evolved][: len(result.spread_m)])
    spread = float(np.median(result.spread_m / fine))
    return [
        at_least("failure verdicts that agree, random robots", 0.95, result.agreement(False), ""),
        at_least("failure verdicts that agree, evolved robots", 0.95, result.agreement(True), ""),
        at_least("rank correlation of distances, all robots", 0.95, result.rank_correlation(), ""),
        at_most(
            f"median relative error of evolved distances (a 1 um nudge makes {spread:.4f})",
            0.05, float(np.median(errors)), "",
        ),
        at_most(
            "the same against the Runge-Kutta integrator",
            0.05, float(np.median(result.independent_errors())), "",
        ),
    ]  # fmt: skip


def plot(result: Comparison, path: Path) -> None:
    """Distances at the default over the reference, and errors beside the intrinsic spread."""
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


#: What was weighed against one another; every variant is judged against its own reference.
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


def settings_table(count: int = 16, duration_s: float = EPISODE_S) -> list[dict[str, float | str]]:
    """Accuracy against cost of each of `SETTINGS`, on the `count` best evolved robots.

    Returns:
        A row per setting: cost in microseconds per simulated millisecond and robot (one thread), median
        relative error, rank correlation and agreement of verdicts against 0.5 ms.
    """
    bodies, timings = together(evolved_robots(count))
    references: dict[str, Outcomes] = {}
    rows: list[dict[str, float | str]] = []
    for name, changes in SETTINGS.items():
        physics = replace(Physics(), **changes)
        body_changes = {k: v for k, v in changes.items() if k not in _NUMERICAL}
        key = repr(body_changes)
        if key not in references:
            fine = replace(Physics(), **body_changes, timestep_s=0.0005, solver_tolerance=1e-10)
            references[key] = simulate(bodies, timings, fine, duration_s=duration_s)
        started = time.perf_counter()
        coarse = simulate(bodies, timings, physics, threads=1, duration_s=duration_s)
        wall_s = time.perf_counter() - started
        nothing = np.ones(len(bodies), dtype=bool)
        result = Comparison(coarse, references[key], nothing, np.zeros(len(bodies)))
        rows.append(
            {
                "setting": name,
                "cost_us_per_ms": 1e3 * wall_s / float(coarse.simulated_s.sum()),
                "median_error": float(np.median(result.errors())),
                "rank_correlation": result.rank_correlation(),
                "verdicts_agree": result.agreement(True),
            }
        )
    return rows
