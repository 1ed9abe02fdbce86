"""Objectives, and the definition of the best robot."""

import numpy as np

from caterpillar_env.robot import Outcomes, wave_robot
from caterpillar_env.task import Failure
from evolution.objective import OBJECTIVES, find_best, score


def test_objectives_are_distance_and_distance_per_energy():
    outcomes = Outcomes(
        np.array([0, Failure.TIPPED, 0, 0]), np.array([0.06, 0.5, -0.1, 0.02]),
        np.array([30.0, 10.0, 20.0, 0.0]), np.full(4, 30.0),
    )  # fmt: skip
    assert score(OBJECTIVES["distance"], outcomes, 0.001).tolist() == [0.06, 0.001, 0.0, 0.02]
    per_energy = score(OBJECTIVES["distance-per-energy"], outcomes, 0.001)
    assert per_energy.tolist() == [0.002, 0.001, 0.0, 0.002]  # the energy counts as at least 10 J


def test_robot_that_only_settles_scores_less_per_energy_than_a_wave():
    settling = Outcomes(*np.array([[Failure.NONE], [0.005], [0.001], [30.0]]))
    wave = wave_robot().simulate()
    standing, crawling = (OBJECTIVES["distance-per-energy"](ends)[0] for ends in (settling, wave))
    assert standing < crawling / 3


def test_the_best_robot_crawled_forwards_without_failing():
    failure = np.array([Failure.TIPPED, 0, 0, 0])
    energy_j = np.array([10.0, 10.0, 20.0, 10.0])
    outcomes = Outcomes(failure, np.array([0.5, -0.1, 0.3, 0.3]), energy_j, np.full(4, 30.0))
    assert find_best(OBJECTIVES["distance"], outcomes) == (2, 0.3)  # the first of equals
    assert find_best(OBJECTIVES["distance-per-energy"], outcomes) == (3, 0.03)
    backwards = outcomes.rows(slice(2))
    assert find_best(OBJECTIVES["distance"], backwards) is None
    assert find_best(lambda o: -o.distance_m, backwards) == (1, 0.1)  # a custom objective may prefer it
