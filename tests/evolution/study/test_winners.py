"""The best robots of a study, simulated again."""

import json
import shutil
import tomllib
from dataclasses import dataclass, replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import polars
import pytest

from caterpillar_env.errors import CaterpillarError
from caterpillar_env.physics import Physics
from caterpillar_env.robot import Outcomes, Robot, simulate, wave_robot
from caterpillar_env.task import Failure
from caterpillar_env.validation.gaits import measure_gait
from caterpillar_env.validation.robots import random_robots
from evolution import evolve
from evolution import load as load_run
from evolution.run.journal import Journal
from evolution.study import winners
from evolution.study.analysis import analyse
from evolution.study.config import Cell, StudyConfig, begin
from evolution.study.results import Results, Run, collect
from evolution.study.winners import CONDITIONS, Comparison, Crawling, Winner, retest_winners

SMALL = tomllib.loads(Path(__file__).with_name("small.toml").read_text("utf-8"))


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
    timestep_s: float = 0.0

    def with_physics(self, timestep_s):
        return replace(self, timestep_s=timestep_s)

    def simulate(self):
        distance_m = self.fitness_m - self.timestep_s
        return Outcomes(np.array([Failure.NONE]), *np.array([[distance_m], [1.0], [30.0]]))

    def save(self, path):
        path.write_text(str(self.fitness_m))


class ArtificialArm:
    """An arm whose evaluation number n crawls n / 10 m."""

    restorable = False

    def robot(self, folder, evaluation):
        return ArtificialRobot(evaluation / 10)

    def load(self, path):
        return ArtificialRobot(float(path.read_text()))


def make_run(seed, best_m):
    """A run of seven evaluations; the one with the best distance is as in `ArtificialArm`."""
    curve_m = np.minimum(np.arange(7) / 10, best_m)
    return Run(seed, 30.0 * np.arange(1, 8), curve_m, np.full(7, "ok"), np.zeros(7, dtype=int), 1, 210.0)


@pytest.fixture
def study(tmp_path):
    """Return a function from best distances by seed to the winners of a study with one arm."""

    def find(best_m, budget_s=210):
        config = StudyConfig({"a": ArtificialArm()}, (0, 1, 2, 3), budget_s, reference="a")
        runs = {"a": [make_run(seed, best) for seed, best in best_m.items()]}
        empty = analyse(config, Results(polars.DataFrame(), []))
        return retest_winners(replace(empty, runs=runs), tmp_path).winners

    return find


def test_best_robot_of_an_arm_is_simulated_at_a_finer_timestep(study, tmp_path):
    for seed in (0, 1, 3):
        Cell("a", seed).folder(tmp_path).mkdir(parents=True)
    first = study({0: 0.2, 1: 0.3})
    assert first == [Winner("a", 1, 0.3, pytest.approx(0.3 - 0.00025), "ok")]
    assert (tmp_path / "winners" / "a.json").read_text() == "0.3"
    ((_, seed, recorded_m, reference_m, _),) = study({0: 0.2, 1: 0.3, 3: 0.4})
    assert (seed, recorded_m, reference_m) == (3, 0.4, pytest.approx(0.4 - 0.00025))


def test_winner_is_found_within_the_budget_of_all_arms(study, tmp_path):
    Cell("a", 0).folder(tmp_path).mkdir(parents=True)
    # The robot of 0.6 m ends at 210 s, and the one of 0.4 m at 150 s.
    (winner,) = study({0: 0.6}, budget_s=179.0)
    assert winner.recorded_m == 0.4
    (winner,) = study({0: 0.6})
    assert winner.recorded_m == 0.6


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

    restorable = False

    robots = random_robots(7, 3, Physics(num_segments=2, timestep_s=0.01))

    def robot(self, folder, evaluation):
        return self.robots[evaluation]

    def load(self, path):
        return Robot.load(path)


@pytest.fixture
def compare(tmp_path, monkeypatch):
    """Return a function from best distances by seed to the comparisons of a study with one arm."""
    monkeypatch.setattr(winners, "CONDITIONS", {"5 ms": {"timestep_s": 0.005}})
    monkeypatch.setattr(winners, "REFERENCE_TIMESTEP_S", 0.005)

    def run(best_m):
        config = StudyConfig({"a": RandomRobots()}, (0, 1, 2), 210, reference="a")
        empty = analyse(config, Results(polars.DataFrame(), []))
        runs = {"a": [make_run(seed, best) for seed, best in best_m.items()]}
        return retest_winners(replace(empty, runs=runs), tmp_path, every_run=True)

    return run


def test_best_robot_of_every_run_is_simulated_under_the_conditions(compare, tmp_path):
    recorded_m = {0: 0.2, 1: 0.3, 2: 0.4}
    for seed in recorded_m:
        Cell("a", seed).folder(tmp_path).mkdir(parents=True)
    found = compare(recorded_m)
    robots = RandomRobots.robots[2:5]
    ends = [robot.with_physics(timestep_s=0.005).simulate() for robot in robots]
    shares = [
        end.distance_m[0] / recorded
        for end, recorded in zip(ends, recorded_m.values(), strict=True)
        if end.failure[0] == Failure.NONE
    ]
    assert 0 < len(shares) <= 3
    middle, low, high = (pytest.approx(f(shares)) for f in (np.median, min, max))
    median_m = pytest.approx(np.median([end.fitness()[0] for end in ends]))
    assert found.comparisons == [
        Comparison("a", "5 ms", 3, 3 - len(shares), middle, low, high, median_m)
    ]
    loads = np.quantile([measure_gait(robot).body_load for robot in robots], [0.5, 0.25, 0.75])
    assert Crawling("a", "body load", 3, *map(pytest.approx, loads)) in found.crawling
    saved = Robot.load(tmp_path / "winners" / "a" / "seed-1.json")
    assert saved.to_dict() == robots[1].to_dict()
    (winner,) = found.winners
    assert (winner.seed, winner.reference_m) == (2, ends[2].distance_m[0])


def test_gaits_of_earlier_versions_are_measured_again(compare, tmp_path):
    Cell("a", 0).folder(tmp_path).mkdir(parents=True)
    before = compare({0: 0.2}).crawling
    file = tmp_path / "winners" / "winners.json"
    (row,) = json.loads(file.read_text("utf-8"))
    del row["gait"]["airborne"]
    file.write_text(json.dumps([row]))
    assert compare({0: 0.2}).crawling == before


def test_results_of_robots_that_are_no_longer_the_best_are_removed(compare, tmp_path):
    for seed in (0, 1):
        Cell("a", seed).folder(tmp_path).mkdir(parents=True)
    for best_m in ({0: 0.2, 1: 0.3}, {0: 0.25, 1: 0.3}):
        compare(best_m)
        rows = json.loads((tmp_path / "winners" / "winners.json").read_text("utf-8"))
        assert sorted((row["seed"], row["recorded_m"]) for row in rows) == list(best_m.items())


def test_every_condition_is_a_change_of_the_physics():
    for name, changes in CONDITIONS.items():
        assert wave_robot().with_physics(**changes).physics != wave_robot().physics, name


def test_failed_robots_are_counted_separately(compare, tmp_path, monkeypatch):
    for seed in (0, 1):
        Cell("a", seed).folder(tmp_path).mkdir(parents=True)

    def simulate(bodies, timings, physics):
        assert physics.timestep_s == 0.005
        failure = np.array([Failure.TIPPED, Failure.NONE], dtype=np.int8)
        return Outcomes(failure, np.array([0.01, 0.27]), np.zeros(2), np.zeros(2))

    monkeypatch.setattr(winners, "simulate", simulate)
    share = pytest.approx(0.9)
    assert compare({0: 0.2, 1: 0.3}).comparisons == [
        Comparison("a", "5 ms", 2, 1, share, share, share, pytest.approx(0.27 / 2))
    ]


def test_robots_are_simulated_once(compare, tmp_path, monkeypatch):
    folder = Cell("a", 1).folder(tmp_path)
    folder.mkdir(parents=True)
    first = compare({1: 0.3})
    assert len(first.comparisons) == 1
    monkeypatch.delattr(winners, "simulate")
    folder.rmdir()  # results are kept without the run
    assert compare({1: 0.3}) == first
    assert compare({0: 0.0}) == ([], [], [])


def test_further_conditions_need_the_saved_robots_only(compare, tmp_path, monkeypatch):
    robots = [replace(robot, fitness_m=n / 10) for n, robot in enumerate(RandomRobots.robots)]
    monkeypatch.setattr(RandomRobots, "robots", robots)
    folder = Cell("a", 1).folder(tmp_path)
    folder.mkdir(parents=True)
    compare({1: 0.3})
    folder.rmdir()
    other = {"friction": 0.4}
    monkeypatch.setitem(winners.CONDITIONS, "friction 0.4", other)
    found = compare({1: 0.3})
    assert [row.condition for row in found.comparisons] == ["5 ms", "friction 0.4"]
    end = simulate([robots[3].morphology], robots[3].timings[None], replace(robots[3].physics, **other))
    if end.failure[0] == Failure.NONE:
        assert found.comparisons[1].median_share == pytest.approx(end.distance_m[0] / 0.3)
    else:
        assert found.comparisons[1].failed == 1


def test_robot_is_restored_from_the_table_of_evaluations(tmp_path, invented):
    data = tomllib.loads(Path(__file__).with_name("small.toml").read_text("utf-8"))
    config = StudyConfig.from_dict({**data, "seeds": [3], "arms": {"ga-uniform": {"prior": "uniform"}}})
    begin(config, tmp_path)
    cell, arm = config.cells()[0], config.arms["ga-uniform"]
    evolve(arm.run_config(3, config.budget_s), cell.folder(tmp_path), evaluator=invented)
    expected = load_run(cell.folder(tmp_path)).best_robot
    analysis = analyse(config, collect(config, tmp_path))
    shutil.rmtree(tmp_path / "cells")
    retest_winners(analysis, tmp_path)
    assert Robot.load(tmp_path / "winners" / "ga-uniform.json").to_dict() == expected.to_dict()
    assert not (tmp_path / "cells").exists()


def test_robot_comes_from_the_table_if_the_run_folder_is_older(tmp_path, invented):
    data = tomllib.loads(Path(__file__).with_name("small.toml").read_text("utf-8"))
    config = StudyConfig.from_dict({**data, "seeds": [3], "arms": {"ga-uniform": {"prior": "uniform"}}})
    begin(config, tmp_path)
    cell, arm = config.cells()[0], config.arms["ga-uniform"]
    run = arm.run_config(3, config.budget_s)
    expected = evolve(run, cell.folder(tmp_path), evaluator=invented).best_robot
    collect(config, tmp_path)
    shutil.rmtree(cell.folder(tmp_path))
    evolve(replace(run, budget_s=30.0), cell.folder(tmp_path), evaluator=invented)
    with Journal(cell.folder(tmp_path)) as journal:
        journal.begin((), run.to_dict())
    retest_winners(analyse(config, collect(config, tmp_path)), tmp_path)
    assert Robot.load(tmp_path / "winners" / "ga-uniform.json").to_dict() == expected.to_dict()


def test_saved_winner_of_an_arm_is_replaced_if_its_run_no_longer_counts(study, tmp_path):
    for seed in (0, 1):
        Cell("a", seed).folder(tmp_path).mkdir(parents=True)
    study({0: 0.2, 1: 0.3})
    study({0: 0.2})
    study({0: 0.2, 1: 0.3})
    assert (tmp_path / "winners" / "a.json").read_text() == "0.3"
    study({0: 0.2})
    assert (tmp_path / "winners" / "a.json").read_text() == "0.2"


# Damaged files


@pytest.fixture
def analysis():
    """The part of an analysis that these functions need first, for a study without runs."""
    config = StudyConfig.from_dict(SMALL)
    return SimpleNamespace(config=config, runs={})


END = {"distance_m": 0.1, "failure": "ok"}
ROW = {"arm": "a", "seed": 0, "recorded_m": 0.1, "references": {"0.25 ms": END}}
DAMAGED = [
    ROW | {"recorded_m": "far"}, ROW | {"references": {"0.25 ms": 3}}, ROW | {"gait": 3},
    ROW | {"gait": {"slip": "far"}},
    ROW | {"references": {"0.25 ms": END | {"distance_m": "far"}}},
]  # fmt: skip
TEXTS = [
    "{", "{}", "[1]", "3", "null", '"x"', '{"a": 1, "a": 2}', "[" * 50_000, "[{}]",
    *(json.dumps([row]) for row in DAMAGED),
]  # fmt: skip


@pytest.mark.parametrize("text", TEXTS, ids=range(len(TEXTS)))
def test_damaged_winners_are_refused(tmp_path, analysis, text):
    (tmp_path / "winners").mkdir()
    (tmp_path / "winners" / "winners.json").write_text(text)
    with pytest.raises(CaterpillarError, match=r"winners\.json.* (remove|not JSON)"):
        retest_winners(analysis, tmp_path)
