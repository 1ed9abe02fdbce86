from dataclasses import replace

import numpy as np
import pytest

from caterpillar_env.robot import simulate
from caterpillar_env.validation import sensitivity
from caterpillar_env.validation.robots import evolved_robots, together


@pytest.mark.slow
def test_each_parameter_is_changed_alone_and_drawn(tmp_path):
    robots = evolved_robots(1)
    base, swings = sensitivity.sweep(robots)
    assert base.tolist() == [robot.fitness_m for robot in robots]
    named = {swing.name: swing for swing in swings}
    assert len(named) == len(swings)
    for swing in swings:
        assert swing.low_m.shape == swing.high_m.shape == (1,)
        if swing.name != sensitivity.STOPS:  # robots that never reach a stop do not feel it
            assert not np.array_equal(swing.low_m, swing.high_m), swing.name
    slippery = replace(robots[0].physics, friction=0.4)
    expected = simulate(*together(robots), slippery).fitness()
    assert named["friction 0.4 / 1.2"].low_m.tolist() == expected.tolist()
    sensitivity.plot(base, swings, tmp_path / "tornado.png")
    assert (tmp_path / "tornado.png").stat().st_size > 10_000
