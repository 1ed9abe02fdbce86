import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from caterpillar_env.errors import CaterpillarError
from caterpillar_env.morphology import LOWER, NAMES, PARAMETERS, UPPER, Morphology

UNITS = st.lists(st.floats(0, 1), min_size=8, max_size=8).map(np.array)


def with_value(name, value):
    return {**Morphology().to_dict(), name: value}


def test_fields_and_parameters_have_the_same_order():
    assert tuple(f.name for f in dataclasses.fields(Morphology)) == NAMES
    assert tuple(p.symbol for p in PARAMETERS) == ("w", "L", "R", "m", "q", "x", "y", "z")


def test_nominal_body_is_the_documented_one():
    assert Morphology().to_array().tolist() == [0.016, 0.030, 0.012, 0.008, 0.6, 0.003, 0.0065, 0.006]


def test_bounds_are_valid_values():
    assert Morphology.of(LOWER).to_array().tolist() == LOWER.tolist()
    assert Morphology.of(UPPER).to_array().tolist() == UPPER.tolist()


@pytest.mark.parametrize("parameter", PARAMETERS, ids=lambda p: p.name)
@pytest.mark.parametrize("kind", ["below", "above", "nan", "inf", "none", "text"])
def test_error_names_field_value_interval_and_unit(parameter, kind):
    value = {
        "below": np.nextafter(parameter.lower, -1),
        "above": np.nextafter(parameter.upper, 9),
        "nan": float("nan"),
        "inf": float("inf"),
        "none": None,
        "text": "wide",
    }[kind]
    with pytest.raises(CaterpillarError) as caught:
        Morphology(**with_value(parameter.name, value))
    message = str(caught.value)
    assert message.startswith(f"{parameter.name} = {value!r} ")
    assert f"[{parameter.lower:g}, {parameter.upper:g}] {parameter.unit} " in message


def test_mapping_changes_the_nominal_body():
    assert Morphology.of({"segment_length_m": 0.033}) == Morphology(segment_length_m=0.033)
    assert Morphology.of({}) == Morphology()


def test_unknown_name_error_lists_the_known_names():
    with pytest.raises(CaterpillarError, match=r"no length_m; .*segment_length_m"):
        Morphology.of({"length_m": 0.03})
    with pytest.raises(CaterpillarError, match="no colour"):
        Morphology.of({**Morphology().to_dict(), "colour": 1.0})


@pytest.mark.parametrize(
    "value", [[0.01] * 7, np.full((1, 8), 0.01), 3, None, "nominal", [[1], [2, 3]]], ids=repr
)
def test_wrong_shape_error_states_expected_and_given(value):
    with pytest.raises(CaterpillarError, match="a mapping or 8 numbers") as caught:
        Morphology.of(value)
    assert repr(value) in str(caught.value)


def test_error_is_a_value_error():
    with pytest.raises(ValueError, match="joint_limit_rad"):
        Morphology(joint_limit_rad=2)


def test_numpy_numbers_and_integers_become_floats():
    body = Morphology(joint_limit_rad=1, segment_mass_kg=np.float32(0.008))
    assert type(body.joint_limit_rad) is float
    assert type(body.segment_mass_kg) is float


def test_of_returns_a_morphology_unchanged():
    body = Morphology(joint_limit_rad=0.3)
    assert Morphology.of(body) is body


@settings(deadline=None)
@given(UNITS)
def test_every_unit_point_is_a_body_and_round_trips(unit):
    body = Morphology.from_unit(unit)
    np.testing.assert_allclose(body.to_unit(), unit, atol=1e-12)
    assert Morphology.of(body.to_array()) == body
    assert Morphology.of(body.to_dict()) == body


def test_bounds_are_read_only():
    with pytest.raises(ValueError, match="read-only"):
        LOWER[0] = 0.0
    with pytest.raises(dataclasses.FrozenInstanceError):
        Morphology().segment_mass_kg = 0.005
