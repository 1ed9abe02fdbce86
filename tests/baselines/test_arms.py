"""Reinforcement learning as an arm of a study, beside the genetic algorithm."""

import json
import shutil
from dataclasses import replace

import polars
import pytest
from baselines.records import RECORD, evaluations

from baselines.arms import TrainArm
from evolution.study import winners
from evolution.study.arms import ArmError
from evolution.study.config import Cell, StudyConfig, StudyError, load, preset
from evolution.study.results import collect, versions

pytestmark = pytest.mark.slow

TOML = """
seeds = [0]
pilot_seeds = [8]
budget_s = 300
reference = "ga"
threshold_shares = [0.5]

[base]
prior = "uniform"
[base.ga]
population = 4
hall_of_fame = 1
[base.physics]
num_segments = 2
timestep_s = 0.01

[arms.ga]

[arms.ppo]
kind = "rl"
mode = "timing"
evaluations = 3
"""


@pytest.fixture(scope="module")
def finished(studied):
    """A study of both kinds of arms that was run to its end."""
    return studied(TOML)


def test_both_kinds_share_the_physics_and_the_budget(finished):
    config = load(finished)
    assert isinstance(config.arms["ppo"], TrainArm)
    assert config.arms["ppo"].config.physics == config.arms["ga"].config.physics
    frame, missing = collect(config, finished)
    assert not missing
    spent = frame.group_by("arm", "seed").agg(polars.col("simulated_s").sum())
    assert {"ga", "ppo"} == set(spent["arm"])
    ppo = spent.filter(polars.col("arm") == "ppo")["simulated_s"].item()
    assert 300 - 8 * 5 - 2 * 30 - 5 < ppo <= 300


def test_an_evaluation_carries_all_time_since_the_one_before(finished):
    config = load(finished)
    folder = Cell("ppo", 0).folder(finished)
    points, rows = evaluations(folder), config.arms["ppo"].evaluations(folder)
    assert rows["simulated_s"].cum_sum().to_list() == pytest.approx([p.simulated_s for p in points])
    assert rows["distance_m"].to_list() == [p.distance_m for p in points]


def test_report_tells_of_both(finished):
    page = (finished / "report.html").read_text()
    assert "Reinforcement learning, ppo timing (ppo)" in page
    assert (finished / "figures" / "best-so-far.png").exists()
    assert len(versions(load(finished), finished)) == 1


def test_robots_that_fail_are_nobodys_best(finished, tmp_path):
    config, run = load(finished), tmp_path / "cell"
    shutil.copytree(Cell("ppo", 0).folder(finished), run)
    table = polars.read_csv(run / "evaluations.csv")
    table.with_columns(failure=polars.lit("tipped"), distance_m=0.5).write_csv(run / "evaluations.csv")
    assert config.arms["ppo"].best(run, 300) is None


def test_record_that_cannot_be_read_is_not_taken_for_none(finished, tmp_path):
    arm, run = load(finished).arms["ppo"], tmp_path / "cell"
    shutil.copytree(Cell("ppo", 0).folder(finished), run)
    (run / RECORD).write_text("{}")
    with pytest.raises(ArmError, match=r"training\.json"):
        arm.run(run, 0, 300)
    assert (run / "best.zip").exists() or (run / "last.zip").exists()


def test_gait_period_that_policies_do_not_have_is_refused():
    with pytest.raises(ArmError, match="not for policies, whose gait period is 5 s"):
        TrainArm.shared({"gait_period_s": 4.0})


def test_best_robot_is_looked_at_again(finished, tmp_path):
    from baselines.policy import TrainedRobot

    robot = replace(TrainedRobot.load(Cell("ppo", 0).folder(finished)), fitness_m=0.01)
    seen = winners._look_again("ppo", 0, robot)
    assert seen.recorded_m == 0.01
    assert seen.reference_m != 0
    assert seen.friction_m[0] <= seen.friction_m[1]
    robot.save(tmp_path / "ppo.json")
    assert {p.suffix for p in tmp_path.iterdir()} == {".json", ".zip", ".pkl"}


def test_a_finished_cell_is_not_run_again_and_an_unfinished_one_is_done_anew(finished, tmp_path):
    config, cell = load(finished), Cell("ppo", 0)
    arm, run = config.arms["ppo"], tmp_path / "cell"
    shutil.copytree(cell.folder(finished), run)
    before = (run / "last.zip").stat().st_mtime_ns
    arm.run(run, 0, 300)
    assert (run / "last.zip").stat().st_mtime_ns == before
    record = json.loads((run / RECORD).read_text())
    (run / RECORD).write_text(json.dumps(record | {"finished": False}))
    assert not arm.is_finished(run, 0, 300)
    points = evaluations(run)
    arm.run(run, 0, 300)
    assert evaluations(run) == points
    assert (run / "last.zip").stat().st_mtime_ns > before


def test_a_cell_of_other_settings_or_hyperparameters_is_refused(finished, tmp_path):
    arm, run = load(finished).arms["ppo"], tmp_path / "cell"
    shutil.copytree(Cell("ppo", 0).folder(finished), run)
    with pytest.raises(ArmError, match="was run with other settings"):
        arm.is_finished(run, 1, 300)
    record = json.loads((run / RECORD).read_text())
    record["hyperparameters"]["n_envs"] = 99
    (run / RECORD).write_text(json.dumps(record))
    with pytest.raises(ArmError, match="was run with other settings"):
        arm.is_finished(run, 0, 300)


def test_standing_is_read_while_it_runs(finished, tmp_path):
    arm, folder = load(finished).arms["ppo"], Cell("ppo", 0).folder(finished)
    assert arm.standing(folder).simulated_s == evaluations(folder)[-1].simulated_s
    assert arm.standing(tmp_path) == (0.0, 0.0)
    assert not arm.is_finished(tmp_path, 0, 300)
    assert arm.versions(folder)[0]["torch"]
    assert arm.wall_s(folder) > 0


@pytest.mark.parametrize(
    ("arm", "message"),
    [
        ({"kind": "magic"}, "arms.x: kind = 'magic' must be one of evolution, rl"),
        ({"kind": "rl", "luck": 1}, "arms.x: a training has no luck"),
        ({"kind": "rl", "seed": 1}, "arms.x: seed is the study's to say"),
        ({"kind": "rl", "algorithm": "sac"}, "arms.x: sac cannot learn in mode 'switch'"),
    ],
    ids=str,
)
def test_unusable_arms_are_refused(arm, message):
    data = {
        "seeds": [0], "pilot_seeds": [1], "budget_s": 300, "reference": "x", "arms": {"x": arm},
    }  # fmt: skip
    with pytest.raises(StudyError) as caught:
        StudyConfig.from_dict(data)
    assert message in str(caught.value)


def test_preset_holds_every_row_of_the_comparison():
    arms = preset("rl-pilot").arms
    trainings = {name: arm.config for name, arm in arms.items() if isinstance(arm, TrainArm)}
    assert {c.algorithm for c in trainings.values()} == {"ppo", "a2c", "sac", "tqc", "ars"}
    assert {c.design for c in trainings.values()} == {"fixed", "uniform", "preprocessed"}
    assert trainings["ppo-bandit"] == replace(trainings["ppo-timing"], open_loop=True)
    assert {"ga-uniform", "ga-preprocessed", "cma-es-uniform"} <= set(arms)
