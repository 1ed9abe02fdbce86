"""The progress of a run, and the files that are written at its end."""

import errno
import io
import re
import sys
import time

import pytest
from rich.console import Console

from caterpillar_env.errors import CaterpillarError
from evolution import cli
from evolution.cli import running
from evolution.cli.running import Reporter, WorkerArgs
from evolution.config import RunConfig
from evolution.optimizers.ga import GaConfig
from evolution.run.history import Generation, load


def summary(number, evaluations, *, replayed=False, **failures):
    failed = {"tipped": 0, "veered": 0, **failures}
    return Generation(number, 0.0123, 0.004, failed, evaluations, 210.0, replayed=replayed)


def test_progress_line_excludes_replayed_generations_from_the_time_left():
    config = RunConfig(generations=4, ga=GaConfig(population=4, hall_of_fame=1))
    output = io.StringIO()
    with Reporter(config, Console(file=output, width=200)) as reporter:
        reporter.generation(summary(0, 4, replayed=True))
        reporter.progress(0.5)
        time.sleep(0.2)
        reporter.generation(summary(1, 7, tipped=1, veered=2))
    replayed, computed = output.getvalue().splitlines()
    assert "left" not in replayed
    assert "best   12.3 mm" in computed
    assert "failed: 1 tipped, 2 veered" in computed
    assert re.search(r"50 % done, \d s left$", computed)


@pytest.mark.parametrize("budget_s", [None, 420.0])
def test_share_done_never_decreases(budget_s):
    config = RunConfig(generations=3, budget_s=budget_s, ga=GaConfig(population=4, hall_of_fame=1))
    console = Console(file=io.StringIO(), force_terminal=True, width=120)
    done = []
    with Reporter(config, console) as reporter:
        for number, evaluations in enumerate((4, 7, 10)):
            for share in (0.1, 0.5, 1.0):
                reporter.progress(share)
                done.append(reporter.share_done)
            reporter.generation(summary(number, evaluations)._replace(simulated_s=140.0 * (number + 1)))
            done.append(reporter.share_done)
    assert done == sorted(done)
    assert done[-1] == pytest.approx(1.0)


def test_progress_ignores_a_closed_terminal(monkeypatch):
    class Closed(io.StringIO):
        def write(self, *text):
            raise OSError(errno.EIO, "Input/output error")

        flush = write

    for stream in (Closed(), None):  # None if the program starts with a closed stderr
        monkeypatch.setattr(sys, "stderr", stream)
        cli.console().print("generation 0")


def test_threads_and_a_ray_cluster_are_not_combined():
    with pytest.raises(CaterpillarError, match="--threads requires --evaluator local"):
        WorkerArgs(threads=2, evaluator="ray")


def test_video_is_written_unless_it_already_shows_the_best_robot(run, monkeypatch, capsys):
    history, made = load(run[0]), []
    path, console = history.folder / "best.mp4", Console(file=io.StringIO())
    monkeypatch.setattr(cli, "film", lambda *arguments: made.append(arguments))
    monkeypatch.setattr("evolution.report.run_page.write", lambda history, _: path)
    monkeypatch.setattr(
        "caterpillar_env.drawing.video.is_video_of",
        lambda path, robot: path.exists() and path.read_bytes() == b"it",
    )
    running.write_results(history, console, video=True)
    path.write_bytes(b"another robot")
    capsys.readouterr()
    running.write_results(history, console, video=False)
    assert "film: " not in capsys.readouterr().out
    running.write_results(history, console, video=True)
    path.write_bytes(b"it")
    running.write_results(history, console, video=True)
    assert f"film: {path}" in capsys.readouterr().out
    path.unlink()
    filmed = [(recording.robot.digest, where) for recording, where, _ in made]
    assert filmed == [(history.best_robot.digest, path)] * 2
