"""The examples run as they stand."""

import ast
import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from caterpillar_env import Morphology, Physics
from caterpillar_env.gait import GaitTimings
from caterpillar_env.robot import Robot
from caterpillar_env.task import Failure

ROOT = Path(__file__).parents[2]
SCRIPTS = sorted((ROOT / "examples").glob("*.py"))
WITH_A_TEST_OF_ITS_OWN = {"crawl.py", "plain_mujoco.py"}
LEAVES = {"preprocess.py": "prior.png", "wrappers.py": "videos/wave-episode-0.mp4"}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """Runs a script with arguments in a folder of its own; gives what it printed."""

    def told(script, *arguments):
        folder = tmp_path_factory.mktemp(script.stem)
        done = subprocess.run(
            [sys.executable, "-W", "error", script, *arguments],
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
    "script",
    [s for s in SCRIPTS if s.name not in WITH_A_TEST_OF_ITS_OWN],
    ids=lambda script: script.name,
)
def test_example_runs(script, run):
    assert run(script).strip()


def test_robot_crawls_as_far_as_was_recorded(run):
    *_, last, verdict = run(ROOT / "examples" / "crawl.py").splitlines()
    (distance,) = re.findall(r"([\d.]+) mm", last)
    assert f"recorded {distance} mm" in verdict
    assert "ended ok" in verdict


def test_plain_mujoco_comes_as_far_as_was_recorded(run, tmp_path):
    # Two segments make a short robot. It must not fail: a failed robot is stopped, and the loop goes on.
    gait = GaitTimings(5.0, np.array([0.0, 0.5]), np.array([1.5, 1.5]))
    robot = Robot(Morphology(), gait, Physics(num_segments=2))
    (failure,), (distance_m,), _, _ = robot.simulate(threads=1)
    assert failure == Failure.NONE
    replace(robot, fitness_m=float(distance_m)).save(tmp_path / "short.json")
    first, *_ = run(ROOT / "examples" / "plain_mujoco.py", tmp_path / "short.json").splitlines()
    found, recorded = (float(mm) for mm in re.findall(r"(-?[\d.]+) mm", first))
    assert recorded == pytest.approx(1000 * distance_m, abs=0.001)
    assert abs(recorded) > 1
    assert found == pytest.approx(recorded, abs=0.1)


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda script: script.name)
def test_example_is_short_and_told_of(script):
    text = script.read_text(encoding="utf-8")
    assert len(text.splitlines()) < 60
    assert ast.get_docstring(ast.parse(text))
    assert script.name in (ROOT / "docs" / "examples.md").read_text(encoding="utf-8")
