from dataclasses import replace

import numpy as np
import pytest

from caterpillar_env.robot import simulate
from caterpillar_env.validation import robustness
from caterpillar_env.validation.robots import evolved_robots, stack_robots


@pytest.mark.slow
def test_each_parameter_is_changed_alone_and_plotted(tmp_path):
    robots = evolved_robots(1)
    ratios = robustness.vary_parameters(robots)
    for name, (low, high) in ratios.items():
        assert low.shape == high.shape == (1,)
        if name != robustness.STOPS:  # it does not affect robots that never reach a stop
            assert not np.array_equal(low, high), name
    slippery = replace(robots[0].physics, friction=0.4)
    expected_m = simulate(*stack_robots(robots), slippery).fitness()
    assert ratios["friction 0.4 / 1.2"][0] == expected_m / robots[0].fitness_m
    robustness.plot_parameters(ratios, tmp_path / "tornado.png")
    assert (tmp_path / "tornado.png").stat().st_size > 10_000
