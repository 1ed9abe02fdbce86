import json
import math

import pytest

from caterpillar_env import Physics, SmaSpring
from caterpillar_env.errors import CaterpillarError
from caterpillar_env.physics import BOUNDS


def test_strengths_spread_about_one_and_follow_the_seed():
    many = Physics(num_segments=64).strengths()
    assert many.shape == (252,)
    assert many.mean() == pytest.approx(1, abs=0.015)
    assert many.std() == pytest.approx(0.05, rel=0.15)
    assert (Physics(num_segments=64).strengths() == many).all()
    assert (Physics(num_segments=64, mismatch_seed=1).strengths() != many).all()
    assert (Physics(mismatch_std=0.0).strengths() == 1).all()
    assert Physics(num_segments=64, mismatch_std=5.0).strengths().min() == 0.1


def test_given_strengths_replace_random_strengths():
    measured = [0.9, 1.0, 1.1, 1.2]
    physics = Physics(num_segments=2, spring_strengths=measured, mismatch_seed=3)
    assert physics.strengths().tolist() == measured
    assert Physics.of(json.loads(json.dumps(physics.to_dict()))) == physics
    for unusable in ([1.0] * 3, [1.0, 1.0, 1.0, 0.0], [1.0, 1.0, 1.0, math.nan]):
        with pytest.raises(CaterpillarError, match=r"spring_strengths .*must be"):
            Physics(num_segments=2, spring_strengths=unusable)


def test_physics_round_trips_through_json():
    physics = Physics(num_segments=3, spring=SmaSpring(ambient_c=20.0), bend_axis="pitch")
    assert Physics.of(json.loads(json.dumps(physics.to_dict()))) == physics


def test_partial_mappings_keep_the_other_defaults():
    assert Physics.of({"spring": {"ambient_c": 20.0}}) == Physics(spring=SmaSpring(ambient_c=20.0))
    assert Physics.of(None) == Physics()


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ({"frictoin": 1.0}, "physics has no frictoin; its fields are num_segments, "),
        (
            {"spring": {"turn": 3}},
            "spring has no turn; its fields are wire_diameter_m, ",
        ),
        ([4], r"physics must be a mapping .*got \[4\]"),
        ({"num_segments": 1}, "num_segments = 1 must be an integer from 2 to 64"),
        ({"num_segments": 65}, "num_segments = 65 must"),
        ({"num_segments": 4.0}, "num_segments = 4.0 must"),
        ({"friction": -0.1}, "friction = -0.1 must be a finite number from 0 to 100"),
        ({"friction": math.nan}, "friction = nan must"),
        ({"friction": None}, "friction = None must"),
        ({"timestep_s": 0.0}, "timestep_s = 0.0 must be a finite number from 1e-06 to 0.01"),
        ({"timestep_s": 0.003}, "timestep_s = 0.003 must divide the thermal step"),
        ({"solver": "pgs"}, "solver = 'pgs' must be one of newton, cg"),
        ({"integrator": "euler"}, "integrator = 'euler' must be one of discrete, implicitfast"),
        ({"cone": "round"}, "cone = 'round' must be one of elliptic, pyramidal"),
        ({"bend_axis": "roll"}, "bend_axis = 'roll' must be one of yaw, pitch"),
    ],
    ids=lambda v: v if isinstance(v, str) else "",
)
def test_invalid_physics_is_rejected_with_the_reason(value, message):
    with pytest.raises(CaterpillarError, match=message):
        Physics.of(value)


def test_material_constants_may_be_a_hundred_times_the_default():
    for name in ("neck_", "axial_stiffness", "axial_damping", "bend_ratio", "friction"):
        for field, (lower, upper) in BOUNDS.items():
            if field.startswith(name):
                assert lower <= getattr(Physics(), field) / 100, field
                assert upper >= getattr(Physics(), field) * 100, field
