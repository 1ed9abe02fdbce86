import itertools
import math
from dataclasses import replace
from typing import get_args

import mujoco
import numpy as np
import pytest

from caterpillar_env import Morphology, Physics, SmaSpring
from caterpillar_env.drawing.scenery import Camera
from caterpillar_env.errors import CaterpillarError
from caterpillar_env.gait import spring_names
from caterpillar_env.ground import STANCE_M
from caterpillar_env.model import ModelBuilder, build_model, joint_names, model_xml
from caterpillar_env.sma import spring_force

BODY = Morphology(
    leg_separation_m=0.02,
    segment_length_m=0.026,
    segment_radius_m=0.010,
    segment_mass_kg=0.005,
    joint_limit_rad=0.35,
    attachment_x_m=0.004,
    attachment_y_m=0.007,
    attachment_z_m=0.005,
)


def built(morphology=BODY, **physics):
    """Return a model and its data at the start."""
    model = build_model(morphology, Physics(**physics))
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    return model, data


def step(model, data, seconds):
    for _ in range(round(seconds / model.opt.timestep)):
        mujoco.mj_step(model, data)
    mujoco.mj_forward(model, data)


# Springs


@pytest.mark.parametrize("num_segments", [2, 4, 7])
def test_trimmed_spring_jacobians_are_the_derivatives_of_the_lengths(num_segments):
    # Trimming may drop only the columns that are zero in every pose.
    model, data = built(num_segments=num_segments)
    rng = np.random.default_rng(5)
    mujoco.mj_integratePos(model, data.qpos, rng.normal(size=model.nv), 0.2)
    mujoco.mj_forward(model, data)
    pose, nudge_m = data.qpos.copy(), 1e-6
    jacobian = np.zeros((model.ntendon, model.nv))
    mujoco.mju_sparse2dense(
        jacobian, data.ten_J, model.ten_J_rownnz, model.ten_J_rowadr, model.ten_J_colind
    )
    expected = np.empty_like(jacobian)
    for dof in range(model.nv):
        lengths = []
        for sign in (1, -1):
            data.qpos[:] = pose
            mujoco.mj_integratePos(model, data.qpos, np.eye(model.nv)[dof], sign * nudge_m)
            mujoco.mj_forward(model, data)
            lengths.append(data.ten_length.copy())
        expected[:, dof] = (lengths[0] - lengths[1]) / (2 * nudge_m)
    assert np.abs(expected).max() > 0.5
    assert jacobian == pytest.approx(expected, abs=1e-8)
    assert (model.ten_J_rownnz == 3).all()  # axial, bend and neck between neighbouring feet


# Body


@pytest.mark.parametrize("segments", [2, 3, 4, 6])
def test_sizes_follow_from_the_number_of_segments(segments):
    model, _ = built(num_segments=segments)
    assert model.nv == 6 + 3 * segments - 1
    assert model.nq == 7 + 3 * segments - 1
    assert model.nu == model.ntendon == 4 * (segments - 1)
    assert model.nbody == 1 + 2 * segments
    assert model.body_mass.sum() == pytest.approx(segments * 0.005)


def test_sizes_do_not_depend_on_the_body():
    one, other = built()[0], built(Morphology())[0]
    for size in ("nq", "nv", "nu", "nbody", "ngeom", "nsite", "ntendon", "nsensor"):
        assert getattr(one, size) == getattr(other, size)


def test_body_starts_straight_with_its_centre_of_mass_two_radii_up():
    _, data = built()
    centres = data.xpos[1:]
    np.testing.assert_allclose(centres[:, 2], 0.020)
    np.testing.assert_allclose(centres[:, 0], -0.013 * np.arange(8), atol=1e-12)
    np.testing.assert_allclose(data.subtree_com[1], [-0.013 * 3.5, 0, 0.020], atol=1e-12)


def test_feet_touch_the_ground_at_the_leg_separation():
    model, data = built()
    for segment in range(4):
        for side, sign in (("left", 1), ("right", -1)):
            foot = data.geom(f"foot{segment}_{side}")
            lowest = foot.xpos[2] - model.geom(f"foot{segment}_{side}").size[0]
            assert lowest == pytest.approx(-STANCE_M, abs=1e-12)
            assert foot.xpos[1] == pytest.approx(sign * 0.01)
            assert foot.xpos[0] == pytest.approx(-0.026 * segment)


def test_joints_are_listed_in_the_order_of_the_model():
    model, _ = built(num_segments=3)
    assert [model.joint(i).name for i in range(1, model.njnt)] == joint_names(3)
    assert joint_names(2) == ["axial0", "bend0", "neck0", "axial1", "bend1"]


def test_hinge_range_is_the_joint_limit():
    model, _ = built()
    for name in joint_names(4):
        limit = 0.15 * 0.026 if name.startswith("axial") else 0.35
        assert model.joint(name).limited
        np.testing.assert_allclose(model.joint(name).range, [-limit, limit])


def test_hinges_stiffen_towards_their_limit():
    model, _ = built(neck_stiffening=5.0, neck_stiffness_n_m_rad=6e-3)
    neck = model.joint("neck1").id
    linear, square = model.jnt_stiffness[neck], model.jnt_stiffnesspoly[neck]
    moment = linear * 0.35 + square[0] * 0.35**2 + square[1] * 0.35**3
    assert moment == pytest.approx(6 * 6e-3 * 0.35)  # six times the linear one at the limit
    assert square[0] == 0  # symmetric


def test_joint_stops_are_hard_for_any_ground():
    model, _ = built(contact_time_constant_s=0.05, stop_time_constant_s=0.003)
    assert (model.jnt_solref[1:, 0] == 0.003).all()
    assert (model.geom_solref[model.geom_conaffinity > 0, 0] == 0.05).all()


@pytest.mark.parametrize("seed", range(5))
def test_neighbouring_elements_meet_in_one_point(seed):
    model, data = built(Morphology.from_unit(np.random.default_rng(seed).random(8)))
    for i in range(7):
        first, second = (model.geom(f"shell{k}").id for k in (i, i + 1))
        apart = mujoco.mj_geomDistance(model, data, first, second, 0.01, None)
        assert apart == pytest.approx(0, abs=1e-5)


def test_inertia_is_that_of_a_solid_ellipsoid():
    model, _ = built()
    a, r, mass = 0.026 / 4, 0.010, 0.0025
    expected = mass / 5 * np.array([2 * r * r, a * a + r * r, a * a + r * r])
    assert np.sort(model.body("element2").inertia) == pytest.approx(np.sort(expected))


@pytest.mark.parametrize(("axis", "direction"), [("yaw", [0, 0, 1]), ("pitch", [0, 1, 0])])
def test_bend_axis_is_selectable_and_necks_pitch(axis, direction):
    model, _ = built(bend_axis=axis)
    assert model.joint("bend1").axis.tolist() == direction
    assert model.joint("neck1").axis.tolist() == [0, 1, 0]


@pytest.mark.parametrize("joint", ["neck1", "bend1", "axial1"])
def test_joint_deflects_by_load_over_stiffness(joint):
    """Check static deflection in free space, without spring forces."""
    model, data = built(spring_strengths=[1e-9] * 12, neck_stiffening=0.0)
    model.opt.gravity[:] = 0
    data.qpos[2] = 1.0
    rest = {"axial1": 4 * 14.5 * (0.026 + 0.008 - 0.0222) / 500}.get(joint, 0.0)  # neutral point
    load, stiffness = {"neck1": (1e-3, 6e-3), "bend1": (1e-3, 12e-3), "axial1": (-0.5, 500)}[joint]
    data.qfrc_applied[model.joint(joint).dofadr[0]] = load
    step(model, data, 4.0)
    assert data.joint(joint).qpos[0] == pytest.approx(rest + load / stiffness, rel=1e-4)


def test_cold_springs_compress_the_body_just_to_its_length():
    model, data = built(mismatch_std=0.0)
    model.opt.gravity[:] = 0
    data.qpos[2] = 1.0
    step(model, data, 3.0)
    np.testing.assert_allclose(data.qpos[7:], 0, atol=1e-5)


# Motion


def test_springs_do_not_affect_free_fall():
    model, data = built(timestep_s=2e-4)
    data.qpos[2], data.ctrl[:] = 1.0, np.linspace(0, 1, 12)
    mujoco.mj_forward(model, data)
    before = data.subtree_com[1].copy()
    step(model, data, 0.1)
    assert np.abs(data.qpos[7:]).max() > 0.15
    np.testing.assert_allclose(data.subtree_com[1] - before, [0, 0, -9.81 * 0.1**2 / 2], atol=1.5e-4)


@pytest.mark.parametrize("share", [0.7, 1.3])
def test_feet_stick_below_the_friction_angle_and_slide_above(share):
    friction = 0.4
    # The robot is stiff and damped, so it acts like a block on a slope.
    model, data = built(friction=friction, neck_stiffness_n_m_rad=1.0, neck_damping_n_m_s_rad=0.01)
    step(model, data, 0.5)
    before = data.subtree_com[1, 0]
    slope = math.atan(share * friction)
    model.opt.gravity[:] = 9.81 * np.array([math.sin(slope), 0, -math.cos(slope)])
    step(model, data, 0.5)
    slid = 9.81 * (math.sin(slope) - friction * math.cos(slope)) * 0.5**2 / 2
    if slid < 0:
        assert abs(data.subtree_com[1, 0] - before) < 0.0005
    else:
        assert data.subtree_com[1, 0] - before == pytest.approx(slid, rel=0.02)


@pytest.mark.parametrize(("height", "sign"), [("dorsal", 1), ("ventral", -1)])
def test_hot_springs_bend_their_own_gap_towards_their_side(height, sign):
    model, data = built(mismatch_std=0.0)
    model.opt.gravity[:] = 0
    data.qpos[2] = 1.0
    for side in ("left", "right"):
        data.ctrl[model.actuator(f"gap2_{height}_{side}").id] = 1.0
    step(model, data, 2.0)
    necks = [data.joint(f"neck{g}").qpos[0] for g in range(3)]
    assert sign * necks[1] > 0.2  # pitch is positive when the tail goes up
    assert max(abs(necks[0]), abs(necks[2])) < 0.02


def test_spring_on_one_side_turns_the_robot_to_that_side():
    model, data = built(mismatch_std=0.0)
    model.opt.gravity[:] = 0
    data.qpos[2] = 1.0
    for height in ("dorsal", "ventral"):
        data.ctrl[model.actuator(f"gap2_{height}_left").id] = 1.0
    step(model, data, 2.0)
    # The left side shortens: seen from the tail, the head turns left.
    head, tail = data.xmat[1].reshape(3, 3)[:, 0], data.xmat[8].reshape(3, 3)[:, 0]
    assert np.cross(tail, head)[2] > 0.05


@pytest.mark.parametrize("face", ["back", "side"])
def test_fallen_body_lies_on_the_ground(face):
    model, data = built()
    data.qpos[3:7] = [0, 1, 0, 0] if face == "back" else [math.sqrt(0.5), math.sqrt(0.5), 0, 0]
    data.qpos[2] = 0.015
    step(model, data, 1.0)
    assert data.xpos[1:, 2].min() > 0.008
    assert data.xpos[1:, 2].max() < 0.016


# Springs


def test_springs_have_the_names_of_the_gait():
    model, _ = built(num_segments=3)
    assert [model.actuator(i).name for i in range(model.nu)] == spring_names(3)
    assert [model.tendon(i).name for i in range(model.nu)] == spring_names(3)


def test_springs_run_between_their_anchors():
    model, data = built()
    np.testing.assert_allclose(data.ten_length, 0.026 + 2 * 0.004)  # L + 2x
    for gap in (1, 2, 3):
        for height, up in (("dorsal", 1), ("ventral", -1)):
            for side, left in (("left", 1), ("right", -1)):
                first = model.tendon_adr[model.tendon(f"gap{gap}_{height}_{side}").id]
                ends = data.site_xpos[model.wrap_objid[first : first + 2]]
                np.testing.assert_allclose(ends[:, 1], left * 0.005)
                np.testing.assert_allclose(ends[:, 2], 0.020 + up * 0.007)
                expected = [-0.026 * (gap - 1) + 0.004, -0.026 * gap - 0.004]
                np.testing.assert_allclose(ends[:, 0], expected, atol=1e-12)


@pytest.mark.parametrize(
    "spring",
    [
        SmaSpring(),
        SmaSpring(austenite_rest_length_m=0.030, martensite_rest_length_m=0.036),  # goes slack
        SmaSpring(force_limit_n=0.3),  # is capped
    ],
    ids=["default", "slack", "capped"],
)
def test_actuator_force_is_that_of_the_two_state_spring(spring):
    model, data = built(spring=spring)
    strengths = Physics().strengths()
    rng = np.random.default_rng(0)
    forces = []
    for fraction in (0.0, 0.25, 0.5, 1.0):
        for _ in range(5):
            data.qpos[7:] = rng.uniform(-1, 1, model.nq - 7) * model.jnt_range[1:, 1]
            data.ctrl[:] = fraction
            mujoco.mj_forward(model, data)
            expected = -strengths * spring_force(spring, data.ten_length, np.full(12, fraction))
            np.testing.assert_allclose(data.actuator_force, expected, atol=1e-12)
            forces.append(data.actuator_force.copy())
    assert np.ptp(forces) > 0.1


# A body for every segment


def test_identical_segments_give_the_model_of_one_morphology():
    one, _ = built(BODY)
    four, _ = built((BODY,) * 4)
    for name in ("body_pos", "body_mass", "body_inertia", "geom_size", "geom_pos", "jnt_pos",
                 "jnt_range", "site_pos", "qpos_spring", "tendon_length0"):  # fmt: skip
        np.testing.assert_array_equal(getattr(one, name), getattr(four, name))


def test_every_segment_uses_its_own_morphology():
    rng = np.random.default_rng(4)
    body = tuple(Morphology.from_unit(unit) for unit in rng.random((3, 8)))
    model, data = built(body, num_segments=3)
    for number, segment in enumerate(body):
        elements = [model.body(f"element{2 * number + part}") for part in (0, 1)]
        assert sum(e.mass[0] for e in elements) == pytest.approx(segment.segment_mass_kg)
        long, high = segment.segment_length_m / 4, segment.segment_radius_m
        assert model.geom(f"shell{2 * number}").size.tolist() == [long, high, high]
        left, right = (data.geom(f"foot{number}_{side}").xpos for side in ("left", "right"))
        assert left[1] - right[1] == pytest.approx(segment.leg_separation_m)
        # All segments of the straight robot stand on their feet, with the axis 2R above the ground.
        assert left[2] == pytest.approx(0.002)
        assert data.body(f"element{2 * number}").xpos[2] == pytest.approx(2 * segment.segment_radius_m)
        first, second = (data.body(e.name).xpos for e in elements)
        assert first[0] - second[0] == pytest.approx(segment.segment_length_m / 2)
        assert model.joint(f"bend{number}").range[1] == segment.joint_limit_rad
    for gap, (ahead, behind) in enumerate(itertools.pairwise(body)):
        neck = data.joint(f"neck{gap}").xanchor
        middle = (data.body(f"element{2 * gap + 1}").xpos + data.body(f"element{2 * gap + 2}").xpos) / 2
        assert neck[2] == pytest.approx(middle[2])
        limit = (ahead.joint_limit_rad + behind.joint_limit_rad) / 2
        assert model.joint(f"neck{gap}").range[1] == pytest.approx(limit)
        front = data.site(f"anchor{gap}_front_dorsal_left").xpos
        assert front[2] == pytest.approx(2 * ahead.segment_radius_m + ahead.attachment_y_m)


def test_different_segments_keep_their_length_when_cold():
    # The neutral point offsets the pre-tension of the springs, about 1.5 mm. Oblique springs bend the
    # body a little.
    rng = np.random.default_rng(4)
    body = tuple(Morphology.from_unit(unit) for unit in rng.random((4, 8)))
    model, data = built(body)
    step(model, data, 2.0)
    axial = [data.joint(f"axial{number}").qpos[0] for number in range(4)]
    np.testing.assert_allclose(axial, 0.0, atol=5e-4)


@pytest.mark.parametrize("count", [0, 3, 5])
def test_wrong_number_of_segments_is_rejected(count):
    with pytest.raises(CaterpillarError, match=f"or a tuple of 4 morphologies; got {count}"):
        built((BODY,) * count)


@pytest.mark.parametrize("scenery", [True, False])
def test_reused_builder_gives_the_same_model(scenery):
    rng = np.random.default_rng(6)
    physics = Physics()
    used = ModelBuilder(physics, scenery=scenery)
    for unlike in (False, True, False, True):
        segments = tuple(Morphology.from_unit(unit) for unit in rng.random((4, 8)))
        body = segments if unlike else segments[0]
        ours = used.build(body)
        fresh = build_model(body, physics, scenery=scenery)
        for name in dir(fresh):
            value = getattr(fresh, name)
            if isinstance(value, np.ndarray):
                np.testing.assert_array_equal(getattr(ours, name), value, err_msg=name)


# MJCF

#: Expected differences of the XML: the ruler's texture, and zeros that `trim_tendons` removes.
_OTHERWISE = {"tex_data", "tex_width", "tex_height", "mat_texrepeat", "ten_J_rownnz", "ten_J_colind"}


def arrays(part):
    """Return the numbers and arrays of a model, or of a part of it, by name."""
    names = (name for name in dir(part) if not name.startswith("_"))
    values = {name: getattr(part, name) for name in names}
    return {n: v for n, v in values.items() if isinstance(v, (np.ndarray, int, float))}


@pytest.mark.parametrize(
    ("body", "physics"),
    [
        (BODY, Physics()),
        (BODY, Physics(num_segments=2, spring_strengths=(1 / 3, 1.1, 0.7, 2 / 7))),
        (BODY, Physics(num_segments=7, bend_axis="pitch", mismatch_seed=3, friction=1 / 3)),
        (
            (BODY, replace(BODY, segment_radius_m=0.011 / 1.1), replace(BODY, segment_length_m=0.03)),
            Physics(num_segments=3, timestep_s=0.01 / 3, impratio=17.3, solver_tolerance=1e-11),
        ),
        (BODY, Physics(integrator="implicitfast", solver="cg", cone="pyramidal", solver_iterations=7)),
    ],
    ids=["default", "two", "seven", "unlike", "numerics"],
)
def test_xml_compiles_to_a_bitwise_identical_model(body, physics):
    model = build_model(body, physics)
    read = mujoco.MjModel.from_xml_string(model_xml(body, physics))
    for part, same in ((model, read), (model.opt, read.opt), (model.stat, read.stat)):
        expected, found = arrays(part), arrays(same)
        differ = {name for name in expected if not np.array_equal(expected[name], found[name])}
        assert differ - _OTHERWISE <= {"nbuffer", "ntexdata", "signature"}
    assert {"actuator_gainprm", "tendon_lengthspring", "qpos_spring"} <= arrays(model).keys()
    assert model.names == read.names


def test_xml_has_the_scenery():
    read = mujoco.MjModel.from_xml_string(model_xml(BODY, Physics()))
    assert [read.camera(number).name for number in range(read.ncam)] == list(get_args(Camera))
    assert read.nlight == 1
    assert read.geom("ground").matid[0] == read.material("squares").id
    assert (read.geom_type == mujoco.mjtGeom.mjGEOM_CAPSULE).sum() == 8  # legs


def test_xml_without_scenery_holds_the_robot_alone():
    read = mujoco.MjModel.from_xml_string(model_xml(BODY, Physics(), scenery=False))
    model = build_model(BODY, Physics(), scenery=False)
    assert (read.ncam, read.nlight, read.ntex, read.ngeom) == (0, 0, 0, model.ngeom)
    assert read.names == model.names
    np.testing.assert_array_equal(read.actuator_gainprm, model.actuator_gainprm)


def test_xml_and_model_move_identically():
    model = build_model(BODY, Physics())
    read = mujoco.MjModel.from_xml_string(model_xml(BODY, Physics()))
    ends = []
    for each in (model, read):
        data = mujoco.MjData(each)
        data.ctrl[::3] = 0.8
        step(each, data, 0.5)
        ends.append(data.qpos.copy())
    assert np.abs(ends[0] - model.qpos0).max() > 1e-3
    assert ends[1] == pytest.approx(ends[0], abs=1e-9)
