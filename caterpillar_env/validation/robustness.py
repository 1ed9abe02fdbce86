"""Sensitivity of evolved robots to changes of physics parameters."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure

from caterpillar_env.arrays import Array
from caterpillar_env.gait import GaitTimings
from caterpillar_env.physics import Physics
from caterpillar_env.robot import Robot, simulate, stack
from caterpillar_env.validation.check import Check, check_near

STOPS = "time constant of the joint stops 2.5 / 10 ms"

#: Label, field of `Physics` or of its spring, low value, high value.
_PARAMETERS: tuple[tuple[str, str, float, float], ...] = (
    ("friction 0.4 / 1.2", "friction", 0.4, 1.2),
    ("neck stiffness 3e-3 / 12e-3 N m/rad", "neck_stiffness_n_m_rad", 3e-3, 12e-3),
    ("neck damping 1e-4 / 3e-4 N m s/rad", "neck_damping_n_m_s_rad", 1e-4, 3e-4),
    ("neck stiffening 3 / 8", "neck_stiffening", 3.0, 8.0),
    (STOPS, "stop_time_constant_s", 0.0025, 0.01),
    ("time constant of contacts 5 / 20 ms", "contact_time_constant_s", 0.005, 0.02),
    ("coil shielding 0.5 / 1", "spring.coil_shielding", 0.5, 1.0),
    ("austenite stiffness 25 / 45 N/m", "spring.austenite_stiffness_n_m", 25.0, 45.0),
    ("martensite stiffness 12 / 17 N/m", "spring.martensite_stiffness_n_m", 12.0, 17.0),
    ("martensite rest length 20 / 24 mm", "spring.martensite_rest_length_m", 0.020, 0.024),
    ("air temperature 15 / 35 degC", "spring.ambient_c", 15.0, 35.0),
    ("mismatch: two other seeds", "mismatch_seed", 1001, 1002),
)


def _change(physics: Physics, field: str, value: float) -> Physics:
    if field.startswith("spring."):
        spring = replace(physics.spring, **{field.removeprefix("spring."): value})
        return replace(physics, spring=spring)
    return replace(physics, **{field: value})  # type: ignore[arg-type]


def vary_parameters(robots: Sequence[Robot]) -> dict[str, Array]:
    """Return the distances with a low and a high value of each parameter, by label.

    They are relative to the unchanged robots, and 0 for robots that fail or move backwards, (2, robots).
    """
    bodies, timings = stack(robots)
    physics = robots[0].physics
    base_m = simulate(bodies, timings, physics).fitness()

    def ratio(physics: Physics, timings: GaitTimings = timings) -> Array:
        return simulate(bodies, timings, physics).fitness() / base_m

    paces = (
        GaitTimings(factor * timings.period_s, factor * timings.on_s, factor * timings.off_s)
        for factor in (0.8, 1.2)
    )
    ratios = {
        name: np.array([ratio(_change(physics, field, value)) for value in values])
        for name, field, *values in _PARAMETERS
    }
    return ratios | {"gait period 4 / 6 s, same shares": np.array([ratio(physics, p) for p in paces])}


def check_stops(robots: Sequence[Robot]) -> list[Check]:
    """Check that the time constant of the joint stops has little effect on the median distance."""
    bodies, timings = stack(robots)
    physics = robots[0].physics

    def median_mm(factor: float) -> float:
        changed = _change(physics, "stop_time_constant_s", factor * physics.stop_time_constant_s)
        return 1000 * float(np.median(simulate(bodies, timings, changed).fitness()))

    base_mm = median_mm(1.0)
    return [
        check_near(
            f"median distance with {word} the time constant of the joint stops",
            base_mm, median_mm(factor), "mm", rel=0.1,
        )
        for word, factor in (("half", 0.5), ("twice", 2.0))
    ]  # fmt: skip


def plot_parameters(ratios: dict[str, Array], path: Path) -> None:
    """Plot the result of `vary_parameters`, with one dot per robot and median bars."""
    figure = Figure(figsize=(9, 0.55 * len(ratios) + 1.4), layout="constrained")
    axis = figure.subplots()
    order = sorted(ratios, key=lambda name: float(np.ptp([*np.median(ratios[name], axis=1), 1.0])))
    for row, name in enumerate(order):
        for values, colour in zip(ratios[name], ("tab:blue", "tab:red"), strict=True):
            axis.barh(row, np.median(values) - 1, left=1, color=colour, alpha=0.4, height=0.6)
            axis.plot(values, np.full(len(values), row), ".", color=colour)
    axis.axvline(1.0, color="black", linewidth=0.8)
    axis.set(yticks=range(len(order)), yticklabels=order)
    axis.set_xlabel(
        "distance relative to the unchanged robot (blue: low, red: high; 0: failed or backwards)"
    )
    axis.grid(axis="x", alpha=0.3)
    figure.savefig(path, dpi=110)
