"""Comparison of springs with closed-form results, computed here from the data of the wire."""

import dataclasses
import math
import re

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from caterpillar_env import SmaSpring
from caterpillar_env.errors import CaterpillarError
from caterpillar_env.sma import (
    BOUNDS,
    SmaState,
    advance,
    cooling_branch,
    heating_branch,
    settle,
    spring_force,
)

NITI = SmaSpring()
STEP_S = 0.01

# Values per metre of the default wire, computed from its data.
AREA_M2 = math.pi * 0.15e-3**2 / 4
MASS_KG_M = 6450 * AREA_M2
OHM_M = 0.98e-6 / AREA_M2
LOSS_W_M_K = 110 * 0.7 * math.pi * 0.15e-3


def powered(spring, share, seconds, state=None, step_s=STEP_S):
    """Return the steps of one spring under constant power."""
    state = SmaState.cold(spring, (1,)) if state is None else state
    return advance(spring, state, np.full((round(seconds / step_s), 1), float(share)), step_s)


def temperature(spring, state):
    return float(state.temperature_c(spring)[0])


# Thermal balance


def test_wire_data_follow_from_its_geometry():
    assert NITI.resistance_per_m_ohm == pytest.approx(55.5, abs=0.1)  # the supplier's sheet
    assert NITI.resistance_per_m_ohm == pytest.approx(OHM_M)
    assert NITI.mass_per_m_kg == pytest.approx(MASS_KG_M)
    assert NITI.drive_power_w == pytest.approx(0.35**2 * OHM_M * 100 * math.pi * 0.47e-3)
    assert NITI.time_constant_s == pytest.approx(6450 * 500 * 0.15e-3 / (4 * 110 * 0.7))


def test_heating_without_transformation_is_first_order():
    spring = SmaSpring(latent_heat_j_kg=0, drive_current_a=0.1)  # ends at 40 degC, far below As
    tau = 6450 * 500 * 0.15e-3 / (4 * 110 * 0.7)
    rise = 0.1**2 * OHM_M / LOSS_W_M_K
    for seconds in (0.01, 0.5, tau, 3 * tau):
        steps = round(seconds / STEP_S)
        end = temperature(spring, powered(spring, 1, steps * STEP_S).state)
        assert end == pytest.approx(25 + rise * (1 - math.exp(-steps * STEP_S / tau)), abs=1e-9)


def test_cooling_without_transformation_is_exponential():
    start = SmaState.at(NITI, np.array([50.0]), np.zeros(1))
    end = temperature(NITI, powered(NITI, 0, 2.0, start).state)
    tau = 6450 * 500 * 0.15e-3 / (4 * 110 * 0.7)
    assert end == pytest.approx(25 + 25 * math.exp(-2.0 / tau), abs=1e-9)


def test_partial_power_heats_by_its_share():
    spring = SmaSpring(drive_current_a=0.1)
    full, half = (temperature(spring, powered(spring, u, 1.0).state) - 25 for u in (1.0, 0.5))
    assert half == pytest.approx(full / 2)


def test_minimum_current_that_reaches_austenite_finish():
    minimum_a = math.sqrt(LOSS_W_M_K * (78 - 25) / OHM_M)
    for current_a, reached in ((0.995 * minimum_a, False), (1.005 * minimum_a, True)):
        spring = SmaSpring(drive_current_a=current_a)
        fraction = powered(spring, 1, 60.0, step_s=0.05).state.fraction[0]
        assert fraction > 0.9
        assert bool(fraction == 1.0) is reached


def test_adiabatic_pulse_takes_sensible_and_latent_heat():
    spring = SmaSpring(convection_w_m2_k=1e-9)
    pulse_s = MASS_KG_M * (500 * (78 - 25) + 24_200) / (0.35**2 * OHM_M)
    done = powered(spring, 1, pulse_s, step_s=pulse_s / 100)
    assert temperature(spring, done.state) == pytest.approx(78, abs=1e-6)
    assert done.path.fraction[-1, 0] == pytest.approx(1, abs=1e-6)
    assert done.path.fraction[-2, 0] < 1


def test_transformation_without_latent_heat_needs_no_heat():
    spring = SmaSpring(convection_w_m2_k=1e-9, latent_heat_j_kg=0)
    pulse_s = MASS_KG_M * 500 * (78 - 25) / (0.35**2 * OHM_M)
    assert temperature(spring, powered(spring, 1, pulse_s, step_s=pulse_s / 50).state) == pytest.approx(
        78
    )


def test_energy_supplied_is_stored_or_lost():
    power = np.repeat([1.0, 0.0, 0.6, 0.0, 1.0], 1500)[:, None]  # 1.5 s each
    step_s = 0.001
    state, temperatures = SmaState.cold(NITI, (1,)), [25.0]
    for share in power:
        state = advance(NITI, state, share[None], step_s).state
        temperatures.append(temperature(NITI, state))
    done = advance(NITI, SmaState.cold(NITI, (1,)), power, step_s)

    supplied = 0.35**2 * OHM_M / MASS_KG_M * step_s * done.power.sum()
    stored = 500 * (temperatures[-1] - 25) + 24_200 * done.state.fraction[0]
    over_c = np.array(temperatures) - 25
    lost = LOSS_W_M_K / MASS_KG_M * step_s * (over_c[:-1] + over_c[1:]).sum() / 2
    assert supplied == pytest.approx(stored + lost, rel=1e-4)


def test_steps_of_ten_milliseconds_are_accurate():
    pattern = [1.0, 0.0, 1.0, 0.0]
    coarse = advance(NITI, SmaState.cold(NITI, (1,)), np.repeat(pattern, 100)[:, None], 0.01)
    fine = advance(NITI, SmaState.cold(NITI, (1,)), np.repeat(pattern, 4000)[:, None], 0.00025)
    assert 0.2 < coarse.path.fraction.mean() < 0.8
    np.testing.assert_allclose(coarse.path.fraction, fine.path.fraction[39::40], atol=0.006)


def test_cut_off_is_an_ideal_thermostat():
    spring = SmaSpring(drive_current_a=0.5)
    held = powered(spring, 1, 20.0)
    need = LOSS_W_M_K * (120 - 25) / (0.5**2 * OHM_M)  # share that balances the loss at the cut-off
    assert need < 1
    assert temperature(spring, held.state) == pytest.approx(120, abs=1e-9)
    assert held.power[-1, 0] == pytest.approx(need, rel=STEP_S / 1.57)
    assert held.power[0, 0] == pytest.approx(1)
    cooling = powered(spring, 0, 1.0, held.state)
    assert not cooling.power.any()
    assert temperature(spring, cooling.state) < 100


def test_spring_above_the_cut_off_gets_no_power():
    hot = SmaState.at(NITI, np.array([150.0]), np.ones(1))
    done = powered(NITI, 1, 0.1, hot)
    tau = 6450 * 500 * 0.15e-3 / (4 * 110 * 0.7)
    assert not done.power.any()
    assert temperature(NITI, done.state) == pytest.approx(25 + 125 * math.exp(-0.1 / tau), abs=1e-9)


@settings(deadline=None, max_examples=60)
@given(arrays(float, (80, 3), elements=st.floats(0, 1)), st.sampled_from([0.2, 0.35, 0.8]))
def test_any_power_history_stays_between_ambient_and_cut_off(power, current_a):
    spring = SmaSpring(drive_current_a=current_a)
    state = SmaState.cold(spring, (3,))
    done = advance(spring, state, power, 0.1)
    for k in range(len(power)):
        state = advance(spring, state, power[k : k + 1], 0.1).state
        temperatures = state.temperature_c(spring)
        assert np.isfinite(temperatures).all()
        assert temperatures.min() >= 25 - 1e-9
        assert temperatures.max() <= 120 + 1e-9
    np.testing.assert_array_equal(done.state, state)
    assert ((done.path.fraction >= 0) & (done.path.fraction <= 1)).all()
    assert ((done.power >= 0) & (done.power <= power + 1e-12)).all()


@pytest.mark.parametrize("period_s", [0.3, 1.0, 5.0])
def test_settled_temperatures_are_periodic(period_s):
    power = np.repeat([1.0, 0.0], [round(30 * period_s), round(70 * period_s)])[:, None]
    last = settle(NITI, power, 0.01)
    following = advance(NITI, last.state, power, 0.01)
    np.testing.assert_allclose(following.path.fraction, last.path.fraction, atol=1e-6)


def test_springs_are_independent_of_their_neighbours():
    power = np.random.default_rng(0).random((50, 2, 3))
    together = advance(NITI, SmaState.cold(NITI, (2, 3)), power, STEP_S)
    for row in range(2):
        alone = advance(NITI, SmaState.cold(NITI, (3,)), power[:, row], STEP_S)
        np.testing.assert_array_equal(together.path.fraction[:, row], alone.path.fraction)


def test_without_current_no_power_is_used():
    spring = SmaSpring(drive_current_a=0.0)
    done = powered(spring, 1, 1.0)
    assert not done.power.any()
    assert temperature(spring, done.state) == 25


def test_final_state_is_the_last_step():
    done = powered(NITI, 1, 1.0)
    np.testing.assert_array_equal(done.path.fraction[-1], done.state.fraction)
    np.testing.assert_array_equal(done.path.enthalpy_j_kg[-1], done.state.enthalpy_j_kg)
    half = powered(NITI, 1, 0.5)
    np.testing.assert_array_equal(done.path.enthalpy_j_kg[:50], half.path.enthalpy_j_kg)


def test_advance_does_not_change_the_given_state():
    state = SmaState.cold(NITI, (1,))
    powered(NITI, 1, 1.0, state)
    assert state.enthalpy_j_kg[0] == 500 * 25
    assert state.fraction[0] == 0


# Hysteresis


@pytest.mark.parametrize(
    ("branch", "ends_c"), [(heating_branch, (68, 78)), (cooling_branch, (56, 66))], ids=["heat", "cool"]
)
def test_branches_are_half_cosines(branch, ends_c):
    low, high = ends_c
    at = np.array([low - 9, low, low + (high - low) / 3, (low + high) / 2, high, high + 9])
    np.testing.assert_allclose(branch(NITI, at), [0, 0, 0.25, 0.5, 1, 1], atol=1e-12)


def half_transformed():
    """Return a spring heated to between As and Af, on the heating branch."""
    state = SmaState.cold(NITI, (1,))
    while state.fraction[0] < 0.5:
        state = powered(NITI, 1, STEP_S, state).state
    return state


def test_reversal_freezes_the_fraction_until_the_other_branch():
    start = half_transformed()
    state, frozen = start, 0
    while temperature(NITI, state) > 61.5:  # the cooling branch is at 0.55 there
        assert state.fraction[0] == start.fraction[0]
        state, frozen = powered(NITI, 0, STEP_S, state).state, frozen + 1
    assert frozen > 10
    later = powered(NITI, 0, 0.5, state).state
    assert later.fraction[0] < start.fraction[0]
    np.testing.assert_allclose(
        later.fraction, cooling_branch(NITI, later.temperature_c(NITI)), atol=1e-4
    )


def test_reversal_on_cooling_freezes_the_fraction():
    hot = SmaState.at(NITI, np.array([90.0]), np.ones(1))
    start = powered(NITI, 0, 2.2, hot).state
    assert 0.2 < start.fraction[0] < 0.8
    heated = powered(NITI, 1, 0.05, start)
    assert temperature(NITI, heated.state) < 68
    assert (heated.path.fraction == start.fraction[0]).all()


def test_state_at_a_temperature_is_clipped_to_the_loop():
    at = np.array([60.0, 61.0, 67.0, 73.0, 90.0])
    state = SmaState.at(NITI, at, np.array([0.0, 1.0, 0.3, 0.0, 0.0]))
    np.testing.assert_allclose(state.fraction, [0, 0.5, 0.3, 0.5, 1])
    np.testing.assert_allclose(state.temperature_c(NITI), at)


# Force


def test_force_of_pure_phases_and_their_mixture():
    # At 36 mm: 35 N/m beyond 16 mm gives 0.70 N, 14.5 N/m beyond 22.2 mm gives 0.20 N.
    force = spring_force(NITI, np.full(3, 0.036), np.array([1.0, 0.0, 0.5]))
    np.testing.assert_allclose(force, [0.70, 0.20, 0.45], rtol=1e-3)


def test_spring_neither_pushes_nor_exceeds_its_limit():
    lengths, fraction = np.array([0.010, 0.016, 0.060]), np.ones(3)
    np.testing.assert_allclose(spring_force(NITI, lengths, fraction), [0, 0, 0.85])


# Errors


@pytest.mark.parametrize(
    "changes",
    [
        {"ambient_c": 56.0},
        {"martensite_start_c": 56.0},
        {"martensite_start_c": 78.0},
        {"austenite_start_c": 55.0},
        {"austenite_finish_c": 68.0},
        {"cut_off_c": 78.0},
    ],
    ids=str,
)
def test_invalid_hysteresis_loops_are_rejected(changes):
    with pytest.raises(CaterpillarError, match="ambient < Mf < Ms < Af < cut-off and Mf < As < Af"):
        SmaSpring(**changes)


@pytest.mark.parametrize("field", [f.name for f in dataclasses.fields(SmaSpring)])
def test_every_quantity_must_be_a_finite_number(field):
    for value in (math.nan, math.inf, None, "1"):
        with pytest.raises(CaterpillarError, match=f"{field} = {value!r} must be a finite number"):
            SmaSpring(**{field: value})


@pytest.mark.parametrize(
    ("field", "value", "message"),
    [
        ("wire_diameter_m", 0.0, "from 1e-06 to 0.02"),
        ("convection_w_m2_k", 0.0, "from 1e-09 to 20000"),
        ("force_limit_n", 0.0, "from 0.005 to 100"),
        ("drive_current_a", -1.0, "from 0 to 50"),
        ("drive_current_a", 1e300, "from 0 to 50"),
        ("density_kg_m3", 5e-324, "from 50 to 700000"),
        ("resistivity_ohm_m", 1e308, "from 5e-09 to 0.0001"),
    ],
)
def test_values_out_of_bounds_are_rejected(field, value, message):
    expected = f"{field} = {value} must be a finite number {message}"
    with pytest.raises(CaterpillarError, match=re.escape(expected)):
        SmaSpring(**{field: value})


def test_every_value_may_be_a_hundredth_or_a_hundred_times_the_default():
    outside = {"ambient_c", "cut_off_c", "coil_shielding"}
    for name, (lower, upper) in BOUNDS.items():
        value = getattr(SmaSpring(), name)
        if not name.endswith(("start_c", "finish_c")) and name not in outside:
            assert lower <= value / 100 < 100 * value <= upper, name


def test_latent_heat_and_current_may_be_zero():
    SmaSpring(latent_heat_j_kg=0.0, drive_current_a=0.0)


@pytest.mark.parametrize("seed", range(10))
def test_heat_and_temperature_stay_finite_anywhere_within_the_bounds(seed):
    rng = np.random.default_rng(seed)
    values = {n: rng.choice(b) for n, b in BOUNDS.items() if b[1] != 2000.0}
    spring = SmaSpring(**values)
    step = advance(spring, SmaState.cold(spring, (2,)), np.ones((50, 2)), 0.01)
    assert np.isfinite(step.state.temperature_c(spring)).all()
    assert np.isfinite(step.power).all()
    assert np.isfinite(spring.drive_power_w)
