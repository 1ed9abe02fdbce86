"""Reinforcement learning as an arm of a study, next to a genetic algorithm."""

import shutil
from dataclasses import replace
from typing import get_args

import polars
import pytest

from baselines.arms import TrainArm
from baselines.config import AlgorithmName, Design, TrainConfig, make_configuration
from baselines.policy import TrainedRobot
from baselines.training import train
from caterpillar_env.arguments import ActionMode
from caterpillar_env.errors import CaterpillarError
from evolution.run.evaluators import LocalEvaluator
from evolution.run.history import History
from evolution.run.journal import Journal
from evolution.study import winners
from evolution.study.analysis import analyse
from evolution.study.config import Cell, StudyConfig, load, preset
from evolution.study.results import collect
from evolution.study.winners import retest_winners

TOML = """
seeds = [0]
budget_s = 300
reference = "ga"
generations = [3]

[base]
prior = "uniform"
[base.ga]
population = 4
hall_of_fame = 1
[base.physics]
num_segments = 3
timestep_s = 0.01

[arms.ga]

[arms.ppo]
kind = "rl"
mode = "timing"
evaluations = 3
[arms.ppo.physics]
friction = 1.2
"""


@pytest.fixture(scope="module")
def finished(studied):
    """A finished study with an arm of each kind."""
    return studied(TOML)


@pytest.mark.slow
def test_study_records_both_kinds_within_the_budget(finished):
    config = load(finished)
    results = collect(config, finished)
    assert not results.missing
    spent = results.table.group_by("arm", "seed").agg(polars.col("simulated_s").sum())
    assert set(spent["arm"]) == {"ga", "ppo"}
    ppo_s = spent.filter(polars.col("arm") == "ppo")["simulated_s"].item()
    assert 300 - 16 * 5 - 2 * 30 - 5 < ppo_s <= 300


@pytest.mark.slow
def test_report_describes_both_arms(finished):
    page = (finished / "report.html").read_text()
    for arm in ("ga", "ppo"):
        assert f"<td>{arm}<td>" in page


@pytest.mark.slow
def test_run_resumes_an_interrupted_training(finished, tmp_path):
    arm, run = load(finished).arms["ppo"], tmp_path / "cell"

    def stop(history):
        raise KeyboardInterrupt

    train(replace(arm.config, budget_s=300), run, on_evaluation=stop)
    assert not History.read(run).finished
    assert arm.run(run, 0, 300, LocalEvaluator(1))
    again, whole = History.read(run), History.read(Cell("ppo", 0).folder(finished))
    assert again.finished
    assert [e[3:7] for e in again.evaluations] == [e[3:7] for e in whole.evaluations]
    assert len(again.sessions) == 2


def test_training_matches_its_settings_and_hyperparameters_only(tmp_path):
    arm = TrainArm(TrainConfig(mode="timing"))
    with Journal.create(tmp_path, make_configuration(arm._configure(0, 300))) as journal:
        history = History(journal)
        assert arm.matches(history, 0, 300)
        assert not arm.matches(history, 1, 300)
        assert not arm.matches(history, 0, 600)
        assert not TrainArm(TrainConfig()).matches(history, 0, 300)
        history.configuration["hyperparameters"]["n_envs"] = 99
        assert not arm.matches(history, 0, 300)


@pytest.mark.slow
def test_best_robot_is_that_of_the_best_evaluation(finished, tmp_path):
    folder = Cell("ppo", 0).folder(finished)
    best = History.read(folder).best
    robot = load(finished).arms["ppo"].robot(folder, best.number)
    assert robot.fitness_m == best.distance_m
    assert robot.simulate().distance_m[0] == best.distance_m
    robot.save(tmp_path / "ppo.json")
    assert {p.suffix for p in tmp_path.iterdir()} == {".json", ".npz"}
    assert load(finished).arms["ppo"].load(tmp_path / "ppo.json").simulate() == robot.simulate()


@pytest.mark.slow
def test_policies_are_retested_even_without_their_training_runs(finished, tmp_path, monkeypatch):
    study = tmp_path / "study"
    shutil.copytree(finished, study)
    monkeypatch.setattr(winners, "CONDITIONS", {"slippery": {"friction": 0.3}})
    expected = TrainedRobot.load(Cell("ppo", 0).folder(study)).with_physics(friction=0.3).simulate()
    analysis = analyse(load(study), collect(load(study), study))
    found = retest_winners(analysis, study, every_run=True)
    (row,) = [row for row in found.comparisons if row.arm == "ppo"]
    recorded_m = analysis.runs["ppo"][0].best_m[-1]
    assert (row.robots, row.failed) == (1, 0)
    assert row.median_share == expected.distance_m[0] / recorded_m
    assert "ppo" not in {row.arm for row in found.crawling}
    shutil.rmtree(study / "cells")
    monkeypatch.setitem(winners.CONDITIONS, "rough", {"friction": 1.0})
    again = retest_winners(analysis, study, every_run=True)
    assert [row.condition for row in again.comparisons if row.arm == "ppo"] == ["slippery", "rough"]


def test_arm_takes_the_physics_of_the_base():
    arm = TrainArm.from_dict(
        {"mode": "timing", "physics": {"friction": 1.0}},
        {"prior": "uniform", "physics": {"num_segments": 2}},
    )
    assert (arm.config.physics.num_segments, arm.config.physics.friction) == (2, 1.0)
    assert arm == TrainArm(TrainConfig(mode="timing", physics=arm.config.physics))


def test_other_gait_period_is_rejected():
    with pytest.raises(CaterpillarError, match="whose gait period is 5 s"):
        TrainArm.from_dict({}, {"gait_period_s": 4.0})


@pytest.mark.parametrize(
    ("arm", "message"),
    [
        ({"kind": "magic"}, "arms.x: kind = 'magic' must be one of evolution, rl"),
        ({"kind": "rl", "luck": 1}, "arms.x: a training run has no luck"),
        ({"kind": "rl", "seed": 1}, "seed"),
        (
            {"kind": "rl", "algorithm": "td3", "mode": "switch"},
            "arms.x: td3 does not support mode 'switch'",
        ),
    ],
    ids=str,
)
def test_invalid_arm_is_rejected(arm, message):
    data = {
        "seeds": [0], "budget_s": 300, "reference": "x", "arms": {"x": arm},
    }  # fmt: skip
    with pytest.raises(CaterpillarError) as caught:
        StudyConfig.from_dict(data)
    assert message in str(caught.value)


def trainings(name):
    arms = preset(name).arms
    return {name: arm.config for name, arm in arms.items() if isinstance(arm, TrainArm)}


def test_ablation_covers_all_algorithms_modes_and_designs():
    arms = trainings("rl-ablation")
    for field, kind in (("algorithm", AlgorithmName), ("mode", ActionMode), ("design", Design)):
        assert {getattr(config, field) for config in arms.values()} == set(get_args(kind))
    for name in ("ppo", "td3", "ppo-switch"):
        assert arms[f"{name}-uniform"] == replace(arms[name], prior="uniform")


def test_arms_of_the_ablation_differ_from_their_reference_in_one_choice():
    config, arms = preset("rl-ablation"), trainings("rl-ablation")
    defaults = TrainConfig().to_dict()
    for name, arm in arms.items():
        settings, reference = arm.to_dict(), arms[config.reference_of(name)].to_dict()
        changed = {field for field in defaults if settings[field] != reference[field]}
        assert len(changed) == (name != "ppo") + (name == "ppo-codesign-uniform")


def test_both_presets_train_the_same_learners():
    ablation, arms = trainings("rl-ablation"), trainings("rl")
    for name in ("ppo", "td3", "td3-timing", "ppo-switch", "ppo-codesign"):
        assert arms[name] == ablation[name]
    assert arms["ppo-bandit"] == replace(arms["ppo"], open_loop=True)
    assert arms["ppo-bandit-randomized"] == replace(arms["ppo-randomized"], open_loop=True)
    assert {"shade", "ga-uniform", "ga-body", "random"} == set(preset("rl").arms) - set(arms)
