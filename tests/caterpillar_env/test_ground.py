import math

import mujoco
import numpy as np
import pytest

from caterpillar_env import Morphology, Physics
from caterpillar_env.ground import LOADS, clearances_m, condim, half_axes_m, touching_geoms
from caterpillar_env.model import build_model
from caterpillar_env.simulation import Simulation
from caterpillar_env.worlds import Flat, Rough

WEIGHT_N = 4 * 0.008 * 9.81


def turned(angle_rad):
    """Return the row-major matrix of a rotation about y."""
    cosine, sine = math.cos(angle_rad), math.sin(angle_rad)
    return np.array([cosine, 0, sine, 0, 1, 0, -sine, 0, cosine])


@pytest.mark.parametrize(
    ("angle_rad", "reach_m"),
    [(0.0, 3.0), (math.pi / 2, 1.0), (math.pi / 4, math.sqrt((1 + 9) / 2))],
)
def test_lowest_point_of_a_tilted_ellipsoid(angle_rad, reach_m):
    low = clearances_m(Flat(), np.array([0.0, 0.0, 5.0]), turned(angle_rad), np.array([1.0, 2.0, 3.0]))
    assert low == pytest.approx(5.0 - reach_m)


def test_sphere_lowered_by_its_clearance_touches_the_tangent_plane_of_rough_ground():
    world, radius_m = Rough(amplitude_m=0.01, wavelength_m=0.1), 0.01
    x = np.linspace(0.0, 0.5, 100)
    centres = np.stack([x, 0.3 * x, np.full(100, 0.05)], axis=-1)
    clearance_m = clearances_m(world, centres, turned(0.0), np.full(3, radius_m))
    heights, normals = world.surface(x, 0.3 * x)
    assert normals[:, 2].min() < 0.99
    touching = centres[:, 2] - clearance_m - heights  # height of the centre above the plane
    assert touching * normals[:, 2] == pytest.approx(radius_m)


def test_only_feet_and_shells_touch_the_ground():
    model = build_model(Morphology(), Physics())
    names = [model.geom(int(i)).name for i in touching_geoms(model)]
    assert sorted(names) == sorted(
        [f"shell{i}" for i in range(8)]
        + [f"foot{i}_{side}" for i in range(4) for side in ("left", "right")]
    )
    feet = [name.startswith("foot") for name in names]
    assert (half_axes_m(model)[feet] == 0.002).all()


def test_without_scenery_the_geoms_of_the_robot_follow_each_other():
    """`Simulation` reads the geoms of the robot as one range."""
    geoms = touching_geoms(build_model(Morphology(), Physics(), scenery=False))
    np.testing.assert_array_equal(geoms, np.arange(geoms[0], geoms[0] + 16))


def test_feet_bear_the_weight_of_a_straight_robot():
    model = build_model(Morphology(), Physics())
    data = mujoco.MjData(model)
    mujoco.mj_step(model, data, nstep=1000)
    feet_n, skin_n = data.sensordata[LOADS]
    assert feet_n == pytest.approx(WEIGHT_N, rel=1e-3)
    assert skin_n == 0.0


def test_skin_bears_a_robot_that_lies_on_its_back():
    simulation = Simulation([Morphology()], Physics(), 1)
    pose = simulation.qpos(0)
    pose[2:7] = [0.013, 0.0, 1.0, 0.0, 0.0]
    simulation.place(pose[None])
    for _ in range(20):  # intervals; the load is the mean over the last one
        simulation.advance(simulation.heat(np.zeros((1, 10, 12))))
    feet_n, skin_n = simulation.pose().load_n[0]
    assert skin_n == pytest.approx(WEIGHT_N, rel=0.02)
    assert feet_n == 0.0


def test_without_friction_no_force_is_horizontal():
    assert condim(0.8) == 3
    assert condim(0.0) == 1
    model = build_model(Morphology(), Physics(friction=0.0))
    data = mujoco.MjData(model)
    data.qvel[0] = 0.1
    mujoco.mj_step(model, data, nstep=200)
    assert data.qvel[0] == pytest.approx(0.1, rel=1e-3)
