"""Every benchmark runs and prints its result as a line of JSON."""

import json
import subprocess
import sys

import pytest

from benchmarks import advance


@pytest.mark.slow
def test_ranks_of_the_advance_are_compared_with_the_simulator(monkeypatch, capsys):
    monkeypatch.setattr(advance, "WAVES", 4)
    advance.main()
    lines = capsys.readouterr().out.splitlines()
    assert [line.split(":")[0] for line in lines] == ["nominal body", "random bodies"]
    assert all("over 4 waves" in line for line in lines)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "tables"),
    [
        (["population", "--bodies", "3", "--periods", "2", "--repeats", "1"], 1),
        (["cluster", "--cores", "2", "--runs", "1", "2", "--seconds", "1", "--scale", "0.01"], 1),
        (["environments", "--repeats", "1", "--single"], 1),
        (["environments", "--repeats", "1", "--envs", "2"], 2),
        (["worlds", "scores", "--robots", "2", "--worlds", "flat", "steps"], 1),
        (["worlds", "costs", "--robots", "1", "--repeats", "1", "--worlds", "rough"], 1),
        (["soak", "--steps", "300", "--cycles", "5"], 2),
    ],
    ids=lambda value: " ".join(value[:2]) if isinstance(value, list) else "",
)
def test_script(arguments, tables):
    module, *rest = arguments
    done = subprocess.run(
        [sys.executable, "-m", f"benchmarks.{module}", *rest],
        capture_output=True,
        text=True,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    printed = [json.loads(line) for line in done.stdout.splitlines()]
    assert len(printed) == tables
    for table in printed:
        assert table["rows"]
        assert table["machine"]["mujoco"]
