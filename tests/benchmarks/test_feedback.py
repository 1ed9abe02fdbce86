import json
from dataclasses import replace

import numpy as np
import pytest

from baselines.config import TrainConfig
from baselines.policy import Policy, TrainedRobot
from baselines.training import train
from benchmarks import feedback
from caterpillar_env.errors import CaterpillarError
from caterpillar_env.physics import Physics
from caterpillar_env.robot import Outcomes
from caterpillar_env.task import Failure
from caterpillar_env.worlds import World


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """Training runs that end before the first update, with feedback (two seeds) and without."""
    home = tmp_path_factory.mktemp("feedback")
    for name, fields in {"a": {}, "b": {"seed": 1}, "c": {"open_loop": True}}.items():
        physics = Physics(num_segments=3, timestep_s=0.01)
        train(
            TrainConfig(budget_s=600.0 if "open_loop" in fields else 150.0, physics=physics, **fields),
            home / name,
        )
    return [home / name for name in "abc"]


def test_conditions_are_all_combinations():
    conditions = feedback.make_conditions((0.5, 1.0), (7,), ("flat", "slope:angle_deg=5"))
    assert len(conditions) == 4
    assert conditions[-1] == {
        "friction": 1.0, "mismatch_seed": 7, "world": World.of("slope:angle_deg=5")
    }  # fmt: skip


@pytest.mark.slow
def test_policies_are_compared_by_their_mean_over_the_conditions(folders, capsys):
    conditions = feedback.make_conditions((0.5, 1.0), (7,), ("flat", "slope:angle_deg=5"))
    feedback.compare_policies(folders, conditions)
    wave, closed, bandit = json.loads(capsys.readouterr().out)["rows"]
    assert (wave["policy"], wave["runs"]) == ("hand-made wave", 1)
    assert wave["nominal"]["median"] == pytest.approx(177, abs=1)
    assert (closed["policy"], closed["runs"]) == ("ppo phase", 2)
    assert (bandit["policy"], bandit["runs"]) == ("ppo phase bandit", 1)
    robot = TrainedRobot.load(folders[2])
    assert bandit["nominal"]["median"] == pytest.approx(1000 * robot.fitness_m)
    expected_mm = [
        1000 * replace(robot, physics=replace(robot.physics, **fields)).simulate().fitness()[0]
        for fields in conditions
    ]
    assert bandit["unseen"]["median"] == pytest.approx(np.mean(expected_mm))
    assert bandit["flat"]["median"] == pytest.approx(np.mean(expected_mm[:2]))
    assert bandit["slope:angle_deg=5"]["median"] == pytest.approx(np.mean(expected_mm[2:]))
    assert bandit["worst"] == pytest.approx(min(expected_mm))
    assert closed["A12"]["value"] == 0.5


def test_a_published_policy_is_that_of_its_training_run(folders, tmp_path):
    TrainedRobot.load(folders[0]).save(tmp_path / "seed-0.json")
    (config, robot), (published, again) = (
        feedback._load(p) for p in (folders[0], tmp_path / "seed-0.json")
    )
    assert published == config
    assert again.digest == robot.digest


def test_run_without_a_best_policy_counts_as_0(tmp_path, capsys, monkeypatch):
    tipped = Outcomes(*(np.array([value]) for value in (Failure.TIPPED, 0.5, 1.0, 30.0)))
    monkeypatch.setattr(Policy, "crawl", lambda *_args, **_more: tipped)
    physics = Physics(num_segments=2, timestep_s=0.01)
    train(TrainConfig(budget_s=150.0, physics=physics), tmp_path / "run")
    feedback.compare_policies([tmp_path / "run"], [{}, {}])
    _, row = json.loads(capsys.readouterr().out)["rows"]
    assert row["nominal"]["median"] == row["unseen"]["median"] == 0.0
    assert row["failures, %"] == 100.0


def test_folder_of_an_evolutionary_run_is_rejected(tmp_path):
    with pytest.raises(CaterpillarError, match="not a run folder"):
        feedback.compare_policies([tmp_path], [{}])
