import numpy as np

from caterpillar_env.validation.robots import evolved_robots, stack_robots


def test_evolved_robots_come_from_different_runs_and_reproduce_their_fitness():
    robots = evolved_robots()
    assert len(robots) == 32
    assert len({robot.digest for robot in robots}) == len(robots)
    best = robots[:2]
    for robot in best:
        assert robot.simulate().fitness()[0] == robot.fitness_m
    bodies, timings = stack_robots(best)
    assert bodies == [r.morphology for r in best]
    assert np.array_equal(timings.on_s[1], best[1].timings.on_s)
