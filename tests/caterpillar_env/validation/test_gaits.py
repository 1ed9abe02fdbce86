import pytest

from caterpillar_env.validation.gaits import Gait, check_gaits, measure_gait
from caterpillar_env.validation.robots import evolved_robots


@pytest.fixture(scope="module")
def gait():
    return measure_gait(evolved_robots(1)[0], duration_s=10.0)


def test_figures_agree_with_the_simulation(gait):
    robot = evolved_robots(1)[0]
    end = robot.simulate(duration_s=10.0)
    assert gait.distance_m == end.distance_m[0]
    weight_n = 4 * robot.morphology.segment_mass_kg * 9.81
    assert gait.cost_of_transport == pytest.approx(end.energy_j[0] / weight_n / end.distance_m[0])
    length_m = 4 * robot.morphology.segment_length_m
    assert gait.body_lengths_s == pytest.approx(end.distance_m[0] / length_m / 10)


def test_figures_are_plausible(gait):
    assert gait.best_tenth >= 0.1  # a steady gait has a tenth of the distance in each tenth
    assert gait.peak_speed_m_s > gait.distance_m / 10
    assert 0 <= gait.body_load <= 0.15  # 5 % of 30 s may all fall into the first 10 s
    assert gait.overrun >= 0
    assert gait.slip > 0


@pytest.mark.parametrize(
    ("overruns", "load", "passed"),
    [
        ([0.0, 0.01, 0.14], 0.01, [True, True, True]),
        ([0.06, 0.06, 0.06], 0.01, [False, True, True]),
        ([0.0, 0.0, 0.16], 0.01, [True, False, True]),
        ([0.0, 0.0, 0.0], 0.06, [True, True, False]),
    ],
)
def test_soft_stops_and_crawling_on_the_body_do_not_pass(overruns, load, passed):
    gaits = [Gait(0.1, 0.2, 0.1, 0.5, load, overrun, 1000.0, 0.03) for overrun in overruns]
    assert [check.passed for check in check_gaits(gaits)] == passed
