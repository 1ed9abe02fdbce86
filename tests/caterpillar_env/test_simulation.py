import math

import mujoco
import numpy as np
import pytest

from caterpillar_env import Morphology, Physics, sma
from caterpillar_env.errors import CaterpillarError
from caterpillar_env.ground import STANCE_M
from caterpillar_env.simulation import Simulation

SMALL = Morphology(segment_length_m=0.024, segment_radius_m=0.010, joint_limit_rad=0.4)
LARGE = Morphology(leg_separation_m=0.022, segment_length_m=0.035, segment_mass_kg=0.011)


def started(morphologies, threads=1, **physics):
    return Simulation(morphologies, Physics(**physics), threads)


def advance(simulation, power, rows=None, **kwargs):
    return simulation.advance(simulation.heat(power, rows), **kwargs)


def now(simulation):
    """Return MuJoCo data of the first row with all derived fields up to date."""
    data = mujoco.MjData(simulation.models[0])
    data.qpos[:], data.qvel[:] = simulation.engine.qpos[0], simulation.engine.qvel[0]
    mujoco.mj_forward(simulation.models[0], data)
    return data


def some_power(rows, steps, seed=0):
    """Return random on-off power in intervals of 0.1 s, so that springs reach many temperatures."""
    pieces = np.random.default_rng(seed).random((rows, -(-steps // 10), 12)) < 0.6
    return np.repeat(pieces, 10, axis=1)[:, :steps].astype(float)


def test_start_is_straight_at_rest_and_cold():
    state = started([SMALL]).state()
    np.testing.assert_allclose(state.com_m, [[-0.012 * 3.5, 0, 0.020]], atol=1e-12)
    np.testing.assert_allclose(state.up, [[0, 0, 1]], atol=1e-12)
    np.testing.assert_allclose(state.forward, [[1, 0, 0]], atol=1e-12)
    np.testing.assert_allclose(state.clearance_m, -STANCE_M, atol=1e-12)
    assert not state.velocity.any()
    assert not state.joint_position.any()
    assert (state.temperature_c == 25).all()
    assert not state.fraction.any()
    assert state.time_s.tolist() == [0]


def test_robot_without_power_does_not_move():
    simulation = started([Morphology()])
    advance(simulation, np.zeros((1, 200, 12)))
    settled = simulation.state().com_m
    advance(simulation, np.zeros((1, 2800, 12)))
    state = simulation.state()
    assert np.linalg.norm(state.com_m - settled) < 0.001
    assert state.time_s[0] == pytest.approx(30)
    assert np.abs(state.velocity).max() < 1e-3
    assert simulation.energy_j[0] == 0


def test_energy_is_that_of_the_driven_springs():
    simulation = started([Morphology()])
    power = np.zeros((1, 40, 12))
    power[:, 10:, :3] = 1.0
    power[:, 20:, 3] = 0.5
    advance(simulation, power)
    wire_m = 100 * math.pi * 0.47e-3
    watt = 0.35**2 * 0.98e-6 / (math.pi * 0.15e-3**2 / 4) * wire_m
    assert simulation.energy_j[0] == pytest.approx(watt * (3 * 0.3 + 0.5 * 0.2))


def test_spring_temperatures_do_not_depend_on_the_body():
    simulation = started([SMALL, LARGE])
    power = some_power(2, 60)
    advance(simulation, power)
    spring = simulation.physics.spring
    alone = sma.advance(spring, sma.SmaState.cold(spring, (12,)), power[1], 0.01)
    np.testing.assert_array_equal(simulation.state().fraction[1], alone.state.fraction)
    assert alone.state.fraction.max() > 0


def fields_of(simulation):
    return list(vars(simulation.state()).values())


def test_power_at_the_cut_off_equals_the_heat_loss():
    simulation = started([SMALL], num_segments=2)
    advance(simulation, np.ones((1, 800, 4)))  # hot by then
    before_j = simulation.energy_j[0]
    advance(simulation, np.ones((1, 100, 4)))
    s = simulation.physics.spring
    wire_kg = s.mass_per_m_kg * s.turns * np.pi * s.coil_diameter_m
    loss_w = s.cooling_w_kg_k * (s.cut_off_c - s.ambient_c) * wire_kg
    assert loss_w < 0.6 * s.drive_power_w
    assert simulation.energy_j[0] - before_j == pytest.approx(4 * loss_w, rel=1e-6)


def test_row_does_not_depend_on_its_index_or_the_other_rows():
    power = some_power(1, 80)
    alone = started([SMALL])
    advance(alone, power)
    crowd = started([LARGE, Morphology(), SMALL])
    advance(crowd, np.concatenate([some_power(2, 80, seed=1), power]))
    for mine, theirs in zip(fields_of(alone), fields_of(crowd), strict=True):
        np.testing.assert_array_equal(mine[0], theirs[2])
    np.testing.assert_array_equal(alone.qpos(0), crowd.qpos(2))


def test_many_short_calls_equal_one_long_call():
    power = some_power(1, 60)
    single, pieces = started([SMALL]), started([SMALL])
    advance(single, power)
    for first in range(0, 60, 20):
        advance(pieces, power[:, first : first + 20])
    np.testing.assert_array_equal(single.qpos(0), pieces.qpos(0))
    assert single.state().time_s == pieces.state().time_s
    assert single.energy_j[0] == pytest.approx(pieces.energy_j[0], rel=1e-12)


def test_advancing_some_rows_does_not_change_the_others():
    simulation = started([SMALL, SMALL, SMALL])
    advance(simulation, some_power(1, 20), np.array([1]))
    still = simulation.state(np.array([0, 2]))
    assert still.time_s.tolist() == [0, 0]
    np.testing.assert_allclose(still.com_m[:, 2], 0.020)
    assert simulation.state().time_s.tolist() == [0, 0.2, 0]
    assert simulation.simulated_s == pytest.approx(0.2)


def test_reset_row_repeats_its_run_and_others_continue():
    power = some_power(2, 40)
    simulation = started([SMALL, LARGE])
    advance(simulation, power)
    first, other = simulation.qpos(0), simulation.qpos(1)
    simulation.reset([SMALL], np.array([0]))
    np.testing.assert_array_equal(simulation.qpos(1), other)
    assert simulation.energy_j[0] == 0 < simulation.energy_j[1]
    assert simulation.state().time_s.tolist() == [0, 0.4]
    advance(simulation, power[:1], np.array([0]))
    np.testing.assert_array_equal(simulation.qpos(0), first)


def test_reset_replaces_the_body():
    simulation = started([SMALL, SMALL])
    simulation.reset([LARGE], np.array([1]))
    assert simulation.bodies == [SMALL, LARGE]
    assert simulation.state().com_m[:, 2].tolist() == pytest.approx([0.020, 0.024])
    advance(simulation, some_power(2, 40))
    fresh = started([SMALL, LARGE])
    advance(fresh, some_power(2, 40))
    np.testing.assert_array_equal(simulation.qpos(1), fresh.qpos(1))


def test_robots_can_be_placed_at_rest_in_a_given_pose():
    simulation = started([SMALL, LARGE])
    advance(simulation, some_power(2, 20))
    other, pose = simulation.qpos(1), simulation.qpos(0)
    pose[:3], pose[9] = [1.0, 2.0, 0.5], 0.3
    simulation.place(pose[None], np.array([0]))
    np.testing.assert_array_equal(simulation.qpos(0), pose)
    np.testing.assert_array_equal(simulation.qpos(1), other)
    state = simulation.state()
    assert not state.velocity[0].any()
    assert state.velocity[1].any()
    assert state.clearance_m[0] > 0.4
    with pytest.raises(CaterpillarError, match=r"qpos must have shape \(2, 18\); got \(1, 18\)"):
        simulation.place(pose[None])


def test_velocity_is_the_mean_of_the_elements():
    simulation = started([SMALL])
    advance(simulation, some_power(1, 60))
    model, data = simulation.models[0], now(simulation)
    simulation.place(data.qpos[None], qvel=data.qvel[None])  # updates all derived state
    each = np.zeros((8, 6))
    for body in range(8):
        mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, body + 1, each[body], 0)
    expected = each.mean(axis=0)[[3, 4, 5, 0, 1, 2]]
    assert np.abs(expected).max() > 1e-3
    np.testing.assert_allclose(simulation.state().velocity[0], expected, atol=1e-9)


def test_derived_state_is_one_physics_step_older_than_the_joints():
    simulation = started([SMALL])
    advance(simulation, some_power(1, 40))
    state, data = simulation.state(), now(simulation)
    np.testing.assert_array_equal(state.joint_position[0], data.qpos[7:])
    np.testing.assert_array_equal(state.joint_velocity[0], data.qvel[6:])
    moved_m = data.subtree_com[1] - state.com_m[0]
    assert moved_m.any()
    # The centre of mass moves with the velocity of the next step.
    simulation.place(data.qpos[None], qvel=data.qvel[None])
    mass = simulation.models[0].body_mass[1:]
    assert np.ptp(mass) == 0  # so the mean over elements is the mean over mass
    np.testing.assert_allclose(moved_m, simulation.state().velocity[0, :3] * 0.0025, atol=2e-6)


def test_clearance_is_the_height_of_the_lowest_point():
    simulation = started([SMALL, LARGE, LARGE])
    qpos = np.stack([simulation.qpos(row) for row in range(3)])
    qpos[:, 2] += 0.1
    qpos[2, 3:7] = [0, 1, 0, 0]  # on its back: feet up
    simulation.place(qpos)
    clearance = simulation.state().clearance_m
    np.testing.assert_allclose(clearance, [0.1, 0.1, 0.1 + 2 * 0.012 - 0.012], atol=1e-12)
    simulation.reset([SMALL], np.array([2]))
    qpos[2, 2:7] = [0.1, 0, 1, 0, 0]
    simulation.place(qpos)
    assert simulation.state().clearance_m[2] == pytest.approx(0.1 - 0.010)


def test_state_is_a_copy():
    simulation = started([SMALL])
    before = fields_of(simulation)
    kept = [field.copy() for field in before]
    advance(simulation, some_power(1, 20))
    for field, copy in zip(before, kept, strict=True):
        np.testing.assert_array_equal(field, copy)
    simulation.state().com_m[:] = 9.0
    simulation.state().joint_position[:] = 9.0
    assert simulation.state().com_m.max() < 1
    assert simulation.qpos(0)[7:].max() < 1


def test_trace_holds_every_thermal_step():
    simulation, untraced = started([SMALL, LARGE]), started([SMALL, LARGE])
    power = some_power(2, 30)
    trace = advance(simulation, power, trace=True)
    assert advance(untraced, power) is None
    assert trace.qpos.shape == (2, 30, 18)
    assert trace.temperature_c.shape == (2, 30, 12)
    np.testing.assert_array_equal(trace.qpos[1, -1], simulation.qpos(1))
    np.testing.assert_array_equal(simulation.qpos(1), untraced.qpos(1))
    np.testing.assert_array_equal(trace.temperature_c[:, -1], simulation.state().temperature_c)
    np.testing.assert_array_equal(trace.energy_j[:, -1], simulation.energy_j)
    np.testing.assert_array_equal(untraced.energy_j, simulation.energy_j)
    assert (np.diff(trace.energy_j, axis=1) >= 0).all()
    further = advance(simulation, power, trace=True)  # continues from the previous energy
    np.testing.assert_array_equal(further.energy_j[:, -1], simulation.energy_j)
    assert (further.energy_j[:, 0] >= trace.energy_j[:, -1]).all()
    untraced.reset([SMALL, LARGE])
    advance(untraced, power[:, :10])
    np.testing.assert_array_equal(trace.qpos[0, 9], untraced.qpos(0))
    np.testing.assert_array_equal(trace.energy_j[:, 9], untraced.energy_j)
    np.testing.assert_array_equal(trace.temperature_c[:, 9], untraced.state().temperature_c)


def test_temperatures_do_not_depend_on_the_physics_timestep():
    coarse, fine = started([SMALL], timestep_s=0.01), started([SMALL], timestep_s=0.0025)
    power = some_power(1, 50)
    advance(coarse, power)
    advance(fine, power)
    np.testing.assert_array_equal(coarse.state().fraction, fine.state().fraction)
    assert coarse.state().time_s == fine.state().time_s
    np.testing.assert_allclose(coarse.state().com_m, fine.state().com_m, atol=2e-3)


def test_actuators_get_the_mean_fraction_of_each_physics_step():
    simulation = started([SMALL], timestep_s=0.005)
    heating = simulation.heat(np.ones((1, 200, 12)))
    after = heating.springs.path.fraction[:, 0]  # after each thermal step
    before = np.concatenate([np.zeros((1, 12)), after[:-1]])
    assert heating.control.shape == (1, 400, 12)
    assert np.ptp(after) > 0.5
    np.testing.assert_allclose(heating.control[0, 0::2], 0.75 * before + 0.25 * after)
    np.testing.assert_allclose(heating.control[0, 1::2], 0.25 * before + 0.75 * after)


def test_some_of_the_heated_robots_can_advance_further_than_others():
    simulation, single = started([SMALL, LARGE]), started([SMALL, LARGE])
    power = some_power(2, 30)
    heating = simulation.heat(power)
    simulation.advance(heating, last=10)
    simulation.advance(heating, np.array([1]), 10, 30)
    advance(single, power)
    assert simulation.state().time_s.tolist() == pytest.approx([0.1, 0.3])
    np.testing.assert_array_equal(simulation.qpos(1), single.qpos(1))
    assert simulation.energy_j[1] == pytest.approx(single.energy_j[1], rel=1e-12)
    np.testing.assert_array_equal(simulation.state().fraction[1], single.state().fraction[1])


def test_diverged_row_is_reported_and_does_not_affect_the_others(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # MuJoCo logs its warning in the working directory
    power = some_power(2, 30)
    simulation, healthy = started([SMALL, LARGE]), started([SMALL, LARGE])
    simulation.place(np.full((1, 18), np.nan), np.array([0]))
    assert simulation.diverged().tolist() == [True, False]  # at once; MuJoCo warns a step later
    advance(simulation, power)
    advance(healthy, power)
    assert simulation.diverged().tolist() == [True, False]
    assert simulation.diverged(np.array([1])).tolist() == [False]
    np.testing.assert_array_equal(simulation.qpos(1), healthy.qpos(1))

    simulation.reset([SMALL], np.array([0]))
    assert not simulation.diverged().any()
    advance(simulation, power[:1], np.array([0]))
    np.testing.assert_array_equal(simulation.qpos(0), healthy.qpos(0))


@pytest.mark.parametrize("shape", [(1, 10, 12), (2, 10, 11), (2, 12)], ids=str)
def test_wrong_power_shape_is_an_error(shape):
    with pytest.raises(CaterpillarError, match=r"\(2, steps, 12\)") as caught:
        started([SMALL, SMALL]).heat(np.zeros(shape))
    assert str(shape) in str(caught.value)


def test_every_row_needs_a_body():
    with pytest.raises(CaterpillarError, match="bodies must have one entry for each of 2 robots; got 1"):
        started([SMALL, SMALL]).reset([SMALL])


@pytest.mark.parametrize(
    ("rows", "threads", "message"),
    [(0, 1, "needs at least one body"), (1, -1, "threads = -1"), (1, np.inf, "threads = inf")],
)
def test_invalid_sizes_are_rejected(rows, threads, message):
    with pytest.raises(CaterpillarError, match=message):
        Simulation([SMALL] * rows, Physics(), threads)


def test_threads_default_to_the_usable_cores(monkeypatch):
    monkeypatch.setattr("caterpillar_env.simulation.cores", lambda: 3)
    assert Simulation([SMALL] * 4, Physics()).engine.nthread == 3
    assert Simulation([SMALL] * 4, Physics(), 1).engine.nthread == 1
