"""Sliders: what they show, what they change, and what they refuse."""

from dataclasses import replace

import numpy as np
import pytest

from caterpillar_env.errors import CaterpillarError
from caterpillar_env.gait import GaitTimings
from caterpillar_env.morphology import PARAMETERS, Morphology
from caterpillar_env.physics import Physics
from caterpillar_env.robot import Robot
from caterpillar_env.validation.robots import random_robots
from evolution.viewer.fields import fields_of
from evolution.viewer.session import nominal_robot

ROBOTS = {
    "nominal": nominal_robot(),
    "evolved": replace(random_robots(1, 0, Physics())[0], fitness_m=0.1, generation=3),
    "springs": Robot(
        Morphology(), GaitTimings(2.0, np.zeros(4), np.full(4, 1.2345)), Physics(num_segments=2)
    ),
    "segments": replace(nominal_robot(), morphology=(Morphology(),) * 4),
    "slippery": replace(nominal_robot(), physics=Physics(friction=0.0)),
    "sticky": replace(nominal_robot(), physics=Physics(friction=2.3456)),
}


@pytest.mark.parametrize("name", ROBOTS)
def test_every_number_is_within_its_bounds_and_survives_being_shown(name):
    robot = ROBOTS[name]
    for field in fields_of(robot):
        assert field.lower <= field.read(robot) <= field.upper
        assert field.write(robot, field.read(robot)) is robot


@pytest.mark.parametrize("name", ROBOTS)
def test_both_bounds_can_be_set_and_change_nothing_else(name):
    robot = ROBOTS[name]
    fields = fields_of(robot)
    for field in fields:
        for value in (field.lower, field.upper):
            changed = field.write(robot, value)
            assert field.read(changed) == value
            others = [f for f in fields if f is not field]
            assert [f.exact(changed) for f in others] == [f.exact(robot) for f in others]
            if changed is not robot:
                assert changed.fitness_m is None
                assert changed.generation is None


def test_bounds_are_those_of_the_morphology_in_other_units():
    robot = nominal_robot()
    body = [f for f in fields_of(robot) if f.folder == "body"]
    assert len(body) == len(PARAMETERS)
    for field, p in zip(body, PARAMETERS, strict=True):
        factor = {"mm": 1000, "g": 1000, "rad": 1}[field.label.split(", ")[1]]
        for shown, bound in ((field.lower, p.lower), (field.upper, p.upper)):
            assert shown == pytest.approx(factor * bound)
            changed = field.write(robot, shown)
            assert getattr(changed.morphology, p.name) == bound


@pytest.mark.parametrize(
    ("name", "counts"),
    [
        ("nominal", {"": 1, "body": 8, "gait, times in s": 12}),
        ("springs", {"": 1, "body": 8, "gait, times in s": 8}),
        ("segments", {"": 1, **{f"segment {i}": 8 for i in (1, 2, 3, 4)}, "gait, times in s": 12}),
    ],
)
def test_there_is_a_field_for_every_number(name, counts):
    folders = [field.folder for field in fields_of(ROBOTS[name])]
    assert {folder: folders.count(folder) for folder in folders} == counts


@pytest.mark.parametrize("value", [-1e9, 1e9, float("nan"), float("inf")])
def test_values_out_of_bounds_are_refused_in_one_line(value):
    robot = nominal_robot()
    for field in fields_of(robot):
        with pytest.raises(CaterpillarError, match="is not in") as refused:
            field.write(robot, value)
        assert field.label in str(refused.value)
        assert "\n" not in str(refused.value)
