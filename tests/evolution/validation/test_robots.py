import numpy as np

from evolution.validation.mechanics import detectors
from evolution.validation.robots import evolved_robots, together


def test_evolved_robots_are_fifty_and_repeat_their_record():
    robots = evolved_robots()
    assert len(robots) == 50
    best = robots[:2]
    for robot in best:
        assert robot.simulate().fitness()[0] == robot.fitness_m
    bodies, timings = together(best)
    assert bodies == [r.morphology for r in best]
    assert np.array_equal(timings.on_s[1], best[1].timings.on_s)


def test_failures_are_told_apart_and_healthy_robots_are_not_accused():
    assert not [check for check in detectors(evolved_robots(2)) if not check.passed]
