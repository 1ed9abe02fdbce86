"""The best robots of a study, simulated again."""

from dataclasses import dataclass, replace

import numpy as np
import polars
import pytest

from caterpillar_env.physics import Physics
from caterpillar_env.robot import Outcomes, Robot
from caterpillar_env.task import Failure
from caterpillar_env.validation.robots import random_robots
from evolution.study import winners
from evolution.study.analysis import analyse
from evolution.study.config import Cell, StudyConfig
from evolution.study.results import Results, Run
from evolution.study.winners import Comparison, Winner, compare_winners, find_winners


@pytest.mark.parametrize(
    ("reference_m", "failure", "artefact"),
    [(0.095, "ok", False), (0.089, "ok", True), (0.111, "ok", True), (0.1, "tipped", True)],
)
def test_winner_that_changes_at_the_fine_timestep_is_an_artefact(reference_m, failure, artefact):
    winner = Winner("ga", 0, 0.1, reference_m, failure)
    assert winner.artefact is artefact


@dataclass(frozen=True)
class ArtificialRobot:
    """A robot that crawls farther at a long timestep."""

    fitness_m: float

    def simulate(self, timestep_s):
        distance_m = self.fitness_m - timestep_s
        return Outcomes(np.array([Failure.NONE]), *np.array([[distance_m], [1.0], [30.0]]))

    def save(self, path):
        path.write_text(str(self.fitness_m))


class ArtificialArm:
    """An arm whose evaluation number n crawls n / 10 m."""

    def robot(self, folder, evaluation):
        return ArtificialRobot(evaluation / 10)


def make_run(seed, best_m):
    """A run of seven evaluations; the one with the best distance is as in `ArtificialArm`."""
    curve_m = np.minimum(np.arange(7) / 10, best_m)
    return Run(seed, 30.0 * np.arange(1, 8), curve_m, np.full(7, "ok"), np.zeros(7, dtype=int), 1)


@pytest.fixture
def study(tmp_path):
    """Return a function from best distances by seed to the winners of a study with one arm."""

    def find(best_m):
        config = StudyConfig({"a": ArtificialArm()}, (0, 1, 2, 3), (9,), 210, reference="a")
        runs = {"a": [make_run(seed, best) for seed, best in best_m.items()]}
        empty = analyse(config, Results(polars.DataFrame(), []), None)
        return find_winners(replace(empty, runs=runs), tmp_path)

    return find


def test_best_robot_of_an_arm_is_simulated_at_a_finer_timestep(study, tmp_path):
    for seed in (0, 1, 3):
        Cell("a", seed).folder(tmp_path).mkdir(parents=True)
    first = study({0: 0.2, 1: 0.3})
    assert first == [Winner("a", 1, 0.3, pytest.approx(0.3 - 0.00025), "ok")]
    assert (tmp_path / "winners" / "a.json").read_text() == "0.3"
    ((_, seed, recorded_m, reference_m, _),) = study({0: 0.2, 1: 0.3, 3: 0.4})
    assert (seed, recorded_m, reference_m) == (3, 0.4, pytest.approx(0.4 - 0.00025))


def test_known_winners_do_not_need_their_run_folders(study, tmp_path):
    folder = Cell("a", 1).folder(tmp_path)
    folder.mkdir(parents=True)
    first = study({1: 0.3})
    folder.rmdir()
    assert study({1: 0.3}) == first


def test_arm_whose_robots_never_crawled_has_no_winner(study, tmp_path):
    Cell("a", 0).folder(tmp_path).mkdir(parents=True)
    assert study({0: 0.0}) == []


# The best robot of every run


class RandomRobots:
    """An arm whose evaluation number n is a random robot."""

    robots = random_robots(7, 3, Physics(num_segments=2, timestep_s=0.01))

    def robot(self, folder, evaluation):
        return self.robots[evaluation]


@pytest.fixture
def compare(tmp_path, monkeypatch):
    """Return a function from best distances by seed to the comparisons of a study with one arm."""
    monkeypatch.setattr(winners, "REFERENCES", {"5 ms": {"timestep_s": 0.005}})

    def run(best_m):
        config = StudyConfig({"a": RandomRobots()}, (0, 1, 2), (9,), 210, reference="a")
        empty = analyse(config, Results(polars.DataFrame(), []), None)
        runs = {"a": [make_run(seed, best) for seed, best in best_m.items()]}
        return compare_winners(replace(empty, runs=runs), tmp_path)

    return run


def test_best_robot_of_every_run_is_simulated_with_the_reference(compare, tmp_path):
    recorded_m = {0: 0.2, 1: 0.3, 2: 0.4}
    for seed in recorded_m:
        Cell("a", seed).folder(tmp_path).mkdir(parents=True)
    (found,) = compare(recorded_m)
    ends = [RandomRobots.robots[number].simulate(0.005) for number in (2, 3, 4)]
    errors = [
        abs(end.distance_m[0] / recorded - 1)
        for end, recorded in zip(ends, recorded_m.values(), strict=True)
        if end.failure[0] == Failure.NONE
    ]
    assert 0 < len(errors) <= 3
    failed = 3 - len(errors)
    assert found == Comparison(
        "a", "5 ms", 3, failed, pytest.approx(np.median(errors)), pytest.approx(max(errors))
    )
    saved = Robot.load(tmp_path / "winners" / "a" / "seed-1.json")
    assert saved.to_dict() == RandomRobots.robots[3].to_dict()


def test_robots_that_fail_count_apart_from_the_errors(compare, tmp_path, monkeypatch):
    for seed in (0, 1):
        Cell("a", seed).folder(tmp_path).mkdir(parents=True)

    def simulate(bodies, timings, physics):
        assert physics.timestep_s == 0.005
        failure = np.array([Failure.TIPPED, Failure.NONE], dtype=np.int8)
        return Outcomes(failure, np.array([0.01, 0.27]), np.zeros(2), np.zeros(2))

    monkeypatch.setattr(winners, "simulate", simulate)
    (found,) = compare({0: 0.2, 1: 0.3})
    assert found == Comparison("a", "5 ms", 2, 1, pytest.approx(0.1), pytest.approx(0.1))


def test_robots_are_simulated_once(compare, tmp_path, monkeypatch):
    folder = Cell("a", 1).folder(tmp_path)
    folder.mkdir(parents=True)
    first = compare({1: 0.3})
    monkeypatch.delattr(winners, "simulate")
    folder.rmdir()  # results are kept without the run
    assert compare({1: 0.3}) == first
    assert compare({0: 0.0}) == []
