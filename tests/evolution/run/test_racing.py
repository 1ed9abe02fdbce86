"""Racing: the best share of a generation continues, with the same outcomes as without racing."""

from dataclasses import replace

import numpy as np
import polars
import pytest

from caterpillar_env.physics import Physics
from caterpillar_env.task import Failure
from evolution import History, RunConfig, evolve, resume
from evolution.objective import distance, find_best, stopped
from evolution.optimizers.ga import GaConfig
from evolution.run.evaluators import Job, LocalEvaluator, evaluate, run_job
from evolution.run.racing import count_leaders, leaders, race

CONFIG = RunConfig(
    generations=2, timing="wave", race_share=0.3, ga=GaConfig(population=7, hall_of_fame=1),
    physics=Physics(num_segments=3, timestep_s=0.01),
)  # fmt: skip
ENCODING = CONFIG.encoding
GENOMES = np.random.default_rng(0).random((7, 12))
GENOMES[:, 8:] = 0.7, 0.2, 0.5, 0.3  # a wave from the tail


@pytest.fixture(scope="module")
def complete():
    return evaluate(GENOMES, ENCODING, threads=1)


@pytest.fixture(scope="module")
def raced():
    return race(GENOMES, CONFIG, distance, LocalEvaluator(1))


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """A run of two generations, each a race."""
    return evolve(CONFIG, tmp_path_factory.mktemp("whole"), evaluator=LocalEvaluator(2))


def test_leaders_are_the_best_in_order_of_their_index():
    fitness = np.array([0.1, 0.5, 0.3, 0.5, -np.inf])
    assert leaders(fitness, 2).tolist() == [1, 3]
    assert leaders(fitness, 3).tolist() == [1, 2, 3]
    assert leaders(np.full(3, 0.2), 2).tolist() == [0, 1]  # ties go to the first
    assert leaders(fitness, 5).tolist() == [0, 1, 2, 3]  # a failed robot never leads


@pytest.mark.parametrize(
    ("share", "robots", "count"), [(0.3, 7, 3), (0.07, 100, 7), (0.01, 7, 1), (1e-10, 4, 1)]
)
def test_share_of_the_leaders_is_rounded_up(share, robots, count):
    assert count_leaders(share, robots) == count


def test_leaders_have_the_same_outcomes_as_without_racing(raced, complete):
    went_on = raced.simulated_s > 10.0
    assert went_on.sum() == 3  # 0.3 of 7, rounded up
    for one, other in zip(raced, complete, strict=True):
        np.testing.assert_array_equal(one[went_on], other[went_on])


def test_other_robots_stop_after_two_periods(raced):
    early = run_job(Job(GENOMES, 10.0), ENCODING, threads=1).outcomes
    behind = stopped(raced)
    assert behind.any()
    assert set(raced.simulated_s[behind]) == {10.0}
    np.testing.assert_equal(raced.rows(behind), early.rows(behind))


def test_leaders_have_the_best_fitness_after_two_periods(raced):
    early = run_job(Job(GENOMES, 10.0), ENCODING, threads=1).outcomes
    went_on = raced.simulated_s > 10.0
    assert early.fitness()[went_on].min() > early.fitness()[stopped(raced)].max()


def test_simulated_time_of_stopped_robots_ends_after_two_periods(raced, complete):
    expected = np.where(stopped(raced), 10.0, complete.simulated_s)
    np.testing.assert_array_equal(raced.simulated_s, expected)


def test_simulation_continues_bit_for_bit_from_a_state_in_mid_episode(complete):
    half = run_job(Job(GENOMES, 12.3), ENCODING, threads=1)
    rows = np.array([5, 1, 2])
    rest = run_job(Job(GENOMES[rows], 30.0, half.end.rows(rows)), ENCODING, threads=2)
    for one, other in zip(rest.outcomes, complete, strict=True):
        np.testing.assert_array_equal(one, other[rows])


class WithFailures(LocalEvaluator):
    """Marks the first four robots as failed after two periods, and sets their distances to 1 m."""

    def map(self, encoding, jobs, on_progress=None):
        for job, result in zip(jobs, super().map(encoding, jobs, on_progress), strict=True):
            if job.end_s == 10.0:
                result.outcomes.failure[:4] = Failure.VEERED
                result.outcomes.distance_m[:4] = 1.0
            yield result


def test_failed_robots_never_continue():
    outcomes = race(GENOMES, CONFIG, lambda o: -1.0 - o.energy_j, WithFailures(1))
    assert (outcomes.simulated_s[:4] <= 10.0).all()
    assert (outcomes.simulated_s[4:6] == 30.0).all()  # the last robot fails after 8.5 s


def test_stopped_robot_is_never_the_best(raced):
    farther = raced._replace(distance_m=np.where(stopped(raced), 9.0, raced.distance_m))
    found = find_best(distance, farther)
    assert found is not None
    index, value = found
    assert not stopped(raced)[index]
    assert value < 9.0


def test_progress_rises_to_one(raced):
    shares = []
    race(GENOMES, CONFIG, distance, LocalEvaluator(1), shares.append)
    assert shares == sorted(shares)
    assert shares[-1] == pytest.approx(1.0)


def test_run_is_the_same_for_any_number_of_threads_and_after_a_stop(whole, tmp_path):
    evolve(replace(CONFIG, generations=1), tmp_path / "parts", evaluator=LocalEvaluator(1))
    parts = resume(tmp_path / "parts", generations=2, evaluator=LocalEvaluator(1))
    one, other = (history.table().drop("session") for history in (whole, parts))
    assert one.equals(other)
    assert [g.stopped for g in whole.generations] == [
        rows["stopped"].sum() for _, rows in whole.table().group_by("generation", maintain_order=True)
    ]
    assert whole.generations[0].stopped > 0
    first = whole.table().filter((polars.col("generation") == 0) & ~polars.col("stopped"))
    assert whole.generations[0].mean_m == pytest.approx(first["fitness"].mean())
    assert History.read(whole.folder).best.number == whole.best.number


class Cut(LocalEvaluator):
    """Stops in the second part of the first race."""

    def map(self, encoding, jobs, on_progress=None):
        if jobs and jobs[0].start is not None:
            raise KeyboardInterrupt
        yield from super().map(encoding, jobs, on_progress)


def test_interrupted_race_is_run_again(whole, tmp_path):
    cut = evolve(CONFIG, tmp_path / "cut", evaluator=Cut(1))
    assert not cut.evaluations
    again = resume(tmp_path / "cut", evaluator=LocalEvaluator(1))
    assert again.table().drop("session").equals(whole.table().drop("session"))
