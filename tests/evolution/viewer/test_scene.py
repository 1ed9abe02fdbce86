"""The scene shows the robot in the pose that MuJoCo computes."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from caterpillar_env.drawing.overlay import spring_rgb
from caterpillar_env.model import build_model
from caterpillar_env.physics import Physics
from evolution.viewer.session import Session, nominal_robot

pytest.importorskip("viser")

from evolution.viewer.scene import RobotScene


@pytest.fixture
def crawling():
    session = Session(nominal_robot())
    for _ in range(20):
        session.advance()
    return session


def draw_at_start(scene, robot):
    scene.draw(robot, *Session(robot).pose(0.0), follow=True)


def node(page, name):
    return page.scene._handle_from_node_name[name]


def test_elements_springs_and_colours_match_the_model(page, crawling):
    scene = RobotScene(page.scene)
    qpos, temperature_c = crawling.pose(crawling.time_s)
    scene.draw(crawling.robot, qpos, temperature_c, follow=False)
    physics = crawling.robot.physics
    model = build_model(crawling.robot.morphology, physics)
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    mujoco.mj_forward(model, data)
    for body in range(1, model.nbody):
        element = node(page, f"/world/robot/{model.body(body).name}")
        np.testing.assert_allclose(element.position, data.xpos[body], atol=1e-12)
        np.testing.assert_allclose(element.wxyz, data.xquat[body], atol=1e-12)
    springs = node(page, "/world/robot/springs")
    lengths_m = np.linalg.norm(springs.points[:, 1] - springs.points[:, 0], axis=1)
    np.testing.assert_allclose(lengths_m, data.ten_length, atol=1e-7)
    colours = spring_rgb(physics.spring, temperature_c)
    np.testing.assert_allclose(springs.colors[:, 0] / 255, colours, atol=1 / 255)
    assert len(np.unique(springs.colors[:, 0], axis=0)) > 2


def test_all_geoms_of_the_robot_have_their_sizes(page):
    robot = replace(nominal_robot(), physics=Physics(num_segments=4))
    scene = RobotScene(page.scene)
    draw_at_start(scene, robot)
    model = build_model(robot.morphology, robot.physics)
    drawn = 0
    for geom in np.flatnonzero(model.geom_bodyid):  # the others are the ground and its ruler
        name = f"/world/robot/{model.body(model.geom_bodyid[geom]).name}/geom{geom}"
        size = model.geom_size[geom]
        if model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_ELLIPSOID:
            assert (node(page, name).radius, node(page, name).scale) == (1.0, tuple(size))
        else:
            assert node(page, name).radius == pytest.approx(size[0])
        drawn += 1
    assert drawn == 8 + 8 + 8  # shells, feet, legs


def test_following_moves_the_ground_instead_of_the_robot(page, crawling):
    scene = RobotScene(page.scene)
    qpos, temperature_c = crawling.pose(crawling.time_s)
    moved = qpos + np.r_[0.5, 0.25, np.zeros(len(qpos) - 2)]
    scene.draw(crawling.robot, qpos, temperature_c, follow=True)
    before = np.array(node(page, "/world").position)
    scene.draw(crawling.robot, moved, temperature_c, follow=True)
    np.testing.assert_allclose(node(page, "/world").position - before, [-0.5, -0.25, 0], atol=1e-12)
    scene.draw(crawling.robot, moved, temperature_c, follow=False)
    np.testing.assert_array_equal(node(page, "/world").position, 0)


def test_a_non_finite_pose_is_skipped(page, crawling):
    scene = RobotScene(page.scene)
    qpos, temperature_c = crawling.pose(crawling.time_s)
    scene.draw(crawling.robot, qpos, temperature_c, follow=False)
    before = np.array(node(page, "/world/robot/element0").position)
    scene.draw(crawling.robot, np.full_like(qpos, np.nan), temperature_c, follow=False)
    np.testing.assert_array_equal(node(page, "/world/robot/element0").position, before)


def test_a_new_body_replaces_the_previous_one(page):
    robot = nominal_robot()
    scene = RobotScene(page.scene)
    draw_at_start(scene, robot)
    wide = replace(robot, morphology=replace(robot.morphology, segment_radius_m=0.015))
    draw_at_start(scene, wide)
    model = build_model(wide.morphology, wide.physics)
    shell = model.geom("shell0").id
    assert node(page, f"/world/robot/element0/geom{shell}").scale[1:] == (0.015, 0.015)
