"""From genomes to outcomes, and from outcomes to fitness."""

import gymnasium as gym
import numpy as np
import pytest

from caterpillar_env.errors import CaterpillarError
from caterpillar_env.gait import GaitTimings
from caterpillar_env.morphology import Morphology
from caterpillar_env.physics import Physics
from caterpillar_env.robot import Outcomes, simulate
from caterpillar_env.task import EPISODE_S, Crawl, Failure
from evolution.config import RunConfig
from evolution.genome import Encoding
from evolution.run.evaluators import evaluate

PERIOD_S = RunConfig().gait_period_s
SHORT = Physics(num_segments=2)
#: So stiff, and so coarsely stepped, that the integration breaks down at once.
BROKEN = Physics(
    num_segments=2, integrator="implicitfast", timestep_s=0.01,
    axial_stiffness_n_m=1e5, axial_damping_n_s_m=0.0,
)  # fmt: skip


def genomes(count, num_genes=12, seed=0):
    return np.random.default_rng(seed).random((count, num_genes))


def outcomes(failure, distance_m):
    nothing = np.zeros(len(failure))
    return Outcomes(np.array(failure, dtype=np.int8), np.array(distance_m), nothing, nothing)


def same(one, two):
    return all(np.array_equal(a, b) for a, b in zip(one, two, strict=True))


# From outcomes to fitness


def test_fitness_of_a_sound_robot_is_its_distance():
    assert outcomes([0, 0], [0.05, 0.001]).fitness().tolist() == [0.05, 0.001]


def test_crawling_backwards_is_worth_nothing():
    assert outcomes([0], [-0.02]).fitness().tolist() == [0.0]


@pytest.mark.parametrize("failure", [f for f in Failure if f is not Failure.NONE])
def test_every_failure_earns_nothing_however_far_it_came(failure):
    assert outcomes([failure], [0.5]).fitness().tolist() == [0.0]


@pytest.mark.parametrize("distance", [np.nan, np.inf, -np.inf, 1e300])
def test_distance_of_a_diverged_robot_never_becomes_fitness(distance):
    fitness = outcomes([Failure.DIVERGED, Failure.NONE], [distance, 0.03]).fitness()
    assert fitness.tolist() == [0.0, 0.03]


# Simulating


def test_evaluation_repeats_the_environment_bit_for_bit():
    genome = genomes(1, 20)
    bodies, timings = Encoding(Physics(), PERIOD_S).decode(genome)
    ours = simulate(bodies, timings, Physics(), threads=1, duration_s=2 * PERIOD_S)
    env = gym.make(
        "CaterpillarSMA-v0", morphology=bodies[0], gait_period_s=PERIOD_S, disable_env_checker=True
    )
    env.reset(seed=0)
    for _ in range(2):
        *_, info = env.step(timings.to_action()[0])
    assert info["distance"] == ours.distance_m[0]
    assert info["energy_j"] == ours.energy_j[0]
    assert info["distance"] != 0.0


def test_a_robot_crawls_for_thirty_seconds_of_simulated_time():
    result = evaluate(genomes(1), Encoding(SHORT, PERIOD_S), threads=1)
    assert EPISODE_S == 30.0
    assert result.failure.tolist() == [Failure.NONE]
    assert result.simulated_s == pytest.approx(30.0)
    assert result.energy_j[0] > 0


def test_robots_do_not_feel_their_neighbours_in_the_batch_nor_the_threads():
    bodies, timings = Encoding(SHORT, PERIOD_S).decode(genomes(4))
    together = simulate(bodies, timings, SHORT, threads=2, duration_s=2.0)
    for i, body in enumerate(bodies):
        gait = GaitTimings(PERIOD_S, timings.on_s[i : i + 1], timings.off_s[i : i + 1])
        alone = simulate([body], gait, SHORT, threads=1, duration_s=2.0)
        assert same(alone, Outcomes(*(part[i : i + 1] for part in together)))
    assert len(set(together.distance_m.tolist())) == 4


def test_unpowered_robot_draws_nothing_and_hardly_moves():
    never = GaitTimings(PERIOD_S, np.ones((1, 2)), np.ones((1, 2)))
    result = simulate([Morphology()], never, SHORT, threads=1, duration_s=3.0)
    assert result.energy_j.tolist() == [0.0]
    assert abs(result.distance_m[0]) < 1e-3


def test_gait_is_repeated_every_period():
    # Powered for the first 0.2 s of every 2 s, too little to meet the cut-off: 3 s hold two pulses.
    pulse = GaitTimings(2.0, np.zeros((1, 2)), np.full((1, 2), 0.2))
    energies = [
        simulate([Morphology()], pulse, SHORT, threads=1, duration_s=t).energy_j[0]
        for t in (0.1, 1.0, 3.0, 5.0)
    ]
    # Two pairs of springs for 0.2 s.
    assert energies[1] == pytest.approx(4 * SHORT.spring.drive_power_w * 0.2, rel=1e-9)
    assert np.array(energies) / energies[1] == pytest.approx([0.5, 1.0, 2.0, 3.0], rel=1e-9)


def test_progress_is_told_every_control_interval():
    traces = []
    bodies, timings = Encoding(SHORT, PERIOD_S).decode(genomes(2))
    simulate(bodies, timings, SHORT, threads=1, duration_s=1.5, on_interval=traces.append)
    assert [trace.energy_j.shape[1] for trace in traces] == [10] * 15


def test_trace_holds_every_thermal_step():
    traces = []
    bodies, timings = Encoding(SHORT, PERIOD_S).decode(genomes(1))
    simulate(bodies, timings, SHORT, threads=1, duration_s=0.5, on_interval=traces.append)
    assert sum(trace.temperature_c.shape[1] for trace in traces) == 50
    assert {trace.temperature_c.shape[2] for trace in traces} == {4}


def test_diverged_robot_stops_at_once_and_has_finite_fitness(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # MuJoCo leaves its log where it runs
    result = evaluate(genomes(2), Encoding(BROKEN, PERIOD_S), threads=1)
    assert result.failure.tolist() == [Failure.DIVERGED] * 2
    assert np.all(result.simulated_s < 30.0)
    assert result.fitness().tolist() == [0.0, 0.0]


def test_distance_is_finite_even_where_the_robot_is_nowhere(monkeypatch):
    progress = Crawl.progress

    def lost(self, rows=None):
        found = progress(self, rows)
        return found._replace(distance_m=np.full_like(found.distance_m, np.nan))

    monkeypatch.setattr(Crawl, "progress", lost)
    bodies, timings = Encoding(SHORT, PERIOD_S).decode(genomes(1))
    outcomes = simulate(bodies, timings, SHORT, threads=1, duration_s=0.1)
    assert outcomes.distance_m.tolist() == [0.0]


def test_failed_robots_stop_while_sound_ones_go_on():
    # Limp, undamped necks: some of these bodies tip over within the first seconds.
    limp = Physics(num_segments=2, neck_stiffness_n_m_rad=1e-4, neck_damping_n_m_s_rad=0.0)
    bodies, timings = Encoding(SHORT, 3.0).decode(genomes(20))
    result = simulate(bodies, timings, limp, threads=2, duration_s=3.0)
    failed = result.failure != Failure.NONE
    assert 0 < failed.sum() < 20, "the scenario no longer mixes sound and failing robots"
    assert np.all(result.simulated_s[failed] < 3.0)
    assert result.simulated_s[~failed] == pytest.approx(3.0)
    assert np.all(result.fitness()[failed] == 0)


@pytest.mark.parametrize("period_s", [0.25, 0.04, 3.01])
def test_period_off_the_control_interval_is_refused(period_s):
    with pytest.raises(CaterpillarError, match=r"multiple of 0\.1 s"):
        evaluate(genomes(1), Encoding(SHORT, period_s))


@pytest.mark.parametrize("duration_s", [0.0, -1.0, 0.15])
def test_duration_off_the_control_interval_is_refused(duration_s):
    bodies, timings = Encoding(SHORT, PERIOD_S).decode(genomes(1))
    with pytest.raises(CaterpillarError, match="the duration"):
        simulate(bodies, timings, SHORT, duration_s=duration_s)


def test_negative_threads_are_refused():
    with pytest.raises(CaterpillarError, match="threads"):
        evaluate(genomes(1), Encoding(SHORT, PERIOD_S), threads=-1)


def test_genomes_of_another_robot_are_refused():
    with pytest.raises(CaterpillarError, match=r"\(P, 12\)"):
        evaluate(genomes(1, 20), Encoding(SHORT, PERIOD_S))
