import json
from dataclasses import replace

import numpy as np
import pytest

from caterpillar_env.drawing import rendering
from caterpillar_env.gait import GaitTimings
from caterpillar_env.morphology import Morphology
from caterpillar_env.physics import Physics
from caterpillar_env.robot import Robot
from evolution import cli
from evolution.cli import replay
from evolution.config import RunConfig
from evolution.optimizers.ga import GaConfig
from evolution.run.evaluators import LocalEvaluator
from evolution.run.loop import evolve

pytestmark = pytest.mark.filterwarnings("ignore:unclosed file:ResourceWarning")

SMALL = ["--width", "128", "--height", "96", "--speed", "300"]


@pytest.fixture
def still(elsewhere):
    """A robot that is never powered, with a made-up record."""
    timings = GaitTimings(RunConfig().gait_period_s, np.zeros(2), np.zeros(2))
    physics = Physics(num_segments=2, timestep_s=0.01)
    robot = Robot(Morphology(), timings, physics, fitness_m=0.02)
    robot.save(elsewhere / "still.json")
    return robot


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A run of three generations."""
    folder = tmp_path_factory.mktemp("replay") / "run"
    config = RunConfig(
        seed=4, generations=3, physics=Physics(num_segments=2, timestep_s=0.01),
        ga=GaConfig(population=3, hall_of_fame=1),
    )  # fmt: skip
    evolve(config, folder, evaluator=LocalEvaluator(1))
    return folder


# One robot


def test_replay_prints_the_difference_from_the_record(still, capsys):
    assert cli.main(["replay", "still.json", "--no-video"]) == 0
    captured = capsys.readouterr().out
    assert captured.startswith("fitness ")
    assert "0.0 J" in captured
    assert "% relative to the recorded 0.02 m" in captured


def test_replay_without_a_recorded_fitness_makes_no_comparison(still, elsewhere, capsys):
    Robot(still.morphology, still.timings, still.physics).save(elsewhere / "still.json")
    assert cli.main(["replay", "still.json", "--no-video", "--json"]) == 0
    captured = json.loads(capsys.readouterr().out)
    assert captured["recorded_fitness_m"] is None
    assert captured["identical"] is False
    assert [p.name for p in elsewhere.iterdir()] == ["still.json"]


def test_replay_writes_a_video_beside_the_record(still, elsewhere, capsys):
    assert cli.main(["replay", "still.json", *SMALL]) == 0
    assert "writing replay.mp4" in capsys.readouterr().err
    assert sorted(p.name for p in elsewhere.iterdir()) == ["replay.mp4", "still.json"]


@pytest.mark.parametrize("camera", ["side", "top"])
def test_video_uses_the_given_file_and_camera(still, elsewhere, camera):
    assert cli.main(["replay", "still.json", *SMALL, "--camera", camera, "--out", f"{camera}.gif"]) == 0
    assert (elsewhere / f"{camera}.gif").read_bytes().startswith(b"GIF89a")


def test_replay_compares_on_a_machine_that_cannot_draw(still, elsewhere, capsys, monkeypatch):
    monkeypatch.setattr(rendering, "unavailable", "no device")
    assert cli.main(["replay", "still.json", *SMALL]) == 0
    captured = capsys.readouterr()
    assert "recorded 0.02 m" in captured.out
    assert "no video: cannot draw (no device); install EGL" in captured.err
    assert cli.main(["replay", "still.json", *SMALL, "--out", "asked.mp4"]) == 1
    captured = capsys.readouterr()
    assert "recorded 0.02 m" in captured.out
    assert "replay: error: cannot draw (no device)" in captured.err
    assert [p.name for p in elsewhere.iterdir()] == ["still.json"]


# Several robots


@pytest.mark.slow
def test_several_robots_are_listed_by_name_and_shown_in_one_video(still, run, elsewhere, capsys):
    assert cli.main(["replay", "still.json", str(run), *SMALL]) == 0
    captured = capsys.readouterr()
    still_line, run_line = captured.out.splitlines()
    assert still_line.startswith("still: fitness ")
    assert run_line.startswith("run: fitness ")
    assert run_line.endswith("identical to the record")
    assert sorted(p.name for p in elsewhere.iterdir()) == ["replay.mp4", "still.json"]


def test_robots_with_the_same_name_are_titled_by_their_paths(still, elsewhere, capsys):
    (elsewhere / "other").mkdir()
    still.save(elsewhere / "other" / "still.json")
    arguments = ["replay", "still.json", "other/still.json", "--no-video", "--json"]
    assert cli.main(arguments) == 0
    captured = json.loads(capsys.readouterr().out)
    assert [one["title"] for one in captured] == ["still.json", "other/still.json"]
    assert captured[0]["fitness_m"] == captured[1]["fitness_m"]


# Generations


def test_film_shows_the_last_generation_instead_of_later_ones(run, capsys):
    assert cli.main(["replay", str(run), "--generations", "0", "2", "10", "50", *SMALL]) == 0
    first, last = capsys.readouterr().out.splitlines()
    assert first.startswith("generation 0: fitness ")
    assert last.startswith("generation 2: fitness ")
    (run / "film.mp4").unlink()


def test_last_generation_shows_the_best_robot_of_the_run(run, elsewhere, capsys):
    arguments = ["replay", str(run), "--generations", "2", "--no-video", "--json"]
    assert cli.main(arguments) == 0
    captured = json.loads(capsys.readouterr().out)
    assert captured["identical"] is True
    best = Robot.load(run)
    assert captured["fitness_m"] == best.fitness_m
    near_m = float(np.nextafter(best.fitness_m, 1.0))
    replace(best, fitness_m=near_m).save(elsewhere / "near.json")
    assert cli.main(["replay", "near.json", "--no-video"]) == 0
    assert capsys.readouterr().out.rstrip().endswith(f"0.0 % relative to the recorded {near_m!r} m")


# Errors


@pytest.mark.parametrize(
    ("arguments", "hint"),
    [
        ([], "give one or more run folders"),
        (["still.json", "--out", "robot.avi"], "must be an .mp4, a .gif or a .webp file; got robot.avi"),
        (["still.json", "--speed", "0"], "speed = 0.0 must be a finite number from 0.01 to 1000"),
        (["still.json", "--camera", "front"], "--camera"),
        (["still.json", "--width", "10000"], "width = 10000 must be an integer from 1 to 8192"),
        (["still.json", "still.json", "--width", "1"], "width = 1 must be at least 4 for 2 robots"),
        (["still.json", "--generations", "0"], "is not a run folder"),
        (["still.json", "still.json", "--generations", "0"], "--generations needs one run folder"),
        (["still.json", "--generations", "0", "-1"], "generations"),
        (["still.json", "--out", "nowhere/robot.mp4"], "cannot write nowhere/robot.mp4"),
    ],
)
def test_errors_name_the_wrong_input(arguments, hint, still, elsewhere, capsys):
    try:
        status = cli.main(["replay", *arguments])
    except SystemExit as stop:
        status = stop.code
    captured = capsys.readouterr().err
    assert status in (1, 2)
    assert hint in captured
    assert "Traceback" not in captured
    assert [p.name for p in elsewhere.iterdir()] == ["still.json"]


@pytest.mark.parametrize(
    ("fitness_m", "recorded_m", "verdict"),
    [
        (0.0, 0.0, "identical to the record"),
        (0.1, 0.0, "different from the recorded 0.0 m"),
        (0.1, None, "no recorded fitness to compare with"),
        (0.11, 0.1, "+10.0 % relative to the recorded 0.1 m"),
    ],
)
def test_verdict_names_the_record(fitness_m, recorded_m, verdict):
    ends = {"failure": "ok", "energy_j": 1.0, "identical": fitness_m == recorded_m}
    comparison = {"fitness_m": fitness_m, "recorded_fitness_m": recorded_m, **ends}
    assert replay._describe(comparison).endswith(verdict)
