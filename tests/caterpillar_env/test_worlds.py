import hashlib
import json
from dataclasses import asdict, replace

import gymnasium
import mujoco
import numpy as np
import pytest

import caterpillar_env  # noqa: F401  registers the environments
from caterpillar_env import CaterpillarError, Morphology, Physics
from caterpillar_env.ground import LOADS
from caterpillar_env.model import build_model, model_xml
from caterpillar_env.randomization import Conditions
from caterpillar_env.robot import Robot, simulate, stack
from caterpillar_env.simulation import Simulation
from caterpillar_env.task import Crawl, Failure
from caterpillar_env.validation.robots import evolved_robots
from caterpillar_env.worlds import WORLDS, Flat, Patches, Rough, Slope, Steps, World

EVERY = ["flat", "slope", "slope:direction=across", "steps", "steps:direction=down", "rough", "patches"]
UNEVEN = ["steps", "steps:direction=down,height_m=0.01", "rough", "rough:wavelength_m=0.03,seed=2"]
WEIGHT_N = 4 * 0.008 * 9.81


@pytest.mark.parametrize("text", [*EVERY, "rough:amplitude_m=0.001,wavelength_m=0.1,seed=7"])
def test_text_and_json_give_the_same_world(text):
    world = World.of(text)
    assert World.of(str(world)) == world
    assert World.of(json.loads(json.dumps(asdict(world)))) == world
    assert World.of(world) is world
    assert Physics.of({"world": text}) == Physics(world=world)
    assert Physics.of(json.loads(json.dumps(Physics(world=world).to_dict()))).world == world


def test_worlds_are_flat_by_default():
    assert Physics().world == Flat() == World.of("flat")
    assert str(World.of("slope:angle-deg=10.0, direction=down")) == "slope:direction=down"
    assert set(WORLDS) == {"flat", "slope", "steps", "rough", "patches"}


@pytest.mark.parametrize(
    ("value", "message"),
    [
        ("hill", "kind of world must be one of flat, slope, steps, rough, patches; got 'hill'"),
        ({}, "kind of world must be .* got None"),
        ({"kind": ["slope"]}, "kind of world must be .* got "),
        (World(), "world must be one of flat, slope, steps, rough, patches; got World"),
        (3, "world must be one of flat, slope, steps, rough, patches; got 3"),
        ("slope:tilt=3", "world slope has no tilt; its fields are angle_deg, direction, kind"),
        ("slope:10", "or a kind with fields such as 'slope:angle_deg=5"),
        ("slope:angle_deg=50", "angle_deg = 50 must be a finite number from 0 to 45"),
        ("slope:direction=left", "direction = 'left' must be one of up, down, across"),
        ("steps:height_m=0.02", "height_m = 0.02 must be a finite number from 0.0001 to 0.01"),
        ("rough:amplitude_m=0.01", "amplitude_m = 0.01 must be at most 1/8 of wavelength_m = 0.06"),
        ("rough:seed=1.5", "seed = 1.5 must be an integer"),
        ("patches:least=2", "least = 2 must not exceed greatest = 1"),
    ],
)
def test_errors_name_the_field(value, message):
    with pytest.raises(CaterpillarError, match=message):
        World.of(value)
    with pytest.raises(CaterpillarError, match=message):
        Physics(world=value)


def test_patches_scale_a_friction_that_is_not_zero():
    with pytest.raises(CaterpillarError, match="friction = 0 must be positive in the world patches"):
        Physics(world="patches", friction=0)


def test_a_seed_gives_the_same_world_on_every_machine():
    """The heights and factors are sums and products of random numbers, without rounding differences."""
    digests = [
        hashlib.sha256(array.tobytes()).hexdigest()[:16]
        for array in (Rough(seed=1).height_field.heights_m, Patches(seed=1).factors()[2])
    ]
    assert digests == ["4e22e5a5fd0a02d5", "b4fd2cd76f01a9ea"]
    assert (Rough(seed=1).height_field.heights_m != Rough(seed=2).height_field.heights_m).any()


def test_rough_ground_has_its_amplitude_and_ends_level():
    world = Rough(amplitude_m=0.004, wavelength_m=0.05)
    heights = world.height_field.heights_m
    assert np.abs(heights).max() == pytest.approx(0.004)
    for edge in (heights[0], heights[-1], heights[:, 0], heights[:, -1]):
        assert (edge == 0).all()
    inside = heights[10:-10, 10:-10]
    assert 0.001 < inside.std() < 0.002
    assert abs(inside.mean()) < 0.0005


@pytest.mark.parametrize("text", UNEVEN)
def test_surface_matches_the_model(text):
    """Downward rays in MuJoCo end at the heights of `surface`, and its normals match the slope."""
    world = World.of(text)
    model = build_model(Morphology(), Physics(world=world))
    data = mujoco.MjData(model)
    data.qpos[0] = 3.0  # out of the way
    mujoco.mj_kinematics(model, data)
    rng = np.random.default_rng(0)
    x, y = rng.uniform(-0.7, 1.3, 400), rng.uniform(-0.4, 0.4, 400)
    heights, normals = world.surface(x, y)
    hit = np.zeros(1, dtype=np.int32)
    ends = [
        1.0 - mujoco.mj_ray(model, data, np.array([a, b, 1.0]), np.array([0, 0, -1.0]), None, 1, -1, hit)
        for a, b in zip(x, y, strict=True)
    ]
    # Height fields consist of triangles; `surface` is bilinear.
    np.testing.assert_allclose(ends, heights, atol=1e-9 if isinstance(world, Steps) else 5e-4)
    assert np.ptp(heights) > 0.003
    np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1.0)
    if isinstance(world, Rough):
        step = 1e-7
        rise = [(world.surface(x + dx, y + dy)[0] - heights) / step for dx, dy in ((step, 0), (0, step))]
        np.testing.assert_allclose(-normals[:, :2].T / normals[:, 2], rise, atol=1e-4)


@pytest.mark.parametrize("text", EVERY)
def test_robots_start_on_the_ground_and_stay_on_it(text):
    physics = Physics(world=text)
    bodies = [Morphology(), Morphology(segment_length_m=0.03, segment_radius_m=0.01)]
    crawl = Crawl(bodies, physics, 1)
    np.testing.assert_allclose(crawl.simulation.pose().clearance_m, -1e-9, atol=1e-15)
    crawl.reset(offset=np.full((2, 11), 0.02), heading_rad=0.3)
    np.testing.assert_allclose(crawl.simulation.pose().clearance_m, -1e-9, atol=1e-15)
    crawl.reset()
    start = crawl.simulation.pose().com_m
    crawl.run(np.zeros((2, 300, 12)))
    assert (crawl.failure == Failure.NONE).all()
    pose = crawl.simulation.pose()
    assert np.abs(pose.com_m - start).max() < 0.006  # it settles between bumps
    assert (np.abs(pose.clearance_m) < 2e-4).all()


@pytest.mark.parametrize("text", ["flat", *UNEVEN, "patches"])
def test_feet_bear_the_weight(text):
    simulation = Simulation([Morphology()], Physics(world=text), 1)
    model, data = simulation.models[0], simulation.data(0)
    mujoco.mj_step(model, data, nstep=1200)
    feet_n, skin_n = data.sensordata[LOADS]
    assert feet_n == pytest.approx(WEIGHT_N, rel=3e-3)
    assert skin_n == 0.0


def test_failures_refer_to_the_local_ground():
    physics = Physics(world=Steps(height_m=0.01, spacing_m=0.2))
    crawl = Crawl([Morphology()] * 2, physics, 1)
    qpos = np.stack([crawl.simulation.qpos(row) for row in range(2)])
    qpos[:, 0] = 1.01  # on the fifth step
    crawl.simulation.place(qpos)
    assert crawl.simulation.qpos(0)[2] == pytest.approx(qpos[0, 2] + 0.05, abs=1e-6)
    crawl.simulation._qpos[1, 2] += 0.12
    crawl.run(np.zeros((2, 10, 12)))
    assert crawl.failure.tolist() == [Failure.NONE, Failure.JUMPED]


def test_slope_across_is_uphill_on_the_left():
    across = Physics(world=Slope(angle_deg=30.0, direction="across"))
    gravity = build_model(Morphology(), across).opt.gravity
    np.testing.assert_allclose(gravity, [0, -9.81 / 2, -9.81 * np.sqrt(0.75)], atol=1e-12)


def test_slopes_tilt_gravity_and_cameras():
    down = Physics(world=Slope(angle_deg=30.0, direction="down"))
    model = build_model(Morphology(), down)
    np.testing.assert_allclose(model.opt.gravity, [9.81 / 2, 0, -9.81 * np.sqrt(0.75)])
    flat = build_model(Morphology(), Physics())
    np.testing.assert_array_equal(model.geom_pos, flat.geom_pos)
    turned = np.linalg.inv(flat.cam_mat0.reshape(-1, 3, 3)) @ model.cam_mat0.reshape(-1, 3, 3)
    for view, level in zip(
        model.cam_mat0.reshape(-1, 3, 3), flat.cam_mat0.reshape(-1, 3, 3), strict=True
    ):
        gravity, vertical = view.T @ model.opt.gravity, level.T @ flat.opt.gravity
        np.testing.assert_allclose(gravity, vertical, atol=1e-6)  # as seen by the camera
    assert not np.allclose(turned, np.eye(3))


def test_robots_slide_on_slippery_tiles_only():
    """A slope cannot be combined with tiles, so gravity is tilted by hand."""
    moved = []
    for factor in (0.2, 1.0):
        simulation = Simulation([Morphology()], Physics(world=Patches(least=factor, greatest=factor)), 1)
        model, data = simulation.models[0], simulation.data(0)
        mujoco.mj_step(model, data, nstep=200)
        start_m = data.qpos[0]
        model.opt.gravity[:] = [-9.81 * np.sin(0.4), 0, -9.81 * np.cos(0.4)]  # tan 0.4 = 0.42
        mujoco.mj_step(model, data, nstep=200)
        moved.append(start_m - data.qpos[0])
    assert moved[0] > 0.1
    assert abs(moved[1]) < 0.01


def test_sampled_friction_scales_tiles():
    physics = Physics(world="patches")
    simulation = Simulation([Morphology()], physics, 1)
    before = simulation.models[0].geom_friction[:, 0].copy()
    strengths = tuple(physics.strengths().tolist())
    simulation.reset(conditions=[Conditions(0.4, strengths, 1.0, 25.0)])
    after = simulation.models[0].geom_friction[:, 0]
    tiles = simulation.models[0].geom_priority == 2
    np.testing.assert_allclose(after[tiles], before[tiles] / 2)
    assert (after[~tiles] == 0.4).all()
    assert np.ptp(after[tiles]) > 0.2


@pytest.mark.parametrize("text", ["slope", "rough", "patches"])
def test_results_do_not_depend_on_other_rows_or_threads(text):
    bodies, timings = stack(evolved_robots(3))
    physics = Physics(world=text)
    together = simulate(bodies, timings, physics, threads=2, duration_s=2.0)
    alone = simulate(bodies[1:2], timings[1:2], physics, threads=1, duration_s=2.0)
    for one, all_ in zip(alone, together, strict=True):
        assert one[0] == all_[1]
    flat = simulate(bodies, timings, Physics(), threads=1, duration_s=2.0)
    assert (flat.distance_m != together.distance_m).all()


def test_robots_keep_their_world_in_json():
    robot = replace(evolved_robots(1)[0], physics=Physics(world="rough:seed=4"))
    data = json.loads(json.dumps(robot.to_dict()))
    assert Robot.from_dict(data).physics.world == Rough(seed=4)
    del data["physics"]["world"]  # as written by earlier versions
    assert Robot.from_dict(data).physics.world == Flat()


@pytest.mark.parametrize("text", ["steps", "rough", "patches"])
def test_models_in_mjcf_have_the_ground(text):
    physics = Physics(world=text)
    model = build_model(Morphology(), physics)
    again = mujoco.MjModel.from_xml_string(model_xml(Morphology(), physics))
    for name in ("geom_type", "geom_pos", "geom_size", "geom_friction", "hfield_data"):
        np.testing.assert_array_equal(getattr(again, name), getattr(model, name))


def test_environments_take_a_world():
    env = gymnasium.make("CaterpillarSMA-v0", world="steps:height_m=0.004")
    assert env.unwrapped.crawl.physics.world == Steps(height_m=0.004)
    envs = gymnasium.make_vec(
        "CaterpillarSMA-v0", 2, world={"kind": "rough"}, physics={"friction": 0.5}, threads=1
    )
    assert envs.unwrapped.crawl.physics == Physics(friction=0.5, world=Rough())
    first, _ = envs.reset(seed=1)
    single = gymnasium.make("CaterpillarSMA-v0", world="rough", physics={"friction": 0.5})
    np.testing.assert_array_equal(single.reset(seed=1)[0], first[0])
    with pytest.raises(CaterpillarError, match="kind of world"):
        gymnasium.make("CaterpillarSMA-v0", world="moon")


@pytest.mark.parametrize("name", ["Slope", "Steps", "Rough", "Patches"])
def test_worlds_have_ids(name):
    for mode in ("", "Switch"):
        env = gymnasium.make(f"CaterpillarSMA{mode}-{name}-v0")
        assert env.unwrapped.crawl.physics.world == World.of(name.lower())
        assert isinstance(env.action_space, gymnasium.spaces.MultiBinary) == bool(mode)
    envs = gymnasium.make_vec(f"CaterpillarSMA-{name}-v0", 2, threads=1)
    assert str(envs.unwrapped.crawl.physics.world) == name.lower()


def test_observed_height_is_above_the_local_ground():
    env = gymnasium.make("CaterpillarSMA-v0", world="steps:height_m=0.01,spacing_m=0.5")
    observation, _ = env.reset(seed=0)
    unwrapped = env.unwrapped
    place = unwrapped.observation_names.index("height")
    qpos = unwrapped.crawl.simulation.qpos(0)
    qpos[0] = 0.9
    unwrapped.crawl.simulation.place(qpos[None])
    assert unwrapped.crawl.simulation.pose().com_m[0, 2] == pytest.approx(0.044, abs=1e-3)
    moved = unwrapped.step(unwrapped.action_space.sample() * 0)[0]
    assert moved[place] == pytest.approx(observation[place], abs=0.2)
