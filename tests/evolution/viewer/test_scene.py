"""The scene shows the robot in the pose that MuJoCo computes."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from caterpillar_env.drawing.overlay import spring_rgb
from caterpillar_env.model import build_model
from caterpillar_env.physics import Physics
from caterpillar_env.robot import wave_robot
from evolution.viewer.session import Session

pytest.importorskip("viser")

from evolution.viewer.scene import RobotScene


@pytest.fixture
def crawling():
    session = Session(wave_robot())
    for _ in range(20):
        session.advance()
    return session


def draw_at_start(scene, robot):
    scene.draw(robot, *Session(robot).pose(0.0))


def node(client, name):
    return client.scene._handle_from_node_name[name]


def test_elements_springs_and_colours_match_the_model(client, crawling):
    scene = RobotScene(client.scene)
    qpos, temperature_c = crawling.pose(crawling.time_s)
    scene.draw(crawling.robot, qpos, temperature_c)
    physics = crawling.robot.physics
    model = build_model(crawling.robot.morphology, physics)
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    for body in range(1, model.nbody):
        element = node(client, f"/world/robot/{model.body(body).name}")
        np.testing.assert_allclose(element.position, data.xpos[body], atol=1e-12)
        np.testing.assert_allclose(element.wxyz, data.xquat[body], atol=1e-12)
    springs = node(client, "/world/robot/springs")
    lengths_m = np.linalg.norm(springs.points[:, 1] - springs.points[:, 0], axis=1)
    np.testing.assert_allclose(lengths_m, data.ten_length, atol=1e-7)
    colours = spring_rgb(physics.spring, temperature_c)
    np.testing.assert_allclose(springs.colors[:, 0] / 255, colours, atol=1 / 255)
    assert len(np.unique(springs.colors[:, 0], axis=0)) > 2


def test_all_geoms_of_the_robot_have_their_sizes(client):
    robot = replace(wave_robot(), physics=Physics(num_segments=4))
    scene = RobotScene(client.scene)
    draw_at_start(scene, robot)
    model = build_model(robot.morphology, robot.physics)
    drawn = 0
    for geom in np.flatnonzero(model.geom_bodyid):  # the others are the ground and its ruler
        name = f"/world/robot/{model.body(model.geom_bodyid[geom]).name}/geom{geom}"
        size = model.geom_size[geom]
        if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
            assert (node(client, name).radius, node(client, name).scale) == (1.0, tuple(size))
        else:
            assert node(client, name).radius == pytest.approx(size[0])
        drawn += 1
    assert drawn == 8 + 8 + 8  # shells, feet, legs


def test_the_ground_moves_instead_of_the_robot(client, crawling):
    scene = RobotScene(client.scene)
    qpos, temperature_c = crawling.pose(crawling.time_s)
    moved = qpos + np.r_[0.5, 0.25, np.zeros(len(qpos) - 2)]
    scene.draw(crawling.robot, qpos, temperature_c)
    before = np.array(node(client, "/world").position)
    scene.draw(crawling.robot, moved, temperature_c)
    np.testing.assert_allclose(node(client, "/world").position - before, [-0.5, -0.25, 0], atol=1e-12)


def test_a_non_finite_pose_is_skipped(client, crawling):
    scene = RobotScene(client.scene)
    qpos, temperature_c = crawling.pose(crawling.time_s)
    scene.draw(crawling.robot, qpos, temperature_c)
    before = np.array(node(client, "/world/robot/element0").position)
    scene.draw(crawling.robot, np.full_like(qpos, np.nan), temperature_c)
    np.testing.assert_array_equal(node(client, "/world/robot/element0").position, before)


def test_a_new_body_replaces_the_previous_one(client):
    robot = wave_robot()
    scene = RobotScene(client.scene)
    draw_at_start(scene, robot)
    wide = replace(robot, morphology=replace(robot.morphology, segment_radius_m=0.015))
    draw_at_start(scene, wide)
    model = build_model(wide.morphology, wide.physics)
    shell = model.geom("shell0").id
    assert node(client, f"/world/robot/element0/geom{shell}").scale[1:] == (0.015, 0.015)


@pytest.mark.parametrize("world", ["steps", "rough"])
def test_uneven_ground_is_a_mesh(client, world):
    robot = replace(wave_robot(), physics=Physics(world=world))
    scene = RobotScene(client.scene)
    draw_at_start(scene, wave_robot())
    draw_at_start(scene, robot)
    mesh = node(client, "/world/ground")
    x, y, z = mesh.vertices.astype(float).T
    np.testing.assert_allclose(z, robot.physics.world.surface(x + 1e-6, y)[0], atol=1e-4)
    assert np.ptp(z) > 0.004
    assert mesh.faces.max() == len(x) - 1


def test_a_slope_is_inclined(client):
    robot = replace(wave_robot(), physics=Physics(world="slope:angle_deg=30"))
    draw_at_start(RobotScene(client.scene), robot)
    half = np.radians(15)
    wxyz = node(client, "/world").wxyz  # forward is up, so the rotation about y is negative
    np.testing.assert_allclose(wxyz, [np.cos(half), 0, -np.sin(half), 0], atol=1e-12)
