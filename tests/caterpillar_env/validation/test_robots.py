import numpy as np

from caterpillar_env import Morphology, Physics
from caterpillar_env.model import joint_names
from caterpillar_env.robot import stack
from caterpillar_env.validation.robots import (
    evolved_robots,
    farthest_robots,
    start,
)


def test_evolved_robots_come_from_different_runs_and_reproduce_their_fitness():
    robots = evolved_robots()
    assert len(robots) == 32
    assert len({robot.digest for robot in robots}) == len(robots)
    best = robots[:2]
    for robot in best:
        assert robot.simulate().fitness()[0] == robot.fitness_m
    bodies, timings = stack(best)
    assert bodies == [r.morphology for r in best]
    assert np.array_equal(timings.on_s[1], best[1].timings.on_s)


def test_farthest_robots_have_the_highest_fitness():
    every = sorted((robot.fitness_m for robot in evolved_robots()), reverse=True)
    assert [robot.fitness_m for robot in farthest_robots(3)] == every[:3]


def test_start_is_moved_by_the_same_length_at_every_joint():
    physics = Physics(num_segments=2)
    bodies = [Morphology(segment_length_m=length_m) for length_m in (0.026, 0.034)]
    crawl = start(bodies, physics, offset_m=1e-6)
    names = joint_names(2)
    for body, row in zip(bodies, crawl.simulation.state().joint_position, strict=True):
        for name, moved in zip(names, row, strict=True):
            arm_m = 1.0 if name.startswith("axial") else body.segment_length_m / 4
            np.testing.assert_allclose(moved * arm_m, 1e-6, err_msg=name)
