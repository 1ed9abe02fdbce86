"""Checks of the SMA model against closed forms and Dynalloy's data sheet."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure
from scipy.optimize import brentq

from caterpillar_env.arrays import Array
from caterpillar_env.physics import GRAVITY_M_S2
from caterpillar_env.sma import SmaSpring, SmaState, SmaSteps, advance, spring_force
from caterpillar_env.validation.check import Check, check_at_most, check_near


def check_closed_forms() -> list[Check]:
    """Check heating, pulses, stroke, hysteresis and energy of one spring against closed forms."""
    return [
        *_first_order_heating(),
        _adiabatic_pulse(),
        _isotonic_stroke(),
        *_branch_midpoints(),
        *_partial_loops(),
        _energy_balance(),
    ]


def _run(
    spring: SmaSpring, power: float, steps: int, step_s: float = 1e-3, state: SmaState | None = None
) -> SmaSteps:
    """Simulate one spring with constant power from `state`, by default cold."""
    start = state or SmaState.cold(spring, (1,))
    return advance(spring, start, np.full((steps, 1), power), step_s)


def _temperature(spring: SmaSpring, steps: SmaSteps) -> Array:
    """Return the temperature after each step, degC, (K,)."""
    return steps.path.temperature_c(spring)[:, 0]


def _first_order_heating() -> list[Check]:
    # T = T_amb + I^2 R' / (h s pi d) (1 - exp(-t / tau)), far below As.
    spring = replace(SmaSpring(), drive_current_a=0.1)
    rise = spring.heating_w_kg / spring.cooling_w_kg_k
    checks = []
    for taus in (0.5, 1.0, 3.0):
        steps = round(taus * spring.time_constant_s / 0.01)
        got = _temperature(spring, _run(spring, 1.0, steps, 0.01))[-1]
        expected = spring.ambient_c + rise * -math.expm1(-steps * 0.01 / spring.time_constant_s)
        name = f"heating without transformation, t = {taus:g} tau"
        checks.append(check_near(name, expected, got, "degC", rel=1e-9))
    return checks


def _adiabatic_pulse() -> Check:
    spring = replace(SmaSpring(), convection_w_m2_k=1e-6)
    sensible = spring.specific_heat_j_kg_k * (spring.austenite_finish_c - spring.ambient_c)
    expected = (sensible + spring.latent_heat_j_kg) / spring.heating_w_kg
    fraction = _run(spring, 1.0, 2000, 5e-4).path.fraction
    got = float((np.argmax(fraction >= 1.0) + 1) * 5e-4)
    return check_near("adiabatic pulse, m' (c dT + L) / (I^2 R')", expected, got, "s", abs_=5e-4)


def _isotonic_stroke() -> Check:
    s = SmaSpring()
    load_n = 0.15

    def length(xi: float) -> float:
        def surplus(length_m: float) -> float:
            return float(spring_force(s, np.array([length_m]), np.array([xi]))[0]) - load_n

        return float(brentq(surplus, 0.0161, 0.05))

    expected = load_n * (1 / s.martensite_stiffness_n_m - 1 / s.austenite_stiffness_n_m)
    expected += s.martensite_rest_length_m - s.austenite_rest_length_m
    got = length(0.0) - length(1.0)
    return check_near("isotonic stroke under 0.15 N", 1000 * expected, 1000 * got, "mm", rel=1e-6)


def _branch_midpoints() -> list[Check]:
    spring = SmaSpring()
    up = _run(spring, 1.0, 2000)
    down = _run(spring, 0.0, 6000, state=up.state)
    checks = []
    for word, step, low_c, high_c in (
        ("heating", up, spring.austenite_start_c, spring.austenite_finish_c),
        ("cooling", down, spring.martensite_finish_c, spring.martensite_start_c),
    ):
        fraction = step.path.fraction[:, 0]
        inside = np.flatnonzero((fraction > 0.01) & (fraction < 0.99))
        rising = inside[np.argsort(fraction[inside])]
        got = float(np.interp(0.5, fraction[rising], _temperature(spring, step)[rising]))
        name = f"temperature at half austenite on {word}"
        checks.append(check_near(name, (low_c + high_c) / 2, got, "degC", abs_=0.01))
    return checks


def _partial_loops() -> list[Check]:
    spring = SmaSpring()
    up = _run(spring, 1.0, 2000)
    turn = int(np.argmax(up.path.fraction >= 0.6))
    peak_c, peak_xi = float(_temperature(spring, up)[turn]), float(up.path.fraction[turn, 0])
    # Cool until the fraction has fallen by 0.2, then heat to the temperature where the loop began.
    down = _run(spring, 0.0, 6000, state=up.path.rows(turn))
    low = down.path.rows(int(np.argmax(down.path.fraction <= peak_xi - 0.2)))
    again = _run(spring, 1.0, 500, state=low)
    back = float(np.interp(peak_c, _temperature(spring, again), again.path.fraction[:, 0]))
    frozen = down.path.fraction[_temperature(spring, down) > spring.martensite_start_c]
    drift = float(np.abs(frozen - peak_xi).max())
    name = "fraction where a partial loop closes (return-point memory)"
    return [
        check_at_most("change of the fraction between reversal and Ms", 0.0, drift, ""),
        check_near(name, peak_xi, back, "", abs_=1e-3),
    ]


def _energy_balance() -> Check:
    """Check the energy balance. The heat loss is integrated from the temperatures."""
    spring = SmaSpring()
    rng = np.random.default_rng(0)
    step_s, steps = 0.01, 3000
    power = np.repeat(rng.random((steps // 50, 20)), 50, axis=0).round()
    step = advance(spring, SmaState.cold(spring, (20,)), power, step_s)
    temperature = step.path.temperature_c(spring)
    padded = np.concatenate([np.full((1, 20), spring.ambient_c), temperature])
    mean = (padded[1:] + padded[:-1]) / 2 - spring.ambient_c
    lost = spring.cooling_w_kg_k * step_s * mean.sum(axis=0)
    supplied = spring.heating_w_kg * step_s * step.power.sum(axis=0)
    stored = step.state.enthalpy_j_kg - spring.specific_heat_j_kg_k * spring.ambient_c
    worst = float(np.abs((stored + lost) / supplied - 1).max())
    return check_at_most("relative error of the energy balance, 20 power histories", 0.005, worst, "")


class WireRow(NamedTuple):
    """A row of Dynalloy's table for straight wire in still air (Flexinol F1140)."""

    diameter_mm: float
    resistance_ohm_m: float
    current_ma: float  #: current that transforms the wire in 1 s
    cooling_lt_s: float  #: cooling time of low-temperature (LT) wire
    cooling_ht_s: float  #: cooling time of high-temperature (HT) wire


DYNALLOY = (
    WireRow(0.10, 126, 200, 1.1, 0.9),
    WireRow(0.13, 75, 320, 1.6, 1.4),
    WireRow(0.15, 55, 410, 2.0, 1.7),
    WireRow(0.20, 29, 660, 3.2, 2.7),
    WireRow(0.25, 18.5, 1050, 5.4, 4.5),
    WireRow(0.31, 12.2, 1500, 8.1, 6.8),
    WireRow(0.38, 8.3, 2250, 10.5, 8.8),
    WireRow(0.51, 4.3, 4000, 16.8, 14.0),
)


def convection_w_m2_k(diameter_m: float) -> float:
    """Return the heat transfer coefficient of a horizontal wire at 70 degC in air of 25 degC, W/(m2 K).

    It is the sum of free convection (Churchill and Chu 1975) and radiation with an emissivity of 0.8.
    """
    wire_k, air_k = 70.0 + 273.15, 25.0 + 273.15
    film_k = (wire_k + air_k) / 2
    conductivity = 0.0241 * (film_k / 273.15) ** 0.9  # of air, W/(m K)
    viscosity = 1.327e-5 * (film_k / 273.15) ** 1.75  # kinematic, m2/s
    prandtl = 0.71
    rayleigh = GRAVITY_M_S2 / film_k * (wire_k - air_k) * diameter_m**3 * prandtl / viscosity**2
    nusselt = (0.60 + 0.387 * rayleigh ** (1 / 6) / (1 + (0.559 / prandtl) ** (9 / 16)) ** (8 / 27)) ** 2
    radiation: float = 0.8 * 5.670e-8 * (wire_k**2 + air_k**2) * (wire_k + air_k)
    free: float = nusselt * conductivity / diameter_m
    return free + radiation


def straight_wire(row: WireRow, *, high_temperature: bool) -> SmaSpring:
    """Return the straight wire in a row of the table, at its current, in still air of 25 degC."""
    d = row.diameter_mm / 1000
    branches = (88.0, 98.0, 72.0, 62.0) if high_temperature else (68.0, 78.0, 66.0, 56.0)
    names = ("austenite_start_c", "austenite_finish_c", "martensite_start_c", "martensite_finish_c")
    return SmaSpring(
        wire_diameter_m=d,
        resistivity_ohm_m=row.resistance_ohm_m * math.pi * d**2 / 4,
        drive_current_a=row.current_ma / 1000,
        coil_shielding=1.0,
        convection_w_m2_k=convection_w_m2_k(d),
        cut_off_c=200.0,
        **dict(zip(names, branches, strict=True)),
    )


def transformation_times_s(spring: SmaSpring) -> tuple[float, float]:
    """Return the heating time from ambient to 90 % austenite and the cooling time from Af to 10 %, s."""
    step_s = 0.005
    hot = SmaState.at(spring, np.array([spring.austenite_finish_c]), np.ones(1))
    heating = _run(spring, 1.0, 400, step_s).path.fraction
    cooling = _run(spring, 0.0, 4000, step_s, hot).path.fraction
    return (
        float((np.argmax(heating >= 0.9) + 1) * step_s),
        float((np.argmax(cooling <= 0.1) + 1) * step_s),
    )


def check_dynalloy() -> list[Check]:
    """Check heating and cooling times of high-temperature (HT) wire.

    Only the specific heat was fitted, to the heating times of the data sheet.
    """
    checks = [
        check_near(
            "convection of a 0.15 mm wire", SmaSpring().convection_w_m2_k,
            convection_w_m2_k(0.15e-3), "W/(m2 K)", rel=0.02,
        )
    ]  # fmt: skip
    for row in DYNALLOY:
        heating, cooling = transformation_times_s(straight_wire(row, high_temperature=True))
        name = f"HT wire {row.diameter_mm:.2f} mm"
        checks += [
            check_near(f"{name} at {row.current_ma:g} mA: heating", 1.0, heating, "s", rel=0.25),
            check_near(f"{name}: cooling", row.cooling_ht_s, cooling, "s", rel=0.25),
        ]
    return checks


def plot(path: Path) -> None:
    """Plot the times of the model and the data sheet, and the hysteresis loop of the default spring."""
    figure = Figure(figsize=(11, 4), layout="constrained")
    left, middle, right = figure.subplots(1, 3)
    diameters = [row.diameter_mm for row in DYNALLOY]
    for high, colour, word in ((False, "tab:blue", "LT"), (True, "tab:red", "HT")):
        times = [transformation_times_s(straight_wire(r, high_temperature=high)) for r in DYNALLOY]
        left.plot(diameters, [t[1] for t in times], color=colour, label=f"{word}, model")
        theirs = [r.cooling_ht_s if high else r.cooling_lt_s for r in DYNALLOY]
        left.plot(diameters, theirs, "o", color=colour, label=f"{word}, data sheet")
        middle.plot(diameters, [t[0] for t in times], color=colour, label=f"{word}, model")
    middle.axhline(1.0, color="black", linestyle=":", label="data sheet")
    left.set(xlabel="wire diameter (mm)", ylabel="cooling time (s)")
    middle.set(xlabel="wire diameter (mm)", ylabel="heating time (s)", ylim=(0, 1.5))
    spring = SmaSpring()
    up = _run(spring, 1.0, 3000)
    down = _run(spring, 0.0, 6000, state=up.state)
    for word, step, colour in (("heating", up, "tab:red"), ("cooling", down, "tab:blue")):
        right.plot(_temperature(spring, step), step.path.fraction, color=colour, label=word)
    right.set(xlabel="temperature (degC)", ylabel="austenite fraction")
    for axis in (left, middle, right):
        axis.legend(fontsize="small", loc="upper left")
        axis.grid(alpha=0.3)
    figure.savefig(path, dpi=110)
