"""`caterpillar rl`, as somebody at a terminal has it."""

import json
import sys

import pytest

from baselines.policy import TrainedRobot
from baselines.records import Record, evaluations
from evolution import cli

SMALL = ["--num-segments", "2", "--timestep-s", "0.01", "--mode", "timing", "--evaluations", "2"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    path = tmp_path_factory.mktemp("cli") / "run"
    flags = [*SMALL, "--budget-s", "200", "--no-video", "--out", str(path)]
    assert cli.main(["rl", "train", *flags]) == 0
    return path


@pytest.mark.slow
def test_training_tells_how_it_goes(tmp_path, capsys):
    flags = [*SMALL, "--budget-s", "150", "--track", "tensorboard", "--out", str(tmp_path / "run")]
    assert cli.main(["rl", "train", *flags]) == 0
    said = capsys.readouterr()
    assert said.out.startswith(("best: ", "no policy"))
    assert "left" in said.err
    assert "deterministic policy" in said.err
    assert (tmp_path / "run" / "best.mp4").stat().st_size > 10_000
    assert (tmp_path / "run" / "tensorboard").is_dir()


def test_body_of_an_evolved_robot_is_taken(tmp_path, capsys):
    run = tmp_path / "ga"
    small = ["--num-segments", "2", "--timestep-s", "0.01"]
    flags = ["--population", "3", "--hall-of-fame", "1", "--generations", "1", "--no-video"]
    assert cli.main(["evolve", *small, *flags, "--out", str(run)]) == 0
    body = json.loads((run / "best.json").read_text())["morphology"]
    flags = [*SMALL, "--budget-s", "150", "--no-video", "--out", str(tmp_path / "rl")]
    assert cli.main(["rl", "train", *flags, "--body", str(run)]) == 0
    assert Record.load(tmp_path / "rl").config.morphology.to_dict() == body
    assert evaluations(tmp_path / "rl")[0].morphology.to_dict() == body


def test_best_policy_crawls_again(folder, capsys):
    assert cli.main(["rl", "eval", str(folder)]) == 0
    robot = TrainedRobot.load(folder)
    assert f"{1000 * robot.fitness_m:.1f} mm" in capsys.readouterr().out
    assert cli.main(["rl", "eval", str(folder), "--timestep-s", "0.005", "--json"]) == 0
    (finer,) = json.loads(capsys.readouterr().out)
    assert finer["distance_m"] == robot.simulate(0.005).distance_m[0] != robot.fitness_m


def test_other_ground_and_other_robots_are_tried(folder, capsys):
    flags = ["--frictions", "0.4", "1.0", "--mismatch-seeds", "5", "6", "7", "--json"]
    assert cli.main(["rl", "eval", str(folder), *flags]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert [(r["friction"], r["mismatch_seed"]) for r in rows] == [
        (f, s) for f in (0.4, 1.0) for s in (5, 6, 7)
    ]
    assert len({r["distance_m"] for r in rows}) == 6


def test_random_and_drawn_actions_differ_from_episode_to_episode(folder, capsys):
    for flags in (["--which", "random"], ["--which", "last", "--stochastic"]):
        assert cli.main(["rl", "eval", str(folder), *flags, "--episodes", "3"]) == 0
        *rows, summary = capsys.readouterr().out.splitlines()
        assert len({row.split(" mm")[0] for row in rows}) > 1  # in tenths of a millimetre
        assert summary.startswith("median ")


def test_trainings_are_compared(folder, tmp_path, capsys):
    flags = ["--out", str(tmp_path / "x.png")]
    assert cli.main(["rl", "compare", str(folder), *flags]) == 0
    assert "ppo timing" in capsys.readouterr().out
    assert cli.main(["rl", "compare", str(folder), *flags, "--json"]) == 0
    (row,) = json.loads(capsys.readouterr().out)
    assert row["runs"] == 1
    assert (tmp_path / "x.png").exists()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ([], "a command is missing; choose from train, eval, compare"),
        (["teach"], "no command 'teach'; choose from train, eval, compare"),
        (["eval", "nowhere"], "cannot read nowhere/training.json"),
        (["compare"], "give the folders of trainings"),
        (["compare", "nowhere"], "cannot read nowhere/training.json"),
        (["train", "--body", "nowhere"], "cannot read nowhere"),
    ],
    ids=str,
)
def test_wrong_input_is_answered_in_one_line(arguments, message, capsys):
    assert cli.main(["rl", *arguments]) in (1, 2)
    err = capsys.readouterr().err
    assert message in err
    assert err.count("\n") == 1


def test_unusable_flags_are_wrong_usage(capsys):
    assert cli.main(["rl", "train", "--randomize", "luck", "0", "1"]) == 2
    assert "randomization has no luck; its fields are friction" in capsys.readouterr().err


def test_likeliest_actions_are_not_repeated(folder, capsys):
    assert cli.main(["rl", "eval", str(folder), "--episodes", "2"]) == 2
    assert "add --stochastic" in capsys.readouterr().err


def test_help_names_the_commands(capsys):
    assert cli.main(["rl", "--help"]) == 0
    assert "compare  put trainings side by side" in capsys.readouterr().out


def test_without_the_extra_it_says_what_to_install(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "sb3_contrib", None)
    assert cli.main(["rl", "train"]) == 1
    assert "pip install 'caterpillar-sma[rl]'" in capsys.readouterr().err
