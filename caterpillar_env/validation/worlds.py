"""Checks of the worlds: creep on slopes, and convergence with the timestep on uneven ground."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from caterpillar_env.physics import SMA_STEP_S, Physics
from caterpillar_env.robot import Outcomes, simulate, stack
from caterpillar_env.task import EPISODE_S
from caterpillar_env.validation.check import Check, check_at_least, check_at_most
from caterpillar_env.validation.convergence import Pair, rank_correlation
from caterpillar_env.validation.robots import (
    crawl_for,
    evolved_robots,
    random_robots,
    stack_power,
    wave_robots,
)
from caterpillar_env.worlds import Slope, World

UNEVEN = ("steps", "steps:direction=down", "rough")


def check_creep(*, quick: bool) -> list[Check]:
    """Check that unpowered robots hardly creep on slopes where friction should hold them.

    Soft contacts creep under a tangential load. Creep is measured after the robots have settled.
    """
    count, settle_s, watch_s = (3, 20.0, 10.0) if quick else (12, 60.0, 30.0)
    checks = []
    for slope in (Slope(angle_deg=10.0), Slope(angle_deg=20.0), Slope(20.0, "across")):
        physics = Physics(world=slope)
        bodies, _ = stack(random_robots(count, 2, physics))
        power = np.zeros((count, round(watch_s / SMA_STEP_S), physics.num_springs))
        crawl = crawl_for(settle_s, bodies, power, physics, stop_on_failure=False)
        before = crawl.simulation.pose().com_m
        crawl.run(power)
        moved_m = np.linalg.norm(crawl.simulation.pose().com_m - before, axis=1)
        creep_mm = 1000 * moved_m * (EPISODE_S / watch_s)
        checks.append(
            check_at_most(f"{slope}: creep of the centre of mass in 30 s", 2.0, creep_mm.max(), "mm")
        )
    return checks


def compare_timesteps(world: World, *, quick: bool) -> tuple[Pair, Pair]:
    """Simulate robots in a world with the default and a fine timestep, and from a start moved by 1 um.

    Returns:
        A pair with the default and the fine timestep, and a pair with the moved and the usual start at
        the fine timestep. The second pair shows how sensitive the distances are to the start.
    """
    physics = Physics(world=world)
    fine = replace(physics, timestep_s=0.001 if quick else 0.0005)
    count, duration_s = (8, 10.0) if quick else (16, EPISODE_S)
    robots = [*evolved_robots(count // 2), *wave_robots(count // 2, 4, physics)]
    stacked = stack(robots)
    ours, reference = (simulate(*stacked, p, duration_s=duration_s) for p in (physics, fine))
    nudged = crawl_for(duration_s, *stack_power(robots), fine, offset_m=1e-6).progress()
    return Pair(ours, reference), Pair(Outcomes.of(nudged), reference)


def check_convergence(*, quick: bool) -> list[Check]:
    """Check that distances on uneven ground agree with those at a fine timestep."""
    checks = []
    for text in UNEVEN:
        pair, spread = compare_timesteps(World.of(text), quick=quick)
        ours_m, reference_m = pair.distances_m()
        nudged_m, usual_m = spread.distances_m()
        error_mm = 1000 * float(np.median(np.abs(ours_m - reference_m)))
        spread_mm = 1000 * float(np.median(np.abs(nudged_m - usual_m)))
        usual = f"median distance {1000 * np.median(np.abs(reference_m)):.3g} mm"
        nudged = f"moved start {spread_mm:.2g} mm"
        checks += [
            check_at_least(f"{text}: agreement of failures", 0.85, pair.agreement(), ""),
            check_at_least(f"{text}: rank correlation of distances", 0.9, rank_correlation(pair), ""),
            check_at_most(f"{text}: median error ({usual}, {nudged})", 3.0, error_mm, "mm"),
        ]
    return checks
