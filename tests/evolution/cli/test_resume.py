"""`caterpillar resume` continues, extends and repairs runs."""

import shutil

import pytest

from evolution import cli
from evolution.run.history import load


def test_resume_can_make_a_run_longer(run, elsewhere, capsys, without_page):
    shutil.copytree(run[0], "short")
    assert cli.main(["resume", "short", "--generations", "2", "--no-video"]) == 0
    assert len(load("short").generations) == 2


def test_resume_does_not_repeat_a_finished_run(run, tmp_path, capsys):
    shutil.copytree(run[0], tmp_path / "run")
    before = {p.name: p.read_bytes() for p in (tmp_path / "run").iterdir()}
    assert cli.main(["resume", str(tmp_path / "run")]) == 0
    captured = capsys.readouterr()
    assert captured.err == "already finished: all 1 generations are complete\n"
    assert f"caterpillar resume {tmp_path / 'run'} --generations 2" in captured.out
    assert {p.name: p.read_bytes() for p in (tmp_path / "run").iterdir()} == before


def test_resume_writes_a_lost_best_robot_again(run, tmp_path, without_page):
    shutil.copytree(run[0], tmp_path / "run")
    (tmp_path / "run" / "best.json").unlink()
    assert cli.main(["resume", str(tmp_path / "run"), "--no-video"]) == 0
    assert (tmp_path / "run" / "best.json").read_bytes() == (run[0] / "best.json").read_bytes()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["nowhere"], "is not a run folder"),
        ([], "folder"),
        (["run", "--generations", "many"], "--generations"),
        (["run", "--threads", "-1"], "threads = -1"),
        (["run", "--evaluator", "cloud"], "--evaluator"),
    ],
)
def test_resume_names_wrong_input(elsewhere, capsys, arguments, message):
    assert cli.main(["resume", *arguments]) in (1, 2)
    assert message.lower() in capsys.readouterr().err.lower()
