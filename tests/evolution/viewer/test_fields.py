"""Fields show, change and limit the parameters of a robot."""

from dataclasses import replace

import numpy as np
import pytest

from caterpillar_env.gait import GaitTimings
from caterpillar_env.morphology import PARAMETERS, Morphology
from caterpillar_env.physics import Physics
from caterpillar_env.robot import Robot, wave_robot
from caterpillar_env.validation.robots import random_robots
from evolution.viewer.fields import fields_of, read_values

ROBOTS = {
    "nominal": wave_robot(),
    "evolved": replace(random_robots(1, 0, Physics())[0], fitness_m=0.1, generation=3),
    "springs": Robot(
        Morphology(), GaitTimings(2.0, np.zeros(4), np.full(4, 1.2345)), Physics(num_segments=2)
    ),
    "segments": replace(wave_robot(), morphology=(Morphology(),) * 4),
    "slippery": replace(wave_robot(), physics=Physics(friction=0.0)),
    "sticky": replace(wave_robot(), physics=Physics(friction=2.3456)),
    "hot": replace(wave_robot(), timings=GaitTimings(5.0, np.zeros(6), np.full(6, 4.99))),
}


TIMINGS = pytest.mark.parametrize("timing", ["on-off", "phase"])


@TIMINGS
@pytest.mark.parametrize("name", ROBOTS)
def test_values_are_within_their_bounds_and_rounding_does_not_change_them(name, timing):
    robot = ROBOTS[name]
    for field in fields_of(robot, timing):
        lower, upper = field.bounds
        assert lower <= field.read(robot) <= upper
        assert field.write(robot, field.read(robot)) is robot


@TIMINGS
@pytest.mark.parametrize("name", ROBOTS)
def test_both_bounds_can_be_set_and_change_no_other_field(name, timing):
    robot = ROBOTS[name]
    for number, field in enumerate(fields_of(robot, timing)):
        for value in field.bounds:
            changed = field.write(robot, value)
            if field.gene.circular:
                assert field.read(changed) % 100 == value % 100
            else:
                assert field.read(changed) == value
            others, expected = (np.delete(read_values(r, timing), number) for r in (changed, robot))
            assert others == pytest.approx(expected, abs=0 if timing == "on-off" else 1e-12)
            if field.folder != "gait":
                assert changed.timings is robot.timings
            if changed is not robot:
                assert (changed.fitness_m, changed.generation, changed.evaluation) == (None,) * 3


def test_bounds_of_the_body_match_the_morphology_in_display_units():
    robot = wave_robot()
    body = [field for field in fields_of(robot) if field.folder == "body"]
    factors = {"m": 1000, "kg": 1000, "rad": 180 / np.pi}
    for field, p in zip(body, PARAMETERS, strict=True):
        for shown, bound in zip(field.bounds, (p.lower, p.upper), strict=True):
            assert shown == pytest.approx(factors[p.unit] * bound, abs=0.05)
            changed = field.write(robot, shown)
            assert getattr(changed.morphology, p.name) == pytest.approx(bound, rel=0.005)


def test_the_rounded_end_of_a_slider_sets_the_exact_bound():
    robot = wave_robot()
    (limit,) = (field for field in fields_of(robot) if field.gene.name == "joint_limit_rad")
    assert limit.bounds[1] == 57.3  # a little more than 1 rad
    assert limit.write(robot, 57.3).morphology.joint_limit_rad == 1.0


@pytest.mark.parametrize(
    ("name", "counts"),
    [
        ("nominal", {"": 1, "body": 8, "gait": 12}),
        ("springs", {"": 1, "body": 8, "gait": 8}),
        ("segments", {"": 1, **{f"segment {i}": 8 for i in (1, 2, 3, 4)}, "gait": 12}),
    ],
)
def test_every_parameter_has_a_field(name, counts):
    folders = [field.folder for field in fields_of(ROBOTS[name])]
    assert {folder: folders.count(folder) for folder in folders} == counts


@pytest.mark.parametrize("value", [-1e9, 1e9, float("nan"), float("inf")])
def test_values_out_of_bounds_are_clipped(value):
    robot = wave_robot()
    for field in fields_of(robot):
        assert field.read(field.write(robot, value)) == field.bounds[value > 0]


def test_a_delay_shifts_all_pairs_that_depend_on_it():
    robot = wave_robot()
    (delay,) = (f for f in fields_of(robot, "phase") if f.gene.name == "gap2_dorsal_delay")
    before, after = robot.timings, delay.write(robot, delay.read(robot) + 10.0).timings
    moved_s = (after.on_s - before.on_s) % before.period_s
    assert moved_s == pytest.approx([0, 0, 0.5, 0.5, 0.5, 0.5], abs=0.01)  # 10 % of 5 s
    assert (after.off_s - before.off_s) % before.period_s == pytest.approx(moved_s, abs=1e-9)
