"""The examples run as they stand."""

import ast
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[2]
SCRIPTS = sorted((ROOT / "examples").glob("*.py"))
LEAVES = {"preprocess.py": "prior.png", "wrappers.py": "videos/wave-episode-0.mp4"}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Runs a script in a folder of its own; gives what it printed."""

    def told(script):
        folder = tmp_path_factory.mktemp(script.stem)
        done = subprocess.run(
            [sys.executable, "-W", "error", script],
            cwd=folder,
            env={**os.environ, "TMPDIR": str(folder)},
            capture_output=True,
            text=True,
            check=False,
        )
        assert done.returncode == 0, done.stderr
        if script.name in LEAVES:
            assert (folder / LEAVES[script.name]).stat().st_size > 5_000
        return done.stdout

    return told


@pytest.mark.slow
@pytest.mark.parametrize(
    "script", [s for s in SCRIPTS if s.name != "crawl.py"], ids=lambda script: script.name
)
def test_example_runs(script, run):
    assert run(script).strip()


def test_robot_crawls_as_far_as_was_recorded(run):
    *_, last, verdict = run(ROOT / "examples" / "crawl.py").splitlines()
    (distance,) = re.findall(r"([\d.]+) mm", last)
    assert f"recorded {distance} mm" in verdict
    assert "ended ok" in verdict


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda script: script.name)
def test_example_is_short_and_told_of(script):
    text = script.read_text(encoding="utf-8")
    assert len(text.splitlines()) < 60
    assert ast.get_docstring(ast.parse(text))
    assert script.name in (ROOT / "docs" / "examples.md").read_text(encoding="utf-8")
