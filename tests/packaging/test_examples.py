"""The examples run, and are listed in the documentation."""

import ast
import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from caterpillar_env import GaitTimings, Morphology, Physics, Robot
from caterpillar_env.task import Failure

ROOT = Path(__file__).parents[2]
SCRIPTS = sorted((ROOT / "examples").glob("*.py"))
WITH_OWN_TEST = {"crawl.py", "plain_mujoco.py"}
#: Replacements in the code of the examples, so that the tests simulate fewer robots and steps.
FEWER = {
    "compare.py": ("SEEDS, BUDGET_S = (0, 1), 500", "SEEDS, BUDGET_S = (0,), 500"),
    "evolve.py": ("generations=3", "generations=2"),
    "planning.py": ("TRIALS, PERIODS = 32, 6", "TRIALS, PERIODS = 4, 2"),
    "ppo.py": ("NUM_ENVS, STEPS, EPOCHS = 8, 6, 10", "NUM_ENVS, STEPS, EPOCHS = 2, 6, 10"),
    "vector.py": ("NUM_ROBOTS = 8", "NUM_ROBOTS = 2"),
    "wrappers.py": ("episode_s=10.0", "episode_s=5.0"),
}
OUTPUTS = {"preprocess.py": "prior.png", "wrappers.py": "videos/wave-episode-0.mp4"}


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    """A function that runs a script in a temporary folder, and returns its output."""

    def run_script(script, *arguments):
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
        if script.name in OUTPUTS:
            assert (folder / OUTPUTS[script.name]).stat().st_size > 5_000
        return done.stdout

    return run_script


@pytest.mark.slow
@pytest.mark.parametrize(
    "script",
    [s for s in SCRIPTS if s.name not in WITH_OWN_TEST],
    ids=lambda script: script.name,
)
def test_example_runs(script, run, tmp_path):
    text, (many, few) = script.read_text(encoding="utf-8"), FEWER.get(script.name, ("", ""))
    assert many in text
    shorter = tmp_path / script.name
    shorter.write_text(text.replace(many, few), encoding="utf-8")
    assert run(shorter).strip()


def test_robot_crawls_as_far_as_recorded(run):
    *_, last, verdict = run(ROOT / "examples" / "crawl.py").splitlines()
    (distance,) = re.findall(r"([\d.]+) mm", last)
    assert f"recorded {distance} mm" in verdict
    assert "failure: ok" in verdict


def test_plain_mujoco_robot_crawls_as_far_as_recorded(run, tmp_path):
    # Two segments are quick to simulate. The robot must not fail: the loop does not stop at a failure.
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
def test_example_is_short_and_documented(script):
    text = script.read_text(encoding="utf-8")
    assert len(text.splitlines()) < 60
    assert ast.get_docstring(ast.parse(text))
    assert script.name in (ROOT / "docs" / "examples.md").read_text(encoding="utf-8")


@pytest.mark.parametrize("script", SCRIPTS, ids=lambda script: script.name)
def test_example_has_few_imports_of_this_project(script):
    tree = ast.parse(script.read_text(encoding="utf-8"))
    modules = [node.module or "" for node in ast.walk(tree) if isinstance(node, ast.ImportFrom)]
    own = [m for m in modules if m.partition(".")[0] in ("caterpillar_env", "evolution")]
    assert len(own) <= 3
    assert not any(m.startswith("evolution.") for m in own)
