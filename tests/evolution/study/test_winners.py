"""The best robots of a study under other conditions, with artificial robots."""

from dataclasses import dataclass, field, replace

import numpy as np
import polars
import pytest

from caterpillar_env.physics import Physics
from caterpillar_env.robot import Outcomes
from caterpillar_env.task import Failure
from evolution.study.analysis import analyse
from evolution.study.config import Cell, StudyConfig
from evolution.study.results import Results, Run
from evolution.study.winners import Winner, find_winners


@pytest.mark.parametrize(
    ("reference_m", "failure", "artefact"),
    [(0.095, "ok", False), (0.089, "ok", True), (0.111, "ok", True), (0.1, "tipped", True)],
)
def test_winner_that_changes_at_the_fine_timestep_is_an_artefact(reference_m, failure, artefact):
    winner = Winner("ga", 0, 0.1, reference_m, failure, [0.0, 0.1], None)
    assert winner.artefact is artefact


@dataclass(frozen=True)
class ArtificialRobot:
    """A robot that crawls farther on slippery ground, and falls at a friction of 0.9."""

    fitness_m: float
    physics: Physics = field(default_factory=Physics)

    def simulate(self, timestep_s=None):
        physics = self.physics
        distance_m = self.fitness_m + 0.8 - physics.friction + 1e-6 * physics.mismatch_seed
        failure = Failure.TIPPED if physics.friction == 0.9 else Failure.NONE
        return Outcomes(
            np.array([failure]), *np.array([[distance_m - (timestep_s or 0)], [1.0], [30.0]])
        )

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


def test_best_robot_of_an_arm_is_simulated_under_other_conditions(study, tmp_path):
    for seed in (0, 1, 3):
        Cell("a", seed).folder(tmp_path).mkdir(parents=True)
    first = study({0: 0.2, 1: 0.3})
    assert first == [
        Winner(
            "a", 1, 0.3, pytest.approx(0.3 - 0.00025), "ok", [0.0, pytest.approx(0.5)],
            [pytest.approx(0.301001), pytest.approx(0.301004)],
        )
    ]  # fmt: skip
    assert (tmp_path / "winners" / "a.json").read_text() == "0.3"
    ((_, seed, recorded_m, reference_m, *_),) = study({0: 0.2, 1: 0.3, 3: 0.4})
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
