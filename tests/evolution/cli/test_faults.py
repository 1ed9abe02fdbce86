"""Machine faults and damaged or hostile files give a one-line error or correct data."""

import errno
import html
import json
import os
import shutil
import signal
import time
from pathlib import Path

import pytest

from caterpillar_env.files import name_of, write_bytes
from evolution import cli
from evolution.cli.running import Reporter
from evolution.report import run_page
from evolution.run.history import load
from evolution.run.journal import FILE, Journal

FLAGS = [
    "evolve", "--num-segments", "2", "--timestep-s", "0.01", "--friction", "0.7", "--population", "3",
    "--hall-of-fame", "1", "--generations", "2", "--seed", "4", "--no-video", "--out", "run",
]  # fmt: skip


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Folder of a run."""
    folder = tmp_path_factory.mktemp("faults") / "run"
    assert cli.main([*FLAGS[:-1], str(folder)]) == 0
    return folder


@pytest.fixture
def elsewhere(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(run_page, "write", lambda history, _: history.folder)  # takes a second
    return tmp_path


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_signals_end_a_run_as_ctrl_c_does(elsewhere, monkeypatch, capsys, number):
    def stop(*_):
        os.kill(os.getpid(), number)
        time.sleep(5.0)

    before = signal.signal(number, signal.SIG_DFL)  # nohup ignores SIGHUP
    try:
        with monkeypatch.context() as patch:
            patch.setattr(Reporter, "generation", stop)
            assert cli.main(FLAGS) == 130
        assert signal.getsignal(number) is signal.SIG_DFL
    finally:
        signal.signal(number, before)
    assert "stopped; continue with: caterpillar resume run" in capsys.readouterr().err
    assert len(load("run").generations) == 1
    assert cli.main(["resume", "run", "--no-video"]) == 0
    assert len(load("run").generations) == 2


def test_ignored_signals_stay_ignored(monkeypatch):
    """nohup starts programs with SIGHUP ignored."""
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        assert (
            cli.dispatch({"x": lambda: lambda _: os.kill(os.getpid(), signal.SIGHUP) or 0}, ["x"]) == 0
        )
    finally:
        signal.signal(signal.SIGHUP, before)


def test_system_errors_print_one_line(capsys):
    def fail(_):
        raise PermissionError(errno.EACCES, "Permission denied", "secret")

    assert cli.dispatch({"x": lambda: fail}, ["x"]) == 1
    assert capsys.readouterr().err == "caterpillar x: error: [Errno 13] Permission denied: 'secret'\n"


def test_a_run_killed_before_its_journal_existed_can_be_started_again(elsewhere, capsys):
    (elsewhere / "run").mkdir()
    for name in (f".{FILE}.partial", f".{FILE}.partial-journal", ".lock"):
        (elsewhere / "run" / name).write_text("partly")
    assert cli.main(["resume", "run"]) == 1
    assert "run is not a run folder" in capsys.readouterr().err
    assert cli.main(FLAGS) == 0
    assert load("run").finished
    assert not (elsewhere / "run" / f".{FILE}.partial").exists()


def test_resume_after_a_full_disk_equals_an_uninterrupted_run(run, elsewhere, monkeypatch, capsys):
    """best.json does not fit. The resumed run writes it, and is the same as the uninterrupted one."""

    def fill_disk(*_, **__):
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_bytes", fill_disk)
        assert cli.main(FLAGS) == 1
    error = capsys.readouterr().err
    assert "cannot write run/best.json: No space left on device; free some space" in error
    assert "caterpillar resume run" in error
    assert cli.main(["resume", "run", "--no-video"]) == 0
    best = json.loads((elsewhere / "run" / "best.json").read_text())
    assert best == json.loads((run / "best.json").read_text())
    assert load("run").table().drop("session").equals(load(run).table().drop("session"))


def test_one_bad_run_does_not_stop_the_listing_of_runs(run, elsewhere, capsys):
    good = shutil.copytree(run, elsewhere / "runs" / "good")
    configurations = {
        "a": {"seed": 1, "luck": 2}, "b": {"kind": "training"}, "c": {"kind": [1]},
        "d": {"ga": {"population": "many"}}, "e": {"physics": 3},
    }  # fmt: skip
    for name, configuration in configurations.items():
        (elsewhere / "runs" / name).mkdir()
        Journal.create(elsewhere / "runs" / name, configuration).close()
    (elsewhere / "runs" / "f").mkdir()
    os.mkfifo(elsewhere / "runs" / "f" / FILE)
    (good / "best.json").write_text('{"fitness_m": "far"}')
    assert cli.main(["runs", "--json"]) == 0
    states = {
        row["run"].removeprefix("runs/"): row["state"] for row in json.loads(capsys.readouterr().out)
    }
    assert states["good"] == "finished"
    assert states["b"] == "stopped"
    assert "has no luck" in states["a"]
    assert "holds a [1] run" in states["c"]
    assert "population = 'many' must be an integer" in states["d"]
    assert "physics must be a mapping" in states["e"]
    assert "is not a regular file" in states["f"]


def test_best_robot_with_a_text_as_fitness_is_refused(run, elsewhere, capsys):
    folder = shutil.copytree(run, elsewhere / "run")
    data = json.loads((folder / "best.json").read_text()) | {"fitness_m": "far"}
    (folder / "best.json").write_text(json.dumps(data))
    assert cli.main(["replay", "run", "--no-video"]) == 1
    assert "best.json: it does not match its digest" in capsys.readouterr().err
    del data["digest"]
    (folder / "best.json").write_text(json.dumps(data))
    assert cli.main(["replay", "run", "--no-video"]) == 1
    assert "best.json: fitness_m = 'far' must be a finite number" in capsys.readouterr().err


def test_every_command_detects_a_changed_digit_of_the_configuration(run, elsewhere, capsys):
    folder = shutil.copytree(run, elsewhere / "run")
    content = (folder / FILE).read_bytes()
    assert content.count(b'"turns": 100.0') == 1
    (folder / FILE).write_bytes(content.replace(b'"turns": 100.0', b'"turns": 110.0'))
    for command in (
        ["resume"],
        ["report", "--no-video"],
        ["export"],
        ["view"],
        ["replay", "--generations", "0"],
    ):
        assert cli.main([command[0], "run", *command[1:]]) == 1
        assert "journal.sqlite is damaged: row 0 of the table run was altered" in capsys.readouterr().err


@pytest.mark.parametrize("kind", ["csv", "parquet", "json", "mjcf"])
def test_an_export_to_a_full_disk_keeps_the_existing_file(run, elsewhere, monkeypatch, capsys, kind):
    def fill_disk(path, data):
        path.write_text(str(data[:9]))
        raise OSError(errno.ENOSPC, "No space left on device")

    (elsewhere / "table").write_text("before")
    with monkeypatch.context() as patch:
        patch.setattr(Path, "write_bytes", fill_disk)
        assert cli.main(["export", str(run), "--to", kind, "--out", "table"]) == 1
    assert "cannot write table: No space left on device" in capsys.readouterr().err
    assert {path.name: path.read_text() for path in elsewhere.iterdir()} == {"table": "before"}


def test_error_advises_a_new_start_if_the_journal_cannot_be_created(elsewhere, monkeypatch, capsys):
    def fill_disk(*_):
        raise OSError(errno.ENOSPC, "No space left on device")

    with monkeypatch.context() as patch:
        patch.setattr("evolution.run.journal.os.replace", fill_disk)
        assert cli.main(FLAGS) == 1
    error = capsys.readouterr().err
    assert "No space left on device" in error
    assert "Nothing was recorded; start the run again" in error
    assert cli.main(FLAGS) == 0


@pytest.mark.parametrize(
    "name", ["<script>x", "$x^$", "'; DROP TABLE run;--", os.fsdecode(b"\xff\xfe"), "{{1}}%s"]
)
def test_folder_names_are_treated_as_plain_text(run, tmp_path, name):
    """Folder names are not interpreted as HTML, formulas, SQL or templates."""
    folder = shutil.copytree(run, tmp_path / name)
    text = run_page.write(load(folder)).read_text(encoding="utf-8")
    assert "<script>x" not in text
    assert html.escape(name_of(folder)) in text.replace("&#39;", "&#x27;")
    assert cli.main(["runs", str(tmp_path)]) == 0


def test_an_export_to_a_pipe_does_not_replace_it(run, tmp_path):
    os.mkfifo(tmp_path / "pipe")
    reader = os.open(tmp_path / "pipe", os.O_RDONLY | os.O_NONBLOCK)
    assert cli.main(["export", str(run), "--out", str(tmp_path / "pipe")]) == 0
    assert os.read(reader, 10) == b"evaluation"
    os.close(reader)
    assert (tmp_path / "pipe").is_fifo()


def test_an_export_to_a_link_changes_its_target(run, tmp_path):
    (tmp_path / "link").symlink_to(tmp_path / "rows.csv")
    for _ in range(2):  # a new and an existing target
        assert cli.main(["export", str(run), "--out", str(tmp_path / "link")]) == 0
        assert (tmp_path / "rows.csv").read_text().startswith("evaluation")
    assert (tmp_path / "link").is_symlink()


@pytest.mark.parametrize("target", ["loop", "pipe"])
def test_links_that_lead_to_no_file_are_replaced(run, tmp_path, target):
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "loop").symlink_to(tmp_path / target)
    write_bytes(tmp_path / "loop", b"content")
    assert (tmp_path / "loop").read_bytes() == b"content"
    assert (tmp_path / "pipe").is_fifo()


def test_pages_and_figures_replace_pipes(run, tmp_path):
    """Writing to a pipe would wait for a reader."""
    folder = shutil.copytree(run, tmp_path / "run")
    for name in ("report.html", "convergence.png"):
        (folder / name).unlink()
        os.mkfifo(folder / name)
    run_page.write(load(folder))
    assert (folder / "report.html").is_file()
    assert (folder / "convergence.png").is_file()
