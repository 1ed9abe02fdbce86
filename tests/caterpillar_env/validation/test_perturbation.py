import numpy as np
import pytest

from caterpillar_env.robot import simulate
from caterpillar_env.validation import perturbation
from caterpillar_env.validation.robots import evolved_robots, together
from evolution.genome import gene_values


def in_unit(robot):
    """The genes of a robot in [0, 1]."""
    times = gene_values([robot.morphology], robot.gaits)[0, 8:]
    return np.concatenate([robot.morphology.to_unit(), times / 5.0])


def test_each_robot_differs_in_one_gene_by_its_share():
    robot = evolved_robots(1)[0]
    others = perturbation.perturbed(robot, 0.03, np.random.default_rng(0))
    assert len(others) == 20
    base = np.concatenate(
        [robot.morphology.to_unit(), gene_values([robot.morphology], robot.gaits)[0, 8:] / 5.0]
    )
    for gene, other in enumerate(others):
        values = np.concatenate(
            [other.morphology.to_unit(), gene_values([other.morphology], other.gaits)[0, 8:] / 5.0]
        )
        change = np.abs(values - base)
        change = np.minimum(change, 1 - change)  # times pass round the end of the period
        assert change[gene] == pytest.approx(0.03)
        assert np.delete(change, gene) == pytest.approx(np.zeros(19), abs=1e-9)


@pytest.mark.slow
def test_distances_are_those_of_the_changed_robots_and_are_drawn(tmp_path):
    robots = evolved_robots(1)
    ratios = perturbation.sweep(robots, duration_s=10.0)
    assert ratios.shape == (3, 1, 20)
    first = perturbation.perturbed(robots[0], 0.01, np.random.default_rng(perturbation._SEED))
    fitness_m = simulate(*together([*robots, *first]), robots[0].physics, duration_s=10.0).fitness()
    assert ratios[0, 0].tolist() == (fitness_m[1:] / fitness_m[0]).tolist()
    perturbation.plot(ratios, [str(i) for i in range(20)], tmp_path / "p.png")
    assert (tmp_path / "p.png").stat().st_size > 10_000
