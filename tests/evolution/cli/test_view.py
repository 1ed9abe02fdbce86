"""`caterpillar view`: its messages and its exit status."""

import os
import re
import signal
import socket
import subprocess
import sys
import urllib.request
from dataclasses import replace

import numpy as np
import pytest

from caterpillar_env.gait import GaitTimings
from caterpillar_env.robot import wave_robot
from evolution import cli
from evolution.config import RunConfig
from evolution.run.journal import Journal

MAIN = "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler); \
from evolution.cli import main; sys.exit(main())"


def test_the_page_is_served_on_loopback_until_ctrl_c(tmp_path):
    pytest.importorskip("viser")
    wave_robot().save(tmp_path / "best.json")
    process = subprocess.Popen(
        [sys.executable, "-c", MAIN, "view", str(tmp_path), "--port", "0"],
        stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True,
    )  # fmt: skip
    try:
        output = process.stdout.readline()
        url = re.match(r"http://127\.0\.0\.1:\d+", output).group()
        assert str(tmp_path) in output
        with urllib.request.urlopen(url, timeout=20) as page:
            assert b"<html" in page.read(2000).lower()
    finally:
        os.kill(process.pid, signal.SIGINT)
        out, err = process.communicate(timeout=60)
    assert process.returncode == 130
    assert (out, err) == ("", "caterpillar view: stopped\n")


@pytest.mark.parametrize(
    ("arguments", "hint"),
    [
        (["nothing.json"], "cannot read nothing.json"),
        (["other.json"], "other.json: not a robot: expected JSON with"),
        (["slow.json"], "the gait period of 0.25 s must be a whole multiple of 0.1 s"),
        (["--port", "70000"], "port = 70000 must be an integer from 0 to 65535"),
        (["--port", "web"], "--port"),
        (["--bogus"], "--bogus"),
    ],
)
def test_wrong_input_raises_a_helpful_error(arguments, hint, tmp_path, monkeypatch, capsys):
    pytest.importorskip("viser")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "other.json").write_text("[1]")
    robot, times_s = wave_robot(), np.full(6, 0.1)
    replace(robot, timings=GaitTimings(0.25, times_s, times_s)).save(tmp_path / "slow.json")
    assert cli.main(["view", *arguments]) in (1, 2)
    output = capsys.readouterr()
    assert output.out == ""
    assert hint in output.err


def test_a_port_in_use_is_replaced_by_another():
    pytest.importorskip("viser")
    from evolution.viewer.server import Viewer

    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        with Viewer(wave_robot(), port) as viewer:
            assert viewer.url != f"http://127.0.0.1:{port}"


def test_without_viser_the_error_names_the_package_to_install(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "viser", None)
    assert cli.main(["view"]) == 1
    assert "pip install 'caterpillar-sma[view]'" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("settings", "arguments", "expected"),
    [
        ({"timing": "on-off"}, [], "on-off"),
        ({"timing": "wave"}, [], "phase"),
        ({"timing": "phase"}, ["--timing", "on-off"], "on-off"),
    ],
)
def test_sliders_match_the_timing_genes_of_the_run(tmp_path, monkeypatch, settings, arguments, expected):
    pytest.importorskip("viser")
    (tmp_path / "run").mkdir()
    with Journal.create(tmp_path / "run", RunConfig(prior="uniform", **settings).to_dict()):
        wave_robot().save(tmp_path / "run" / "best.json")
    shown = []

    def record(robot, port, timing):
        shown.append(timing)
        raise KeyboardInterrupt

    monkeypatch.setattr("evolution.viewer.server.Viewer", record)
    assert cli.main(["view", str(tmp_path / "run"), *arguments]) == 130
    assert shown == [expected]
