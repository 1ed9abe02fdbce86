"""`caterpillar view`: its messages and its exit status."""

import os
import re
import signal
import socket
import subprocess
import sys
import urllib.request

import pytest

from evolution import cli
from evolution.viewer.session import nominal_robot

MAIN = "import signal, sys; signal.signal(signal.SIGINT, signal.default_int_handler); \
from evolution.cli import main; sys.exit(main())"


def test_the_page_is_served_on_loopback_until_ctrl_c(tmp_path):
    pytest.importorskip("viser")
    nominal_robot().save(tmp_path / "best.json")
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
        (["other.json"], "other.json: no robot: expected JSON with"),
        (["slow.json"], "the gait period of 0.25 s must be a whole multiple of 0.1 s"),
        (["--port", "70000"], "port 70000 of 127.0.0.1: bind(): port must be 0-65535"),
        (["--port", "-1"], "or 0 for any free port"),
        (["--port", "web"], "--port"),
        (["--bogus"], "--bogus"),
    ],
)
def test_wrong_input_raises_a_helpful_error(arguments, hint, tmp_path, monkeypatch, capsys):
    pytest.importorskip("viser")
    monkeypatch.chdir(tmp_path)
    (tmp_path / "other.json").write_text("[1]")
    nominal_robot().save(tmp_path / "slow.json")
    text = (tmp_path / "slow.json").read_text()
    text = re.sub(r'(on_s|off_s)": [0-9.]+', r'\1": 0.1', text)
    (tmp_path / "slow.json").write_text(text.replace('"period_s": 5.0', '"period_s": 0.25'))
    assert cli.main(["view", *arguments]) in (1, 2)
    output = capsys.readouterr()
    assert output.out == ""
    assert hint in output.err


def test_a_port_in_use_is_an_error(capsys):
    pytest.importorskip("viser")
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        port = taken.getsockname()[1]
        assert cli.main(["view", "--port", str(port)]) == 1
    error = capsys.readouterr().err
    assert f"cannot listen on port {port} of 127.0.0.1" in error
    assert "Address already in use" in error


def test_without_viser_the_error_names_the_package_to_install(monkeypatch, capsys):
    monkeypatch.setitem(sys.modules, "viser", None)
    assert cli.main(["view"]) == 1
    assert "pip install 'caterpillar-sma[view]'" in capsys.readouterr().err
