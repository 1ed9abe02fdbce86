from dataclasses import replace

import numpy as np
import pytest

from caterpillar_env.physics import Physics
from caterpillar_env.robot import Outcomes, simulate, stack
from caterpillar_env.validation import robustness
from caterpillar_env.validation.robots import evolved_robots


@pytest.mark.slow
def test_each_parameter_is_changed_alone_and_plotted(tmp_path):
    (robot,) = evolved_robots(1)
    robots = [replace(robot, physics=replace(robot.physics, timestep_s=0.01))]
    ratios = robustness.vary_parameters(robots)
    for name, (low, high) in ratios.items():
        assert low.shape == high.shape == (1,)
        if name != robustness.STOPS:  # it does not affect robots that never reach a stop
            assert not np.array_equal(low, high), name
    slippery = replace(robots[0].physics, friction=0.4)
    expected_m = simulate(*stack(robots), slippery).fitness()
    assert ratios["friction 0.4 / 1.2"][0] == expected_m / robots[0].simulate().fitness()
    robustness.plot_parameters(ratios, tmp_path / "tornado.png")
    assert (tmp_path / "tornado.png").stat().st_size > 10_000


def test_stops_with_half_and_twice_the_time_constant_may_change_the_distance_by_a_tenth(monkeypatch):
    normal_s = Physics().stop_time_constant_s
    distances_m = {0.5 * normal_s: 0.109, normal_s: 0.1, 2.0 * normal_s: 0.111}

    def simulate(bodies, timings, physics):
        nothing = np.zeros(1)
        distance_m = np.array([distances_m[physics.stop_time_constant_s]])
        return Outcomes(nothing.astype(np.int8), distance_m, nothing, nothing)

    monkeypatch.setattr(robustness, "simulate", simulate)
    half, twice = robustness.check_stops(evolved_robots(1))
    assert (half.name.split()[3], half.passed) == ("half", True)
    assert (twice.name.split()[3], twice.passed) == ("twice", False)
