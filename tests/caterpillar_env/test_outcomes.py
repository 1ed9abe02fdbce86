"""From bodies and gaits to outcomes, and from outcomes to fitness."""

import numpy as np
import pytest

from caterpillar_env.errors import CaterpillarError
from caterpillar_env.gait import GaitTimings
from caterpillar_env.morphology import Morphology
from caterpillar_env.physics import Physics
from caterpillar_env.robot import Outcomes, Robot, simulate, stack, wave_robot
from caterpillar_env.task import EPISODE_S, Crawl, Failure
from caterpillar_env.validation.robots import random_robots

PERIOD_S = 2.0
SHORT = Physics(num_segments=2)
#: A stiffness and a timestep with which the integration diverges at once.
BROKEN = Physics(
    num_segments=2, integrator="implicitfast", timestep_s=0.01,
    axial_stiffness_n_m=1e5, axial_damping_n_s_m=0.0,
)  # fmt: skip


def some(count, period_s=PERIOD_S):
    """Bodies and gaits of random robots with two segments."""
    rng = np.random.default_rng(0)
    bodies = [Morphology.from_unit(rng.random(8)) for _ in range(count)]
    on_s, off_s = period_s * rng.random((2, count, 2))
    return bodies, GaitTimings(period_s, on_s, off_s)


def outcomes(failure, distance_m):
    nothing = np.zeros(len(failure))
    return Outcomes(np.array(failure, dtype=np.int8), np.array(distance_m), nothing, nothing)


# From outcomes to fitness


def test_fitness_of_a_sound_robot_is_its_distance():
    assert outcomes([0, 0], [0.05, 0.001]).fitness().tolist() == [0.05, 0.001]


def test_fitness_of_a_robot_that_crawls_backwards_is_0():
    assert outcomes([0], [-0.02]).fitness().tolist() == [0.0]


@pytest.mark.parametrize("failure", [f for f in Failure if f is not Failure.NONE])
def test_fitness_of_a_failed_robot_is_0(failure):
    assert outcomes([failure], [0.5]).fitness().tolist() == [0.0]


@pytest.mark.parametrize("distance", [np.nan, np.inf, -np.inf, 1e300])
def test_distance_of_a_diverged_robot_never_becomes_fitness(distance):
    fitness = outcomes([Failure.DIVERGED, Failure.NONE], [distance, 0.03]).fitness()
    assert fitness.tolist() == [0.0, 0.03]


# Simulating


def test_a_robot_crawls_for_thirty_seconds_of_simulated_time():
    result = simulate(*some(1), SHORT, threads=1)
    assert EPISODE_S == 30.0
    assert result.failure.tolist() == [Failure.NONE]
    assert result.simulated_s == pytest.approx(30.0)
    assert result.energy_j[0] > 0


def test_robot_without_power_uses_no_energy_and_hardly_moves():
    never = GaitTimings(PERIOD_S, np.ones((1, 2)), np.ones((1, 2)))
    result = simulate([Morphology()], never, SHORT, threads=1, duration_s=3.0)
    assert result.energy_j.tolist() == [0.0]
    assert abs(result.distance_m[0]) < 1e-3


def test_gait_is_repeated_every_period():
    # The springs are powered for the first 0.2 s of every 2 s, too short to reach the cut-off
    # temperature. Two pulses fall within 3 s.
    pulse = GaitTimings(2.0, np.zeros((1, 2)), np.full((1, 2), 0.2))
    energies = [
        simulate([Morphology()], pulse, SHORT, threads=1, duration_s=t).energy_j[0]
        for t in (0.1, 1.0, 3.0, 5.0)
    ]
    # Two pairs of springs for 0.2 s.
    assert energies[1] == pytest.approx(4 * SHORT.spring.drive_power_w * 0.2, rel=1e-9)
    assert np.array(energies) / energies[1] == pytest.approx([0.5, 1.0, 2.0, 3.0], rel=1e-9)


def test_function_gets_the_trace_of_every_control_interval():
    traces = []
    simulate(*some(2), SHORT, threads=1, duration_s=1.5, on_interval=traces.append)
    assert [trace.energy_j.shape[1] for trace in traces] == [10] * 15


def test_diverged_robot_stops_at_once_with_finite_fitness(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # MuJoCo logs its warning in the working directory
    result = simulate(*some(2), BROKEN, threads=1)
    assert result.failure.tolist() == [Failure.DIVERGED] * 2
    assert np.all(result.simulated_s < 30.0)
    assert result.fitness().tolist() == [0.0, 0.0]


@pytest.mark.parametrize("distance_m", [np.nan, np.inf, 7.0])
def test_distance_of_a_diverged_robot_is_0(monkeypatch, distance_m):
    progress = Crawl.progress

    def diverged(self, rows=None):
        found = progress(self, rows)
        failure = np.full_like(found.failure, Failure.DIVERGED)
        return found._replace(distance_m=np.full_like(found.distance_m, distance_m), failure=failure)

    monkeypatch.setattr(Crawl, "progress", diverged)
    outcomes = simulate(*some(1), SHORT, threads=1, duration_s=0.1)
    assert outcomes.distance_m.tolist() == [0.0]


def test_failed_robots_stop_while_others_continue():
    # Limp, undamped necks: some of these bodies tip over within the first seconds.
    limp = Physics(num_segments=2, neck_stiffness_n_m_rad=1e-4, neck_damping_n_m_s_rad=0.0)
    result = simulate(*some(20, 3.0), limp, threads=2, duration_s=3.0)
    failed = result.failure != Failure.NONE
    assert 0 < failed.sum() < 20, "some robots must fail, and others must not"
    assert result.simulated_s[failed].min() < 1.0
    assert result.simulated_s[~failed] == pytest.approx(3.0)
    assert np.all(result.fitness()[failed] == 0)


@pytest.mark.parametrize("period_s", [0.25, 0.04, 3.01])
def test_period_off_the_control_interval_is_refused(period_s):
    with pytest.raises(CaterpillarError, match=r"multiple of 0\.1 s"):
        simulate(*some(1, period_s), SHORT)


@pytest.mark.parametrize("duration_s", [0.0, -1.0, 0.15])
def test_duration_off_the_control_interval_is_refused(duration_s):
    with pytest.raises(CaterpillarError, match="the duration"):
        simulate(*some(1), SHORT, duration_s=duration_s)


def test_negative_threads_are_refused():
    with pytest.raises(CaterpillarError, match="threads"):
        simulate(*some(1), SHORT, threads=-1)


# Groups of robots


def test_joined_outcomes_have_all_robots_in_order():
    parts = [outcomes([0, Failure.TIPPED], [0.1, 0.2]), outcomes([0], [0.3])]
    joined = Outcomes.join(parts)
    assert joined.distance_m.tolist() == [0.1, 0.2, 0.3]
    assert joined.failure.tolist() == [0, Failure.TIPPED, 0]
    assert joined.rows(slice(1, 3)).distance_m.tolist() == [0.2, 0.3]


def test_robots_of_different_periods_or_springs_are_not_stacked():
    robots = random_robots(2, 0, Physics())
    bodies, timings = stack(robots)
    assert bodies == [robot.morphology for robot in robots]
    np.testing.assert_array_equal(timings.on_s[1], robots[1].timings.on_s)
    short = Robot(Morphology(), GaitTimings(2.0, np.zeros(6), np.ones(6)), Physics())
    for other in (short, wave_robot_of_springs()):
        with pytest.raises(CaterpillarError, match="the same gait period and the same number"):
            stack([robots[0], other])


def wave_robot_of_springs():
    wave = wave_robot()
    return Robot(wave.morphology, wave.timings.mirrored(), wave.physics)


def test_wave_robot_crawls_as_far_as_the_documentation_says():
    assert wave_robot().simulate().distance_m == pytest.approx(0.177, abs=5e-4)
