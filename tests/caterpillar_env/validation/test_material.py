from dataclasses import replace

import pytest

from caterpillar_env.sma import SmaSpring
from caterpillar_env.validation import material


@pytest.mark.parametrize("group", [material.check_closed_forms, material.check_dynalloy])
def test_every_check_passes(group):
    failed = [check for check in group() if not check.passed]
    assert not failed


def test_lower_martensite_temperatures_take_longer_to_reach():
    row = material.DYNALLOY[2]
    wire = material.straight_wire(row, high_temperature=True)
    colder = replace(wire, martensite_start_c=60.0, martensite_finish_c=50.0)
    assert material.transformation_times_s(colder)[1] > material.transformation_times_s(wire)[1]


def test_thin_wire_cools_better_and_the_default_is_on_the_curve():
    assert material.convection_w_m2_k(0.1e-3) > material.convection_w_m2_k(0.5e-3)
    derived = material.convection_w_m2_k(SmaSpring().wire_diameter_m)
    assert derived == pytest.approx(SmaSpring().convection_w_m2_k, rel=0.02)


def test_plot_is_drawn(tmp_path):
    material.plot(tmp_path / "sma.png")
    assert (tmp_path / "sma.png").stat().st_size > 10_000
