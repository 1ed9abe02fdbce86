"""`caterpillar rl` on the command line."""

import json
import sys
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest

from baselines.config import Training
from baselines.policy import TrainedRobot
from caterpillar_env.drawing import video
from caterpillar_env.drawing.video import VideoConfig
from caterpillar_env.robot import Outcomes
from caterpillar_env.task import Failure
from evolution import cli
from evolution.run.history import History

SMALL = ["--num-segments", "2", "--timestep-s", "0.01", "--mode", "timing", "--evaluations", "2"]
#: A training run whose best policy crawls forwards.
FORWARDS = ["--timestep-s", "0.01", "--mode", "timing", "--seed", "1", "--budget-s", "200"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("cli") / "run"
    flags = [*FORWARDS, "--evaluations", "2", "--no-video", "--out", str(path)]
    assert cli.main(["rl", "train", *flags]) == 0
    return path


def test_train_reports_a_budget_that_ends_before_the_first_update(tmp_path, capsys):
    flags = [*SMALL, "--budget-s", "150", "--no-video", "--out", str(tmp_path / "run")]
    assert cli.main(["rl", "train", *flags]) == 0
    assert "all evaluations have the same distance: with a larger --budget-s" in capsys.readouterr().err


@pytest.mark.slow
def test_train_reports_progress_and_writes_a_video(tmp_path, capsys, monkeypatch):
    small = VideoConfig(60.0, 160, 120)
    monkeypatch.setattr(video, "write_video", partial(video.write_video, config=small))
    flags = [*FORWARDS, "--out", str(tmp_path / "run")]
    assert cli.main(["rl", "train", *flags]) == 0
    captured = capsys.readouterr()
    assert captured.out.startswith("best: ")
    assert "left" in captured.err
    assert "deterministic policy" in captured.err
    assert video.is_video_of(tmp_path / "run" / "best.mp4", TrainedRobot.load(tmp_path / "run"))


def test_train_uses_the_body_of_an_evolved_robot(tmp_path, capsys):
    run = tmp_path / "ga"
    small = ["--num-segments", "2", "--timestep-s", "0.01"]
    flags = ["--population", "3", "--hall-of-fame", "1", "--generations", "1", "--no-video"]
    assert cli.main(["evolve", *small, *flags, "--out", str(run)]) == 0
    body = json.loads((run / "best.json").read_text())["morphology"]
    flags = [*SMALL, "--friction", "0.5", "--budget-s", "150", "--no-video"]
    flags += ["--out", str(tmp_path / "rl")]
    assert cli.main(["rl", "train", *flags, "--body", str(run)]) == 0
    assert "was evolved with friction = 0.8; training uses 0.5" in capsys.readouterr().err
    training = Training.read(tmp_path / "rl")
    assert training.config.morphology.to_dict() == body
    assert training.body(training.history.evaluations[0]).to_dict() == body


def test_eval_repeats_the_recorded_evaluation(folder, capsys):
    assert cli.main(["rl", "eval", str(folder)]) == 0
    robot = TrainedRobot.load(folder)
    assert f"{1000 * robot.fitness_m:.1f} mm" in capsys.readouterr().out
    assert cli.main(["rl", "eval", str(folder), "--timestep-s", "0.005", "--json"]) == 0
    (finer,) = json.loads(capsys.readouterr().out)
    ends = robot.with_physics(timestep_s=0.005).simulate()
    assert finer["distance_m"] == ends.distance_m[0] != robot.fitness_m


def test_eval_takes_the_json_file_of_a_robot(folder, tmp_path, capsys):
    robot = TrainedRobot.load(folder)
    robot.save(tmp_path / "robot.json")
    assert cli.main(["rl", "eval", str(tmp_path / "robot.json")]) == 0
    assert f"{1000 * robot.fitness_m:.1f} mm" in capsys.readouterr().out
    assert cli.main(["rl", "eval", str(tmp_path / "robot.json"), "--which", "last"]) == 1
    assert "has only one policy; for the last policy, give the folder" in capsys.readouterr().err
    assert cli.main(["rl", "eval", str(tmp_path / "typo.json")]) == 1
    assert "give the folder of a training run, or the JSON file" in capsys.readouterr().err


def test_eval_combines_frictions_and_mismatch_seeds(folder, capsys):
    flags = ["--frictions", "0.4", "1.0", "--mismatch-seeds", "5", "6", "7", "--json"]
    assert cli.main(["rl", "eval", str(folder), *flags]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert [(r["friction"], r["mismatch_seed"]) for r in rows] == [
        (f, s) for f in (0.4, 1.0) for s in (5, 6, 7)
    ]
    assert len({r["distance_m"] for r in rows}) == 6


def test_failures_count_as_0_in_the_median(folder, capsys, monkeypatch):
    ends = iter([(0.02, Failure.NONE), (0.9, Failure.TIPPED), (0.04, Failure.NONE)])

    def simulate(robot):
        distance_m, failure = next(ends)
        return Outcomes(np.array([failure]), np.array([distance_m]), np.ones(1), np.full(1, 30.0))

    monkeypatch.setattr(TrainedRobot, "simulate", simulate)
    assert cli.main(["rl", "eval", str(folder), "--frictions", "0.6", "0.8", "1.0"]) == 0
    summary = capsys.readouterr().out.splitlines()[-1]
    assert summary == "median 20.0 mm, quartiles 10.0 to 30.0 (failures count as 0)"


def test_train_estimates_the_time_left(tmp_path, capsys, monkeypatch):
    now_s = [0.0]

    def train(config, folder, *, on_evaluation, on_progress, **others):
        on_progress(1.0)
        now_s[0] = 250.0
        on_progress(config.budget_s / 4)
        spent_s = config.budget_s / 4
        evaluation = SimpleNamespace(distance_m=0.01, failure=Failure.NONE, simulated_s=spent_s)
        history = SimpleNamespace(
            evaluations=[evaluation], best=None, simulated_s=spent_s, finished=True, folder=folder
        )
        on_evaluation(history)
        return SimpleNamespace(history=history)

    monkeypatch.setattr("baselines.cli.train.train", train)
    make_bar = cli.bar

    def make_timed_bar(console):
        bar = make_bar(console)
        bar.get_time = lambda: now_s[0]
        return bar

    monkeypatch.setattr(cli, "bar", make_timed_bar)
    assert cli.main(["rl", "train", "--out", str(tmp_path / "run")]) == 0
    assert capsys.readouterr().err.startswith(" 25 %, 13 min left  simulated 7,500 s")


def test_stopped_training_is_listed_and_resumed(tmp_path, capsys, monkeypatch):
    folder, original = tmp_path / "a run", History.complete
    flags = [*FORWARDS, "--evaluations", "2", "--no-video", "--out", str(folder)]

    def stop(history, **kwargs):
        original(history, **kwargs)
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(History, "complete", stop)
        assert cli.main(["rl", "train", *flags]) == 130
    assert f"continue with: caterpillar rl resume '{folder}'" in capsys.readouterr().err
    assert cli.main(["runs", str(tmp_path), "--json"]) == 0
    (row,) = json.loads(capsys.readouterr().out)
    assert (row["state"], row["optimizer"], row["prior"]) == ("stopped", "ppo timing", "gait")
    assert cli.main(["rl", "resume", str(folder), "--no-video"]) == 0
    assert capsys.readouterr().out.startswith("best: ")
    assert Training.read(folder).history.finished
    assert cli.main(["rl", "resume", str(folder), "--no-video"]) == 0
    assert "already finished" in capsys.readouterr().err


def test_train_without_a_best_policy_writes_no_video(tmp_path, capsys):
    flags = [*SMALL, "--budget-s", "150", "--out", str(tmp_path / "run")]
    assert cli.main(["rl", "train", *flags]) == 0
    assert capsys.readouterr().out.startswith("no policy crawled forwards")
    assert not (tmp_path / "run" / "best.mp4").exists()
    assert cli.main(["rl", "eval", str(tmp_path / "run")]) == 1
    assert "--which last" in capsys.readouterr().err


def test_compare_prints_a_table(folder, capsys):
    assert cli.main(["rl", "compare", str(folder)]) == 0
    assert "ppo timing" in capsys.readouterr().out
    assert cli.main(["rl", "compare", str(folder), "--json"]) == 0
    (row,) = json.loads(capsys.readouterr().out)
    assert row["runs"] == 1


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "choose from train, resume, eval, compare"),
        (["teach"], "'teach'; choose from train, resume, eval, compare"),
        (["resume", "nowhere"], "nowhere is not a run folder"),
        (["eval", "nowhere"], "nowhere is not a run folder"),
        (["compare"], "give at least one folder"),
        (["compare", "nowhere"], "nowhere is not a run folder"),
        (["train", "--body", "nowhere"], "cannot read nowhere"),
        (["train", "--randomize", "luck", "0", "1"], "its fields are friction"),
    ],
    ids=str,
)
def test_errors_are_one_line(arguments, message, capsys):
    assert cli.main(["rl", *arguments]) in (1, 2)
    err = capsys.readouterr().err
    assert message in err
    assert err.count("\n") == 1


def test_help_lists_the_commands(capsys):
    assert cli.main(["rl", "--help"]) == 0
    assert "compare  Compare training runs" in capsys.readouterr().out


def test_missing_extra_is_reported(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "stable_baselines3", None)
    assert cli.main(["rl", "train"]) == 1
    assert "pip install 'caterpillar-sma[rl]'" in capsys.readouterr().err
