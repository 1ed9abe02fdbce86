import math

import numpy as np
import pytest

from caterpillar_env import Morphology, Physics
from caterpillar_env.errors import CaterpillarError
from caterpillar_env.task import Crawl, Failure, FailureLimits, update_failures

BODY = Morphology()
JUMP_AT_ONCE = FailureLimits(jumped_clearance_m=-1.0)  # everything is "clear of the ground"


def judged(up_z=1.0, clearance_m=0.0, lateral_m=0.0, heading_rad=0.0, body_load=0.0, diverged=False):
    measured = (
        np.array([value]) for value in (clearance_m, lateral_m, heading_rad, body_load, diverged)
    )
    failure = np.zeros(1, np.int8)
    update_failures(np.array([0]), np.array([[0.0, 0.0, up_z]]), *measured, FailureLimits(), failure)
    return Failure(failure[0])


def crawl(rows=1, limits=None, stop_on_failure=True):
    return Crawl([BODY] * rows, Physics(), 1, limits=limits, stop_on_failure=stop_on_failure)


def pose(robots, row, quaternion, height_m):
    """Turn a robot and put its head at a height."""
    qpos = robots.simulation.qpos(row)
    qpos[2], qpos[3:7] = height_m, quaternion
    robots.simulation.place(qpos[None], np.array([row]))


def off(rows=1, intervals=1):
    return np.zeros((rows, 10 * intervals, 12))


def gait(rows=1, intervals=10, seed=0):
    return np.repeat(np.random.default_rng(seed).random((rows, intervals, 12)) < 0.6, 10, axis=1) * 1.0


# Failures


@pytest.mark.parametrize(
    ("what", "failure"),
    [
        ({}, Failure.NONE),
        ({"up_z": 0.51}, Failure.NONE),
        ({"up_z": 0.49}, Failure.TIPPED),
        ({"up_z": -0.49}, Failure.TIPPED),
        ({"up_z": -0.51}, Failure.FLIPPED),
        ({"clearance_m": 0.0049}, Failure.NONE),
        ({"clearance_m": 0.0051}, Failure.JUMPED),
        ({"heading_rad": math.radians(44)}, Failure.NONE),
        ({"heading_rad": math.radians(46)}, Failure.VEERED),
        ({"heading_rad": math.radians(-46)}, Failure.VEERED),
        ({"lateral_m": 0.119}, Failure.NONE),
        ({"lateral_m": 0.121}, Failure.VEERED),
        ({"lateral_m": -0.121}, Failure.VEERED),
        ({"body_load": 0.049}, Failure.NONE),
        ({"body_load": 0.051}, Failure.SAGGED),
        ({"diverged": True}, Failure.DIVERGED),
    ],
    ids=str,
)
def test_failures_begin_at_their_thresholds(what, failure):
    assert judged(**what) is failure


def test_more_severe_failure_takes_precedence():
    everything = {"up_z": -1.0, "clearance_m": 1.0, "lateral_m": 1.0, "diverged": True}
    assert judged(**everything) is Failure.DIVERGED
    assert judged(**everything | {"diverged": False}) is Failure.FLIPPED
    assert judged(up_z=0.0, clearance_m=1.0, lateral_m=1.0) is Failure.TIPPED
    assert judged(clearance_m=1.0, lateral_m=1.0) is Failure.JUMPED
    assert judged(lateral_m=1.0, body_load=1.0) is Failure.VEERED


def test_robot_sags_after_its_body_has_carried_it_for_5_percent_of_the_episode():
    # A robot on its back is carried by its body only. With FLIPPED disabled, it may lie there for 5 %
    # of 30 s.
    robots = crawl(limits=FailureLimits(flipped_up=-2.0, tipped_up=-2.0))
    pose(robots, 0, [0, 1, 0, 0], 0.012)
    robots.run(off(intervals=14))
    assert robots.failure[0] == Failure.NONE
    assert robots.progress().body_load[0] == pytest.approx(1.4 / 30, rel=0.1)
    robots.run(off(intervals=4))
    assert robots.failure[0] == Failure.SAGGED
    assert robots.progress().time_s[0] == pytest.approx(1.6, abs=0.11)


def test_labels_are_lower_case_names():
    labels = ["ok", "diverged", "flipped", "tipped", "jumped", "veered", "sagged"]
    assert [failure.label for failure in Failure] == labels


HALF = math.sqrt(0.5)


@pytest.mark.parametrize(
    ("quaternion", "height_m", "failure"),
    [
        ([0, 1, 0, 0], 0.012, Failure.FLIPPED),  # on its back
        ([HALF, HALF, 0, 0], 0.012, Failure.TIPPED),  # on its side
        ([HALF, 0, HALF, 0], 0.012, Failure.TIPPED),  # on its head
        ([1, 0, 0, 0], 0.3, Failure.JUMPED),  # in the air
        ([math.cos(0.4), 0, 0, math.sin(0.4)], 0.024, Failure.VEERED),  # 0.8 rad to the left
        ([1, 0, 0, 0], 0.024, Failure.NONE),
    ],
    ids=["back", "side", "head", "air", "turned", "start"],
)
def test_pose_determines_the_failure(quaternion, height_m, failure):
    robots = crawl(2)
    pose(robots, 1, quaternion, height_m)
    robots.run(off(2))
    assert robots.progress().failure.tolist() == [Failure.NONE, failure]


def test_diverged_robot_is_reported_and_does_not_affect_the_others(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # MuJoCo logs its warning in the working directory
    robots, healthy = crawl(2, stop_on_failure=False), crawl(2)
    robots.simulation.place(np.full((1, 18), np.nan), np.array([0]))
    power = gait(2, 5)
    robots.run(power)
    healthy.run(power)
    assert robots.failure.tolist() == [Failure.DIVERGED, Failure.NONE]
    assert robots.progress().time_s.tolist() == [0.1, 0.5]  # a diverged one always stops
    assert robots.progress().distance_m[1] == healthy.progress().distance_m[1]


def test_a_divergence_replaces_an_earlier_failure(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    robots = crawl(1, JUMP_AT_ONCE, stop_on_failure=False)
    robots.run(off())
    assert robots.failure.tolist() == [Failure.JUMPED]
    robots.simulation.place(np.full((1, 18), np.nan), np.array([0]))
    robots.run(off(1, 3))
    assert robots.failure.tolist() == [Failure.DIVERGED]
    assert robots.progress().time_s.tolist() == [0.2]  # a diverged robot stops in any case


# Progress


def test_failed_robot_stops_at_the_end_of_its_interval():
    robots = crawl(2)
    pose(robots, 0, [0, 1, 0, 0], 0.012)
    calls = []
    robots.run(gait(2, 5), on_interval=calls.append)
    progress = robots.progress()
    assert progress.failure.tolist() == [Failure.FLIPPED, Failure.NONE]
    assert progress.time_s.tolist() == [0.1, 0.5]
    assert [len(trace.qpos) for trace in calls] == [2, 1, 1, 1, 1]
    robots.run(gait(2, 5))
    assert robots.progress().time_s.tolist() == [0.1, 1.0]
    assert robots.progress().distance_m[0] == progress.distance_m[0]
    assert robots.progress().energy_j[0] == progress.energy_j[0]


def test_progress_counts_only_simulated_steps():
    robots = crawl(3)
    pose(robots, 0, [0, 1, 0, 0], 0.012)
    robots.run(off(3, 4))
    assert robots.simulation.simulated_s == pytest.approx(0.1 + 0.4 + 0.4)
    robots.run(off(1, 2), np.array([0]))
    assert robots.simulation.simulated_s == pytest.approx(0.9)


def test_on_interval_is_not_called_after_all_have_failed():
    robots = crawl(2, JUMP_AT_ONCE)
    calls = []
    robots.run(off(2, 5), on_interval=calls.append)
    assert len(calls) == 1


def test_robots_continue_after_a_failure_without_stop_on_failure():
    robots = crawl(1, JUMP_AT_ONCE, stop_on_failure=False)
    robots.run(off(1, 5))
    assert robots.progress().time_s[0] == 0.5
    assert robots.failure.tolist() == [Failure.JUMPED]
    pose(robots, 0, [0, 1, 0, 0], 0.012)
    robots.run(off(1, 2))
    assert robots.failure.tolist() == [Failure.JUMPED]  # the first failure stays


def test_reset_clears_failure_and_progress():
    robots = crawl(2)
    pose(robots, 0, [0, 1, 0, 0], 0.012)
    robots.run(gait(2, 3))
    robots.reset([BODY], np.array([0]))
    progress = robots.progress()
    assert progress.failure.tolist() == [Failure.NONE, Failure.NONE]
    assert progress.distance_m[0] == 0
    assert progress.energy_j[0] == 0 < progress.energy_j[1]
    assert progress.time_s.tolist() == [0.0, 0.3]


def test_reset_applies_heading_and_offset():
    robots = crawl(2)
    offset = np.zeros((1, 11))
    offset[0, 1] = 0.05
    robots.reset([BODY], np.array([1]), heading_rad=math.pi / 2, offset=offset)
    state = robots.simulation.state()
    assert state.joint_position[1].tolist() == offset[0].tolist()
    assert not state.joint_position[0].any()
    np.testing.assert_allclose(state.forward[0], [1, 0, 0], atol=1e-12)
    assert state.forward[1, 1] > 0.99
    assert state.com_m[1, 1] == pytest.approx(-0.0525, abs=0.003)  # the body trails behind the head


def test_run_passes_the_trace_of_each_interval():
    robots, traces = crawl(2), []
    robots.run(gait(2, 3), on_interval=traces.append)
    assert [t.qpos.shape for t in traces] == [(2, 10, 18)] * 3
    np.testing.assert_array_equal(traces[-1].qpos[1, -1], robots.simulation.qpos(1))


def test_progress_measures_left_as_positive():
    robots = crawl()
    robots.reset([BODY], heading_rad=math.pi / 2)
    qpos = robots.simulation.qpos(0)
    qpos[:2] += [-0.03, 0.02]  # left is -x when heading along y
    robots.simulation.place(qpos[None])
    robots.run(off())
    progress = robots.progress()
    assert progress.distance_m[0] == pytest.approx(0.02, abs=1e-3)
    assert progress.lateral_m[0] == pytest.approx(0.03, abs=1e-3)


def test_each_robot_can_have_its_own_number_of_intervals():
    robots, calls = crawl(3), []
    robots.run(gait(3, 4), on_interval=calls.append, intervals=np.array([4, 0, 2]))
    assert robots.progress().time_s.tolist() == [0.4, 0.0, 0.2]
    assert len(calls) == 4
    alone = crawl(3)
    alone.run(gait(3, 4)[:, :20])
    assert robots.progress().distance_m[2] == alone.progress().distance_m[2]


@pytest.mark.parametrize("shape", [(1, 15, 12), (2, 10, 12), (10, 12), (1, 10, 11)], ids=str)
def test_wrong_power_shape_is_an_error(shape):
    with pytest.raises(CaterpillarError, match="power must have shape") as caught:
        crawl().run(np.zeros(shape))
    assert str(shape) in str(caught.value)
