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
from evolution.config import RunConfig
from evolution.optimizers.ga import GaConfig
from evolution.run.evaluators import LocalEvaluator
from evolution.run.loop import evolve

pytestmark = pytest.mark.filterwarnings("ignore:unclosed file:ResourceWarning")

SMALL = ["--width", "128", "--height", "96", "--speed", "300"]


@pytest.fixture
def here(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def still(here):
    """A robot that is never powered, with a made-up record."""
    timings = GaitTimings(RunConfig().gait_period_s, np.zeros(2), np.zeros(2))
    robot = Robot(Morphology(), timings, Physics(num_segments=2), fitness_m=0.02)
    robot.save(here / "still.json")
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


def test_replay_tells_how_far_off_the_record_is(still, capsys):
    assert cli.main(["replay", "still.json", "--no-video"]) == 0
    said = capsys.readouterr().out
    assert said.startswith("fitness ")
    assert "0.0 J" in said
    assert "% of the recorded 0.02 m" in said


def test_replay_without_a_record_says_so(still, here, capsys):
    Robot(still.morphology, still.timings, still.physics).save(here / "still.json")
    assert cli.main(["replay", "still.json", "--no-video", "--json"]) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["recorded_fitness_m"] is None
    assert said["identical"] is False
    assert [p.name for p in here.iterdir()] == ["still.json"]


def test_replay_makes_a_video_beside_the_record(still, here, capsys):
    assert cli.main(["replay", "still.json", *SMALL]) == 0
    assert "writing replay.mp4" in capsys.readouterr().err
    assert sorted(p.name for p in here.iterdir()) == ["replay.mp4", "still.json"]


@pytest.mark.parametrize("camera", ["side", "top"])
def test_video_is_named_and_seen_as_asked(still, here, camera):
    assert cli.main(["replay", "still.json", *SMALL, "--camera", camera, "--out", f"{camera}.gif"]) == 0
    assert (here / f"{camera}.gif").read_bytes().startswith(b"GIF89a")


def test_machine_that_cannot_draw_still_compares(still, here, capsys, monkeypatch):
    monkeypatch.setattr(rendering, "unavailable", "no device")
    assert cli.main(["replay", "still.json", *SMALL]) == 0
    said = capsys.readouterr()
    assert "recorded 0.02 m" in said.out
    assert "no video: cannot draw (no device); install EGL" in said.err
    assert cli.main(["replay", "still.json", *SMALL, "--out", "asked.mp4"]) == 1
    said = capsys.readouterr()
    assert "recorded 0.02 m" in said.out
    assert "replay: error: cannot draw (no device)" in said.err
    assert [p.name for p in here.iterdir()] == ["still.json"]


# Several


@pytest.mark.slow
def test_several_robots_are_told_by_name_and_shown_in_one_video(still, run, here, capsys):
    assert cli.main(["replay", "still.json", str(run), *SMALL]) == 0
    said = capsys.readouterr()
    still_line, run_line = said.out.splitlines()
    assert still_line.startswith("still: fitness ")
    assert run_line.startswith("run: fitness ")
    assert run_line.endswith("identical to the record")
    assert sorted(p.name for p in here.iterdir()) == ["replay.mp4", "still.json"]


def test_robots_of_the_same_name_are_told_apart_by_their_paths(still, here, capsys):
    (here / "other").mkdir()
    still.save(here / "other" / "still.json")
    arguments = ["replay", "still.json", "other/still.json", "--no-video", "--json"]
    assert cli.main(arguments) == 0
    said = json.loads(capsys.readouterr().out)
    assert [one["title"] for one in said] == ["still.json", "other/still.json"]
    assert said[0]["fitness_m"] == said[1]["fitness_m"]


# Generations


def test_film_shows_the_best_of_generations_and_the_last_for_later_ones(run, capsys):
    assert cli.main(["replay", str(run), "--generations", "0", "2", "10", "50", *SMALL]) == 0
    said = capsys.readouterr()
    first, last = said.out.splitlines()
    assert first.startswith("generation 0: fitness ")
    assert last.startswith("generation 2: fitness ")
    assert "run is 2; showing it instead of later ones" in said.err
    (run / "film.mp4").unlink()


def test_last_generation_shows_the_best_of_the_run_which_one_bit_less_is_not(run, here, capsys):
    arguments = ["replay", str(run), "--generations", "2", "--no-video", "--json"]
    assert cli.main(arguments) == 0
    said = json.loads(capsys.readouterr().out)
    assert said["identical"] is True
    best = Robot.load(run)
    assert said["fitness_m"] == best.fitness_m
    near_m = float(np.nextafter(best.fitness_m, 1.0))
    replace(best, fitness_m=near_m).save(here / "near.json")
    assert cli.main(["replay", "near.json", "--no-video"]) == 0
    assert capsys.readouterr().out.rstrip().endswith(f"0.0 % of the recorded {near_m!r} m")


# Errors


@pytest.mark.parametrize(
    ("arguments", "hint"),
    [
        ([], "give one or more run folders"),
        (["still.json", "--out", "robot.avi"], "must be an .mp4 or a .gif file; got robot.avi"),
        (["still.json", "--out", "a.mp4", "--no-video"], "which --no-video excludes"),
        (["still.json", "--speed", "0"], "speed = 0.0 must be a positive number"),
        (["still.json", "--width", "99"], "width = 99 must be an even number"),
        (["still.json", "--camera", "front"], "--camera"),
        (["still.json", "still.json", "--width", "64"], "2 robots in 64 x 360 pixels"),
        (["still.json", "--generations", "0"], "is not a run folder"),
        (["still.json", "still.json", "--generations", "0"], "--generations takes one run folder"),
        (["still.json", "--generations", "0", "-1"], "generations"),
        (["still.json", "--out", "nowhere/robot.mp4"], "cannot write nowhere/robot.mp4"),
    ],
)
def test_errors_name_what_was_wrong(arguments, hint, still, here, capsys):
    try:
        status = cli.main(["replay", *arguments])
    except SystemExit as stop:
        status = stop.code
    said = capsys.readouterr().err
    assert status in (1, 2)
    assert hint in said
    assert "Traceback" not in said
    assert [p.name for p in here.iterdir()] == ["still.json"]
