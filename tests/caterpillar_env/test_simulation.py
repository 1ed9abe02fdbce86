import math

import mujoco
import numpy as np
import pytest

from caterpillar_env import Morphology, Physics, SimulationError
from caterpillar_env.ground import STANCE_M
from caterpillar_env.simulation import Simulation
from caterpillar_env.sma import SmaState, advance

SMALL = Morphology(segment_length_m=0.024, segment_radius_m=0.010, joint_limit_rad=0.4)
LARGE = Morphology(leg_separation_m=0.022, segment_length_m=0.035, segment_mass_kg=0.011)


def started(morphologies, threads=1, **physics):
    simulation = Simulation(len(morphologies), Physics(**physics), threads)
    simulation.reset(morphologies)
    return simulation


def some_power(rows, steps, seed=0):
    """On and off in pieces of 0.1 s, so that springs are hot, cold and in between."""
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


def test_robot_without_power_stays_where_it_is():
    simulation = started([Morphology()])
    simulation.advance(np.zeros((1, 200, 12)))
    settled = simulation.state().com_m
    simulation.advance(np.zeros((1, 2800, 12)))
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
    simulation.advance(power)
    wire_m = 100 * math.pi * 0.47e-3
    watt = 0.35**2 * 0.98e-6 / (math.pi * 0.15e-3**2 / 4) * wire_m
    assert simulation.energy_j[0] == pytest.approx(watt * (3 * 0.3 + 0.5 * 0.2))


def test_springs_are_heated_as_without_a_body():
    simulation = started([SMALL, LARGE])
    power = some_power(2, 60)
    simulation.advance(power)
    spring = simulation.physics.spring
    alone = advance(spring, SmaState.cold(spring, (12,)), power[1], 0.01)
    np.testing.assert_array_equal(simulation.state().fraction[1], alone.state.fraction)
    assert alone.state.fraction.max() > 0


def fields_of(simulation):
    return list(vars(simulation.state()).values())


def test_springs_at_the_cut_off_draw_what_they_lose():
    simulation = started([SMALL], num_segments=2)
    simulation.advance(np.ones((1, 800, 4)))  # hot by then
    before_j = simulation.energy_j[0]
    simulation.advance(np.ones((1, 100, 4)))
    s = simulation.physics.spring
    loss_w = s.cooling_w_kg_k * (s.cut_off_c - s.ambient_c) * s.mass_per_m_kg * s.wire_length_m
    assert loss_w < 0.6 * s.drive_power_w
    assert simulation.energy_j[0] - before_j == pytest.approx(4 * loss_w, rel=1e-6)


def test_row_does_not_depend_on_its_place_or_neighbours():
    power = some_power(1, 80)
    alone = started([SMALL])
    alone.advance(power)
    crowd = started([LARGE, Morphology(), SMALL])
    crowd.advance(np.concatenate([some_power(2, 80, seed=1), power]))
    for mine, theirs in zip(fields_of(alone), fields_of(crowd), strict=True):
        np.testing.assert_array_equal(mine[0], theirs[2])
    np.testing.assert_array_equal(alone.qpos(0), crowd.qpos(2))


def test_pieces_add_up_to_the_whole():
    power = some_power(1, 60)
    whole, pieces = started([SMALL]), started([SMALL])
    whole.advance(power)
    for first in range(0, 60, 20):
        pieces.advance(power[:, first : first + 20])
    np.testing.assert_array_equal(whole.qpos(0), pieces.qpos(0))
    assert whole.state().time_s == pieces.state().time_s
    assert whole.energy_j[0] == pytest.approx(pieces.energy_j[0], rel=1e-12)


def test_advancing_some_rows_leaves_the_others():
    simulation = started([SMALL, SMALL, SMALL])
    simulation.advance(some_power(1, 20), np.array([1]))
    still = simulation.state(np.array([0, 2]))
    assert still.time_s.tolist() == [0, 0]
    np.testing.assert_allclose(still.com_m[:, 2], 0.020)
    assert simulation.state().time_s.tolist() == [0, 0.2, 0]
    assert simulation.simulated_s == pytest.approx(0.2)


def test_reset_row_repeats_its_run_and_others_go_on():
    power = some_power(2, 40)
    simulation = started([SMALL, LARGE])
    simulation.advance(power)
    first, other = simulation.qpos(0), simulation.qpos(1)
    simulation.reset([SMALL], np.array([0]))
    np.testing.assert_array_equal(simulation.qpos(1), other)
    assert simulation.energy_j[0] == 0 < simulation.energy_j[1]
    assert simulation.state().time_s.tolist() == [0, 0.4]
    simulation.advance(power[:1], np.array([0]))
    np.testing.assert_array_equal(simulation.qpos(0), first)


def test_reset_exchanges_the_body():
    simulation = started([SMALL, SMALL])
    simulation.reset([LARGE], np.array([1]))
    assert [simulation.body(row) for row in (0, 1)] == [SMALL, LARGE]
    assert simulation.state().com_m[:, 2].tolist() == pytest.approx([0.020, 0.024])
    simulation.advance(some_power(2, 40))
    fresh = started([SMALL, LARGE])
    fresh.advance(some_power(2, 40))
    np.testing.assert_array_equal(simulation.qpos(1), fresh.qpos(1))


def test_reset_applies_heading_and_offset():
    simulation = started([Morphology(), Morphology()])
    offset = np.zeros((1, 11))
    offset[0, 1] = 0.05
    simulation.reset([Morphology()], np.array([1]), heading_rad=math.pi / 2, offset=offset)
    state = simulation.state()
    assert state.joint_position[1].tolist() == offset[0].tolist()
    assert not state.joint_position[0].any()
    np.testing.assert_allclose(state.forward[0], [1, 0, 0], atol=1e-12)
    assert state.forward[1, 1] > 0.99
    assert state.com_m[1, 1] == pytest.approx(-0.0525, abs=0.003)  # the body trails behind the head


def test_robots_can_be_placed_at_rest_in_another_pose():
    simulation = started([SMALL, LARGE])
    simulation.advance(some_power(2, 20))
    other, pose = simulation.qpos(1), simulation.qpos(0)
    pose[:3], pose[9] = [1.0, 2.0, 0.5], 0.3
    simulation.place(pose[None], np.array([0]))
    np.testing.assert_array_equal(simulation.qpos(0), pose)
    np.testing.assert_array_equal(simulation.qpos(1), other)
    state = simulation.state()
    assert not state.velocity[0].any()
    assert state.velocity[1].any()
    assert state.clearance_m[0] > 0.4
    with pytest.raises(SimulationError, match=r"qpos must have shape \(2, 18\); got \(1, 18\)"):
        simulation.place(pose[None])


def test_velocity_is_the_mean_of_the_elements():
    simulation = started([SMALL])
    simulation.advance(some_power(1, 60))
    simulation._refresh(np.array([0]))
    model, data = simulation.drawable(0)
    each = np.zeros((8, 6))
    for body in range(8):
        mujoco.mj_objectVelocity(model, data, mujoco.mjtObj.mjOBJ_XBODY, body + 1, each[body], 0)
    expected = each.mean(axis=0)[[3, 4, 5, 0, 1, 2]]
    assert np.abs(expected).max() > 1e-3
    np.testing.assert_allclose(simulation.state().velocity[0], expected, atol=1e-9)


def test_derived_state_is_one_physics_step_old_and_joints_are_not():
    simulation = started([SMALL])
    simulation.advance(some_power(1, 40))
    state, (_, now) = simulation.state(), simulation.drawable(0)
    np.testing.assert_array_equal(state.joint_position[0], now.qpos[7:])
    np.testing.assert_array_equal(state.joint_velocity[0], now.qvel[6:])
    moved_m = now.subtree_com[1] - state.com_m[0]
    assert moved_m.any()
    # The centre of mass is carried on by the velocity of the step that followed.
    simulation._refresh(np.array([0]))
    mass = simulation.drawable(0)[0].body_mass[1:]
    assert np.ptp(mass) == 0  # so that the mean of the elements is that of the mass
    np.testing.assert_allclose(moved_m, simulation.state().velocity[0, :3] * 0.0025, atol=2e-6)


def test_clearance_is_that_of_the_lowest_point():
    simulation = started([SMALL, LARGE, LARGE])
    simulation._qpos[:, 2] += 0.1
    simulation._qpos[2, 3:7] = [0, 1, 0, 0]  # on its back: feet up
    simulation._refresh(np.arange(3))
    clearance = simulation.state().clearance_m
    np.testing.assert_allclose(clearance, [0.1, 0.1, 0.1 + 2 * 0.012 - 0.012], atol=1e-12)
    simulation.reset([SMALL], np.array([2]))
    simulation._qpos[2, 2:7] = [0.1, 0, 1, 0, 0]
    simulation._refresh(np.arange(3))
    assert simulation.state().clearance_m[2] == pytest.approx(0.1 - 0.010)


def test_state_is_a_copy():
    simulation = started([SMALL])
    before = fields_of(simulation)
    kept = [field.copy() for field in before]
    simulation.advance(some_power(1, 20))
    for field, copy in zip(before, kept, strict=True):
        np.testing.assert_array_equal(field, copy)
    simulation.state().com_m[:] = 9.0
    simulation.state().joint_position[:] = 9.0
    assert simulation.state().com_m.max() < 1
    assert simulation.qpos(0)[7:].max() < 1


def test_trace_holds_every_thermal_step():
    simulation, untraced = started([SMALL, LARGE]), started([SMALL, LARGE])
    power = some_power(2, 30)
    trace = simulation.advance(power, trace=True)
    assert untraced.advance(power) is None
    assert trace.qpos.shape == (2, 30, 18)
    assert trace.temperature_c.shape == (2, 30, 12)
    np.testing.assert_array_equal(trace.qpos[1, -1], simulation.qpos(1))
    np.testing.assert_array_equal(simulation.qpos(1), untraced.qpos(1))
    np.testing.assert_array_equal(trace.temperature_c[:, -1], simulation.state().temperature_c)
    np.testing.assert_array_equal(trace.energy_j[:, -1], simulation.energy_j)
    np.testing.assert_array_equal(untraced.energy_j, simulation.energy_j)
    assert (np.diff(trace.energy_j, axis=1) >= 0).all()
    further = simulation.advance(power, trace=True)  # it goes on from what was drawn so far
    np.testing.assert_array_equal(further.energy_j[:, -1], simulation.energy_j)
    assert (further.energy_j[:, 0] >= trace.energy_j[:, -1]).all()
    untraced.reset([SMALL, LARGE])
    untraced.advance(power[:, :10])
    np.testing.assert_array_equal(trace.qpos[0, 9], untraced.qpos(0))
    np.testing.assert_array_equal(trace.energy_j[:, 9], untraced.energy_j)
    np.testing.assert_array_equal(trace.temperature_c[:, 9], untraced.state().temperature_c)


def test_physics_steps_finer_than_thermal_ones_see_the_same_heat():
    coarse, fine = started([SMALL], timestep_s=0.01), started([SMALL], timestep_s=0.0025)
    power = some_power(1, 50)
    coarse.advance(power)
    fine.advance(power)
    np.testing.assert_array_equal(coarse.state().fraction, fine.state().fraction)
    assert coarse.state().time_s == fine.state().time_s
    np.testing.assert_allclose(coarse.state().com_m, fine.state().com_m, atol=2e-3)


def test_actuators_get_the_mean_fraction_of_each_physics_step():
    simulation = started([SMALL], timestep_s=0.005)
    start, after = np.full((1, 12), 0.2), np.stack([np.full((1, 12), 0.6), np.full((1, 12), 0.4)])
    control = simulation._control(start, after)
    assert control.shape == (1, 4, 12)
    np.testing.assert_allclose(control[0, :, 0], [0.3, 0.5, 0.55, 0.45])


def test_diverged_row_is_told_and_leaves_the_others(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)  # MuJoCo logs its warning in the working directory
    power = some_power(2, 30)
    simulation, healthy = started([SMALL, LARGE]), started([SMALL, LARGE])
    simulation._qpos[0] = np.nan
    assert simulation.diverged().tolist() == [True, False]  # at once; MuJoCo warns a step later
    simulation.advance(power)
    healthy.advance(power)
    assert simulation.diverged().tolist() == [True, False]
    assert simulation.diverged(np.array([1])).tolist() == [False]
    np.testing.assert_array_equal(simulation.qpos(1), healthy.qpos(1))

    simulation.reset([SMALL], np.array([0]))
    assert not simulation.diverged().any()
    simulation.advance(power[:1], np.array([0]))
    np.testing.assert_array_equal(simulation.qpos(0), healthy.qpos(0))


@pytest.mark.parametrize("shape", [(1, 10, 12), (2, 10, 11), (2, 12)], ids=str)
def test_wrong_shape_of_power_is_told(shape):
    with pytest.raises(SimulationError, match=r"\(2, steps, 12\)") as caught:
        started([SMALL, SMALL]).advance(np.zeros(shape))
    assert str(shape) in str(caught.value)


def test_rows_must_be_reset_first():
    simulation = Simulation(2, Physics())
    simulation.reset([SMALL], np.array([0]))
    with pytest.raises(SimulationError, match="reset a row before"):
        simulation.advance(np.zeros((2, 1, 12)))


def test_every_row_needs_a_body():
    with pytest.raises(SimulationError, match="2 rows need as many bodies; got 1"):
        Simulation(2, Physics()).reset([SMALL])


@pytest.mark.parametrize(("rows", "threads"), [(0, 1), (1, -1)])
def test_sizes_must_make_sense(rows, threads):
    with pytest.raises(SimulationError, match=f"got {rows} and {threads}"):
        Simulation(rows, Physics(), threads)
