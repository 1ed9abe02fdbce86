import numpy as np

from caterpillar_env.validation.mechanics import detectors
from caterpillar_env.validation.robots import evolved_robots, together


def test_evolved_robots_come_from_a_run_each_and_repeat_their_record():
    robots = evolved_robots()
    assert len(robots) == 32
    assert len({robot.digest for robot in robots}) == len(robots)
    best = robots[:2]
    for robot in best:
        assert robot.simulate().fitness()[0] == robot.fitness_m
    bodies, timings = together(best)
    assert bodies == [r.morphology for r in best]
    assert np.array_equal(timings.on_s[1], best[1].timings.on_s)


def test_failures_are_told_apart_and_healthy_robots_are_not_accused():
    assert not [check for check in detectors(evolved_robots(2)) if not check.passed]
