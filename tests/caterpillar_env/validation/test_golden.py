import json

import numpy as np
import pytest

from caterpillar_env.robot import Robot
from caterpillar_env.validation import golden


def test_robots_move_as_recorded():
    failed = [check for check in golden.check_trajectories() if not check.passed]
    assert not failed, golden.ADVICE


def test_deviation_of_a_micrometre_and_a_different_failure_are_detected(tmp_path):
    data = json.loads(golden.FILE.read_text("utf-8"))
    data["trajectories"] = data["trajectories"][:2]
    data["trajectories"][0]["com_m"][4][0] += 1.1e-6
    data["trajectories"][1]["verdict"] = "tipped"
    changed = tmp_path / "golden.json"
    changed.write_text(json.dumps(data), encoding="utf-8")
    first, second = golden.check_trajectories(changed)
    assert not first.passed
    assert "MuJoCo" in first.expected
    assert not second.passed


def test_trajectory_ends_where_the_evaluation_does():
    entry = json.loads(golden.FILE.read_text("utf-8"))["trajectories"][0]
    robot = Robot.from_dict(entry["robot"])
    points, verdict = golden.compute_trajectory(robot)
    assert verdict == "ok"
    assert len(points) == 10
    # The straight robot starts with its centre of mass behind its head, at a known place.
    start_m = -robot.morphology.segment_length_m * 1.75
    assert points[-1, 0] - start_m == pytest.approx(robot.simulate().distance_m[0], abs=1e-12)
    assert np.array(entry["com_m"]).shape == points.shape
