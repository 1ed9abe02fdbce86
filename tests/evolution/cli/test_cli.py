"""The command line as a user sees it: exit status, stdout, stderr and files."""

import json
import os
import re
import signal
import subprocess
import sys

import pytest

from caterpillar_env.worlds import Slope
from evolution import cli
from evolution.run.history import load

MAIN = "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler); \
from evolution.cli import main; sys.exit(main())"
TINY = [
    "evolve", "--num-segments", "2", "--timestep-s", "0.01", "--population", "2",
    "--hall-of-fame", "1", "--generations", "1", "--no-video",
]  # fmt: skip


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A run folder that `caterpillar evolve` wrote."""
    folder = tmp_path_factory.mktemp("cli") / "run"
    arguments = [*TINY, "--population", "4", "--generations", "2", "--seed", "4"]
    assert cli.main([*arguments, "--out", str(folder)]) == 0
    return folder


@pytest.fixture
def elsewhere(tmp_path, monkeypatch):
    """A temporary working folder with some unusable files."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "file").write_text("")
    (tmp_path / "broken.json").write_text('{"format": ')
    (tmp_path / "other.json").write_text("[1, 2, 3]")
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "notes.txt").write_text("mine")
    return tmp_path


def status(arguments):
    """Return the exit status, whether it is returned or raised."""
    try:
        return cli.main(arguments)
    except SystemExit as stop:
        return stop.code


def subcommand(arguments, **kwargs):
    return subprocess.Popen(
        [sys.executable, "-c", MAIN, *arguments],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, **kwargs,
    )  # fmt: skip


# Errors


@pytest.mark.parametrize(
    "arguments",
    [
        ["evolve", "--bogus"],
        ["evolve", "nonsense"],
        ["evolve", "--population", "many"],
        ["evolve", "--population"],
        ["evolve", "--crossover", "three-point"],
        ["evolve", "--preset", "enormous"],
        ["evolve", "--prior", "hopeful"],
        ["replay", "broken.json", "--timestep-s", "fine"],
    ],
    ids=" ".join,
)
def test_wrong_usage_exits_with_status_2(arguments, elsewhere, capsys):
    before = sorted(elsewhere.rglob("*"))
    assert cli.main(arguments) == 2
    captured = capsys.readouterr()
    assert captured.out == ""
    assert arguments[-1] in captured.err
    assert f"caterpillar {arguments[0]} --help" in captured.err
    assert sorted(elsewhere.rglob("*")) == before


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["fly"],
        ["--bogus"],
        ["evolve", "--population", "-5"],
        ["evolve", "--population", "10", "--hall-of-fame", "-1"],
        ["evolve", "--generations", "0"],
        ["evolve", "--seed", "-1"],
        ["evolve", "--mutation-rate", "1.5"],
        [*TINY, "--gait-period-s", "0.25"],
        [*TINY, "--gait-period-s", "nan"],
        [*TINY, "--gait-period-s", "inf"],
        [*TINY, "--floor-ratio", "inf"],
        [*TINY, "--failed-fitness", "inf"],
        ["evolve", "--num-segments", "1"],
        ["evolve", "--friction", "-0.1"],
        ["evolve", "--ambient-c", "500"],
        ["evolve", "--threads", "-1"],
        [*TINY, "--out", "full"],
        [*TINY, "--out", "file"],
        [*TINY, "--out", "file/run"],
        ["preprocess", "--floor-ratio", "1"],
        ["preprocess", "--floor-ratio", "inf"],
        ["preprocess", "--num-segments", "2", "--gait-period-s", "0"],
        ["preprocess", "--num-segments", "2", "--gait-period-s", "-2"],
        ["preprocess", "--num-segments", "2", "--gait-period-s", "nan"],
        ["preprocess", "--num-segments", "1"],
        ["preprocess", "--num-segments", "2", "--out", "file/densities.png"],
        ["preprocess", "--num-segments", "2", "--out", "densities.xyz"],
        ["replay"],
        ["replay", "nothing.json"],
        ["replay", "nowhere/best.json"],
        ["replay", "full"],
        ["replay", "file/best.json"],
        ["replay", "file"],
        ["replay", "broken.json"],
        ["replay", "other.json"],
    ],
    ids=" ".join,
)
def test_errors_print_one_line_and_set_the_exit_status(arguments, elsewhere, capsys):
    before = sorted(elsewhere.rglob("*"))
    assert status(arguments) in (1, 2)
    captured = capsys.readouterr()
    lines = captured.err.splitlines()
    assert len(lines) == 1, captured.err
    assert lines[0].startswith("caterpillar")
    assert "Traceback" not in captured.err
    assert sorted(elsewhere.rglob("*")) == before


@pytest.mark.parametrize(
    ("arguments", "hint"),
    [
        (["fly"], "choose from doctor, evolve, export, preprocess, replay, report, resume"),
        (["evolve", "--bogus"], "--bogus"),
        (["evolve", "--population", "many"], "--population"),
        (["evolve", "--population", "-5"], "population = -5 must be an integer from 2"),
        (["evolve", "--out", "full"], "full is not empty; choose another folder with --out"),
        (["replay", "nothing.json"], "cannot read nothing.json"),
        (["replay", "broken.json"], "broken.json is not JSON"),
    ],
)
def test_errors_name_the_wrong_input(arguments, hint, elsewhere, capsys):
    assert status(arguments) != 0
    assert hint in capsys.readouterr().err


@pytest.mark.parametrize("timestep", ["0", "-0.005", "0.003", "nan", "inf"])
def test_replay_rejects_invalid_timesteps_in_one_line(timestep, recorded, capsys):
    capsys.readouterr()
    assert status(["replay", str(recorded), "--no-video", "--timestep-s", timestep]) in (1, 2)
    captured = capsys.readouterr()
    assert captured.out == ""
    assert len(captured.err.splitlines()) == 1
    assert re.match(r"caterpillar replay: error: .*timestep", captured.err)


# Help


@pytest.mark.parametrize("flag", ["--help", "-h", "help"])
def test_overview_lists_the_subcommands(flag, capsys):
    assert cli.main([flag]) == 0
    captured = capsys.readouterr().out
    for name in ("evolve", "preprocess", "replay"):
        assert name in captured


@pytest.mark.parametrize(
    ("command", "flags"),
    [
        ("evolve", ["--preset", "--population", "--generations", "--seed", "--out", "--no-video"]),
        ("preprocess", ["--json", "--out", "--floor-ratio"]),
        ("replay", ["--timestep-s", "--json", "--no-video"]),
    ],
)
def test_help_lists_the_flags_and_succeeds(command, flags, capsys):
    assert status([command, "--help"]) == 0
    captured = capsys.readouterr()
    assert captured.err == ""
    for flag in flags:
        assert flag in captured.out


def test_version_is_a_number(capsys):
    assert cli.main(["--version"]) == 0
    assert re.match(r"\d+\.\d+", capsys.readouterr().out)


# Runs


def test_evolve_writes_journal_figures_and_page(recorded):
    assert {p.name for p in recorded.iterdir()} == {
        "journal.sqlite", ".lock", "best.json", "convergence.png", "gait.png", "report.html",
    }  # fmt: skip
    assert load(recorded).table().shape == (4 + 3, 9 + 12)


def test_replay_of_a_record_is_identical(recorded, capsys):
    capsys.readouterr()
    assert cli.main(["replay", str(recorded), "--no-video", "--json"]) == 0
    captured = json.loads(capsys.readouterr().out)
    best = json.loads((recorded / "best.json").read_text())
    assert captured["identical"] is True
    assert captured["fitness_m"] == captured["recorded_fitness_m"] == best["fitness_m"]
    assert captured["failure"] == "ok"
    assert captured["timestep_s"] == best["physics"]["timestep_s"]


def test_replay_at_a_finer_timestep_changes_the_fitness(recorded, capsys):
    capsys.readouterr()
    arguments = ["replay", str(recorded / "best.json"), "--no-video", "--json"]
    assert cli.main([*arguments, "--timestep-s", "0.005"]) == 0
    captured = json.loads(capsys.readouterr().out)
    assert captured["timestep_s"] == 0.005
    assert captured["identical"] is False
    assert captured["fitness_m"] != captured["recorded_fitness_m"]


def test_a_world_is_recorded_and_replayed(tmp_path, capsys):
    folder = tmp_path / "run"
    world = ["--world", "slope:angle_deg=3,direction=down", "--seed", "4", "--population", "4"]
    assert cli.main([*TINY, *world, "--out", str(folder)]) == 0
    assert load(folder).config.physics.world == Slope(angle_deg=3.0, direction="down")
    capsys.readouterr()
    assert cli.main(["replay", str(folder), "--no-video", "--json"]) == 0
    assert json.loads(capsys.readouterr().out)["identical"]


def test_process_exits_with_the_status_and_prints_one_line(tmp_path):
    process = subcommand(["replay", "nothing.json"], cwd=tmp_path)
    out, err = process.communicate(timeout=120)
    assert process.returncode == 1
    assert out == ""
    assert err.startswith("caterpillar replay: error: cannot read nothing.json: No such file")
    assert err.count("\n") == 1


@pytest.mark.slow
def test_interrupted_run_keeps_its_generations_and_prints_how_to_resume(tmp_path):
    arguments = [*TINY, "--generations", "50", "--population", "4", "--out", "run"]
    process = subcommand(arguments, cwd=tmp_path)
    first = process.stderr.readline()
    os.kill(process.pid, signal.SIGINT)
    _, err = process.communicate(timeout=120)
    assert first.startswith("generation   0")
    assert process.returncode == 130
    assert "Traceback" not in err
    assert "stopped" in err
    assert "stopped; continue with: caterpillar resume run" in err
    generation = load(tmp_path / "run").table()["generation"].to_list()
    later = len(generation) - 4  # later generations have three robots each
    assert later % 3 == 0
    assert generation == [0] * 4 + [1 + i // 3 for i in range(later)]


def test_machine_that_cannot_draw_skips_only_the_video(tmp_path):
    process = subcommand(
        [*TINY, "--seed", "4", "--video", "--out", "run"],
        cwd=tmp_path, env={**os.environ, "MUJOCO_GL": "disabled"},
    )  # fmt: skip
    out, err = process.communicate(timeout=120)
    assert process.returncode == 0, err
    assert "best:" in out
    assert "no video:" in err
    assert not list((tmp_path / "run").glob("*.mp4"))
    assert (tmp_path / "run" / "gait.png").exists()
