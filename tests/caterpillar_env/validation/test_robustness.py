from dataclasses import replace

import numpy as np
import pytest

from caterpillar_env.robot import simulate
from caterpillar_env.validation import robustness
from caterpillar_env.validation.robots import evolved_robots, stack_robots
from evolution.genome import gene_values


def normalise_genes(robot):
    """Return the genes of a robot in [0, 1]."""
    times = gene_values([robot.morphology], robot.gaits)[0, 8:]
    return np.concatenate([robot.morphology.to_unit(), times / 5.0])


def test_each_robot_differs_in_one_gene_by_its_share():
    robot = evolved_robots(1)[0]
    others = robustness.perturb_genes(robot, 0.03, np.random.default_rng(0))
    assert len(others) == 20
    base = normalise_genes(robot)
    for gene, other in enumerate(others):
        change = np.abs(normalise_genes(other) - base)
        change = np.minimum(change, 1 - change)  # times wrap around the period
        assert change[gene] == pytest.approx(0.03)
        assert np.delete(change, gene) == pytest.approx(np.zeros(19), abs=1e-9)


@pytest.mark.slow
def test_distances_are_those_of_the_changed_robots_and_are_plotted(tmp_path):
    robots = evolved_robots(1)
    ratios = robustness.vary_genes(robots, duration_s=10.0)
    assert ratios.shape == (3, 1, 20)
    first = robustness.perturb_genes(robots[0], 0.01, np.random.default_rng(robustness.SEED))
    fitness_m = simulate(*stack_robots([*robots, *first]), robots[0].physics, duration_s=10.0).fitness()
    assert ratios[0, 0].tolist() == (fitness_m[1:] / fitness_m[0]).tolist()
    robustness.plot_genes(ratios, [str(i) for i in range(20)], tmp_path / "p.png")
    assert (tmp_path / "p.png").stat().st_size > 10_000


@pytest.mark.slow
def test_each_parameter_is_changed_alone_and_plotted(tmp_path):
    robots = evolved_robots(1)
    base, swings = robustness.vary_parameters(robots)
    assert base.tolist() == [robot.fitness_m for robot in robots]
    named = {swing.name: swing for swing in swings}
    assert len(named) == len(swings)
    for swing in swings:
        assert swing.low_m.shape == swing.high_m.shape == (1,)
        if swing.name != robustness.STOPS:  # it does not affect robots that never reach a stop
            assert not np.array_equal(swing.low_m, swing.high_m), swing.name
    slippery = replace(robots[0].physics, friction=0.4)
    expected = simulate(*stack_robots(robots), slippery).fitness()
    assert named["friction 0.4 / 1.2"].low_m.tolist() == expected.tolist()
    robustness.plot_parameters(base, swings, tmp_path / "tornado.png")
    assert (tmp_path / "tornado.png").stat().st_size > 10_000
