"""How far evolved gaits carry when the robot is not quite the one they were evolved for."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from caterpillar_env.arrays import Array
from caterpillar_env.gait import GaitTimings
from caterpillar_env.physics import Physics
from caterpillar_env.robot import Robot, simulate
from caterpillar_env.validation.check import Check, near
from caterpillar_env.validation.robots import together

STOPS = "softness of the joint stops 2.5 / 10 ms"


class Swing(NamedTuple):
    """Distances of the robots with one parameter low and high; failed ones count as 0."""

    name: str
    low_m: Array
    high_m: Array


def _set(name: str, value: float) -> Callable[[Physics], Physics]:
    return lambda physics: Physics.of({**physics.to_dict(), name: value})


def _spring(name: str, value: float) -> Callable[[Physics], Physics]:
    return lambda physics: replace(physics, spring=replace(physics.spring, **{name: value}))


_PARAMETERS: tuple[tuple[str, Callable[[Physics], Physics], Callable[[Physics], Physics]], ...] = (
    ("friction 0.4 / 1.2", _set("friction", 0.4), _set("friction", 1.2)),
    ("neck stiffness 3e-3 / 12e-3 N m/rad",
     _set("neck_stiffness_n_m_rad", 3e-3), _set("neck_stiffness_n_m_rad", 12e-3)),
    ("neck damping 1e-4 / 3e-4 N m s/rad",
     _set("neck_damping_n_m_s_rad", 1e-4), _set("neck_damping_n_m_s_rad", 3e-4)),
    ("neck stiffening 3 / 8", _set("neck_stiffening", 3.0), _set("neck_stiffening", 8.0)),
    (STOPS, _set("stop_time_constant_s", 0.0025), _set("stop_time_constant_s", 0.01)),
    ("softness of the ground 5 / 20 ms",
     _set("contact_time_constant_s", 0.005), _set("contact_time_constant_s", 0.02)),
    ("coil shielding 0.5 / 1", _spring("coil_shielding", 0.5), _spring("coil_shielding", 1.0)),
    ("austenite stiffness 25 / 45 N/m",
     _spring("austenite_stiffness_n_m", 25.0), _spring("austenite_stiffness_n_m", 45.0)),
    ("martensite stiffness 12 / 17 N/m",
     _spring("martensite_stiffness_n_m", 12.0), _spring("martensite_stiffness_n_m", 17.0)),
    ("martensite rest length 20 / 24 mm",
     _spring("martensite_rest_length_m", 0.020), _spring("martensite_rest_length_m", 0.024)),
    ("ambient 15 / 35 degC", _spring("ambient_c", 15.0), _spring("ambient_c", 35.0)),
    ("mismatch: two other draws", _set("mismatch_seed", 1001), _set("mismatch_seed", 1002)),
)  # fmt: skip


def sweep(robots: list[Robot]) -> tuple[Array, list[Swing]]:
    """Distances as evolved, and with each parameter low and high, (robots,) each."""
    bodies, timings = together(robots)
    physics = robots[0].physics
    swings = [
        Swing(
            name,
            simulate(bodies, timings, low(physics)).fitness(),
            simulate(bodies, timings, high(physics)).fitness(),
        )
        for name, low, high in _PARAMETERS
    ]
    paces = []
    for factor in (0.8, 1.2):  # the same shares of a shorter or longer period
        period_s = factor * timings.period_s
        paced = GaitTimings(period_s, factor * timings.on_s, factor * timings.off_s)
        paces.append(simulate(bodies, paced, physics).fitness())
    swings.append(Swing("gait period 4 / 6 s, same shares", paces[0], paces[1]))
    return simulate(bodies, timings, physics).fitness(), swings


def stop_checks(robots: list[Robot]) -> list[Check]:
    """The median distance hardly depends on the hardness of the joint stops."""
    bodies, timings = together(robots)
    medians_m = []
    for factor in (0.5, 1.0, 2.0):
        time_constant_s = factor * robots[0].physics.stop_time_constant_s
        physics = replace(robots[0].physics, stop_time_constant_s=time_constant_s)
        medians_m.append(float(np.median(simulate(bodies, timings, physics).fitness())))
    hard_m, base_m, soft_m = medians_m
    return [
        near(f"median distance with {word} the stops' time constant", 1000 * base_m, 1000 * got_m, "mm",
             rel=0.1)
        for word, got_m in (("half", hard_m), ("twice", soft_m))
    ]  # fmt: skip


def plot(base: Array, swings: list[Swing], path: Path) -> None:
    """Tornado: distance relative to the unchanged robot, a dot a robot, a bar over their medians."""
    figure = Figure(figsize=(9, 0.55 * len(swings) + 1.4), layout="constrained")
    axis = figure.subplots()
    order = sorted(
        swings, key=lambda s: float(np.ptp([np.median(s.low_m / base), np.median(s.high_m / base), 1.0]))
    )
    for row, swing in enumerate(order):
        for values, colour in ((swing.low_m / base, "tab:blue"), (swing.high_m / base, "tab:red")):
            axis.barh(row, np.median(values) - 1, left=1, color=colour, alpha=0.4, height=0.6)
            axis.plot(values, np.full(len(values), row), ".", color=colour)
    axis.axvline(1.0, color="black", linewidth=0.8)
    axis.set(yticks=range(len(order)), yticklabels=[s.name for s in order])
    axis.set_xlabel(
        "distance relative to the unchanged robot (blue: low, red: high; 0: failed or backwards)"
    )
    axis.grid(axis="x", alpha=0.3)
    figure.savefig(path, dpi=110)
