import mujoco
import numpy as np
import pytest

from caterpillar_env import (
    CaterpillarEnv,
    CaterpillarVectorEnv,
    Morphology,
    Physics,
    SimulationError,
    SmaSpring,
)
from caterpillar_env.rendering import RobotRenderer, spring_colours
from caterpillar_env.simulation import Simulation

WIDTH, HEIGHT = 96, 64
SMALL = Morphology(segment_length_m=0.022, segment_radius_m=0.009)


def drawing_env(render_mode, **kwargs):
    env = CaterpillarEnv(
        render_mode=render_mode, width=WIDTH, height=HEIGHT, gait_period_s=0.5, **kwargs
    )
    env.reset(seed=0)
    return env


def is_picture(frame):
    return frame.shape == (HEIGHT, WIDTH, 3) and frame.dtype == np.uint8 and frame.std() > 10


# Colours


def test_springs_are_blue_cold_yellow_warm_and_red_hot():
    colours = spring_colours(SmaSpring(), np.array([25.0, 68.0, 120.0]))
    np.testing.assert_allclose(
        colours, [[0.25, 0.45, 0.85, 1], [0.95, 0.85, 0.30, 1], [0.90, 0.15, 0.10, 1]], atol=1e-12
    )


def test_colours_blend_between_and_stay_beyond():
    below, cold, half, warm, hot, beyond = spring_colours(
        SmaSpring(), np.array([10.0, 25.0, (25 + 68) / 2, 68.0, 120.0, 500.0])
    )
    np.testing.assert_allclose(half, (cold + warm) / 2)
    np.testing.assert_allclose(below, cold)
    np.testing.assert_allclose(beyond, hot)


# Robot


@pytest.fixture(scope="module")
def robot():
    """A robot at the start and its renderer: contexts are slow to make."""
    simulation = Simulation(1, Physics(), 1)
    simulation.reset([Morphology()])
    renderer = RobotRenderer(*simulation.drawable(0), SmaSpring(), WIDTH, HEIGHT)
    yield simulation.qpos(0), renderer
    renderer.close()


def drawn(robot, qpos, temperature_c=25.0):
    return robot[1].draw(qpos, np.full(12, temperature_c), "rgb_array").astype(int)


def test_hot_springs_are_redder(robot):
    change = drawn(robot, robot[0], 120.0) - drawn(robot, robot[0], 25.0)
    assert change[..., 0].sum() > 100
    assert change[..., 2].sum() < -100


def test_pose_is_drawn(robot):
    bent = robot[0].copy()
    bent[[9, 12, 15]] = 0.4
    changed = np.abs(drawn(robot, bent) - drawn(robot, robot[0])).max(axis=2) > 10
    assert changed.mean() > 0.02


def test_camera_follows_the_robot(robot):
    far = robot[0].copy()
    far[0] += 3.0  # a whole number of squares of the ground
    assert np.abs(drawn(robot, far) - drawn(robot, robot[0])).mean() < 3


# Environment


def test_rgb_array_is_a_picture_that_changes_even_after_closing():
    env = drawing_env("rgb_array")
    first = env.render()
    env.step(np.tile([-1.0, 1.0], 6))
    second = env.render()
    env.close()
    env.close()
    again = env.render()
    env.close()
    assert is_picture(first)
    assert (first != second).any()
    assert np.abs(again.astype(int) - second).max() < 10


def test_depth_array_measures_distance():
    env = drawing_env("depth_array")
    depth = env.render()
    env.close()
    assert depth.shape == (HEIGHT, WIDTH)
    assert np.isfinite(depth).all()
    assert depth[HEIGHT // 2, WIDTH // 2] < depth[0, 0]  # the robot is nearer than the background


def test_list_holds_a_frame_for_every_control_interval_and_disturbs_nothing():
    env, plain = drawing_env("rgb_array_list"), CaterpillarEnv(gait_period_s=0.5)
    plain.reset(seed=0)
    assert env.metadata["render_fps"] == 10
    assert len(env.render()) == 1  # the start
    action = np.tile([-1.0, 1.0], 6)
    np.testing.assert_array_equal(env.step(action)[0], plain.step(action)[0])
    frames = env.render()
    assert len(frames) == 5  # 0.5 s
    assert all(is_picture(f) for f in frames)
    assert (frames[0] != frames[-1]).any()
    assert env.render() == []
    env.step(action)
    env.reset()
    assert len(env.render()) == 1
    env.close()


def test_frame_rate_is_that_of_steps_in_single_pictures():
    assert CaterpillarEnv(render_mode="rgb_array", gait_period_s=2.0).metadata["render_fps"] == 0.5
    assert CaterpillarEnv.metadata["render_fps"] == 10  # of the class: untouched


def test_new_body_is_drawn():
    env = drawing_env("rgb_array")
    old = env.render()
    env.reset(options={"morphology": SMALL})
    new = env.render()
    shell = env._renderer._model.geom("shell0").size[0]
    env.close()
    assert shell == pytest.approx(0.009)
    assert (new != old).any()


def test_camera_can_be_chosen(robot):
    env = drawing_env("rgb_array", default_camera_config={"distance": 0.5})
    picture = env.render()
    env.close()
    assert is_picture(picture)
    assert np.abs(picture - drawn(robot, robot[0])).mean() > 5


def test_vector_environment_draws_every_row():
    envs = CaterpillarVectorEnv(
        2, render_mode="rgb_array", width=WIDTH, height=HEIGHT, morphology=[Morphology(), SMALL]
    )
    envs.reset(seed=0)
    frames = envs.render()
    envs.reset(options={"morphology": SMALL, "reset_mask": np.array([True, False])})
    again = envs.render()
    envs.close()
    assert len(frames) == 2
    assert all(is_picture(f) for f in frames)
    assert np.abs(frames[0].astype(int) - frames[1]).max() > 50
    assert np.abs(again[0].astype(int) - frames[1]).max() < 10


def test_without_a_mode_nothing_is_drawn():
    env = CaterpillarEnv()
    env.reset(seed=0)
    with pytest.warns(UserWarning, match="render_mode"):
        assert env.render() is None
    assert CaterpillarVectorEnv(2).render() is None


def test_render_needs_a_reset():
    with pytest.raises(SimulationError, match=r"call reset\(\) before render\(\)"):
        CaterpillarEnv(render_mode="rgb_array").render()


def test_window_needs_a_display(monkeypatch):
    monkeypatch.setattr("caterpillar_env.env.has_display", lambda: False)
    with pytest.raises(SimulationError, match='"human" needs a display'):
        CaterpillarEnv(render_mode="human")
    assert "human" not in CaterpillarEnv().metadata["render_modes"]


def test_track_camera_is_the_only_one_and_tracks():
    model, _ = Simulation(1, Physics(), 1).drawable(0)
    assert [model.camera(i).name for i in range(model.ncam)] == ["track"]
    assert model.cam_mode[0] == mujoco.mjtCamLight.mjCAMLIGHT_TRACKCOM
