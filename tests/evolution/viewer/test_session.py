"""A session reproduces the fitness evaluation. Its robot can be changed while it crawls."""

from dataclasses import replace

import numpy as np
import pytest

from caterpillar_env.errors import CaterpillarError
from caterpillar_env.gait import GaitTimings
from caterpillar_env.morphology import Morphology
from caterpillar_env.physics import SMA_STEP_S, Physics
from caterpillar_env.robot import Robot, wave_robot
from caterpillar_env.sma import SmaSpring
from caterpillar_env.task import EPISODE_S, Failure
from evolution.viewer.session import Session

SHORT = Physics(num_segments=2, timestep_s=0.01)
GAIT = GaitTimings(2.0, np.array([0.0, 1.0]), np.array([0.6, 1.5]))


@pytest.fixture
def robot():
    return Robot(Morphology(), GAIT, SHORT)


def run(session, intervals=300):
    for _ in range(intervals):
        session.advance()
    return session


def test_wave_robot_crawls_as_in_the_fitness_evaluation():
    robot = wave_robot()
    session = run(Session(robot))
    assert session.finished
    outcomes = robot.simulate(threads=1)
    assert session.progress.distance_m[0] == outcomes.distance_m[0] > 0.15
    assert session.progress.energy_j[0] == outcomes.energy_j[0]
    assert session.failure is Failure.NONE
    assert session.time_s == pytest.approx(EPISODE_S)


def test_poses_match_the_simulation(robot):
    session = Session(robot)
    ambient = SmaSpring().ambient_c
    assert session.pose(0.0)[1] == pytest.approx(ambient)
    for _ in range(3):
        session.advance()
    traces = []
    robot.simulate(threads=1, duration_s=0.3, on_interval=traces.append)
    for step in (0, 4, 9):
        qpos, temperature_c = session.pose(0.2 + (step + 1) * SMA_STEP_S)
        np.testing.assert_array_equal(qpos, traces[-1].qpos[0, step])
        np.testing.assert_array_equal(temperature_c, traces[-1].temperature_c[0, step])
    np.testing.assert_array_equal(session.pose(99.0)[0], traces[-1].qpos[0, -1])
    np.testing.assert_array_equal(session.pose(0.0)[0], traces[-1].qpos[0, 0])


def test_a_new_body_or_physics_restarts_like_a_new_session(robot):
    for change in (
        {"morphology": replace(robot.morphology, segment_length_m=0.025)},
        {"physics": replace(SHORT, friction=0.3)},
    ):
        session = Session(robot)
        session.advance()
        other = replace(robot, **change)
        assert session.change(other)
        assert session.time_s == 0
        distance_m = run(session, 10).progress.distance_m[0]
        assert distance_m == run(Session(other), 10).progress.distance_m[0]
        assert distance_m != run(Session(robot), 10).progress.distance_m[0]


def test_a_new_gait_does_not_restart(robot):
    session = Session(robot)
    session.advance()
    idle = replace(robot, timings=GaitTimings(2.0, np.zeros(2), np.zeros(2)))
    assert not session.change(idle)
    assert session.time_s == pytest.approx(0.1)
    hot = session.pose(99.0)[1][0]
    run(session)
    assert session.pose(99.0)[1][0] < hot


def test_a_failed_robot_stops(robot):
    wide = replace(wave_robot(), physics=Physics(mismatch_std=3.0, mismatch_seed=1))
    session = run(Session(wide))
    assert session.failure is not Failure.NONE
    assert session.time_s < EPISODE_S
    at_s = session.time_s
    session.advance()
    assert session.time_s == at_s


def test_an_invalid_gait_raises_an_error(robot):
    with pytest.raises(CaterpillarError, match=r"whole multiple of 0\.1 s"):
        Session(replace(robot, timings=GaitTimings(0.25, np.zeros(2), np.zeros(2))))
    with pytest.raises(CaterpillarError, match="times of 4 springs or 2"):
        Session(replace(robot, timings=GaitTimings(2.0, np.zeros(3), np.zeros(3))))
