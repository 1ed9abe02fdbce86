"""The planar model of the crawling robot against mechanics that can be computed by hand."""

from dataclasses import replace

import mujoco
import numpy as np
import pytest

from caterpillar_env.model import build_model
from caterpillar_env.morphology import Morphology
from caterpillar_env.physics import Physics
from evolution.priors.statics import PlanarChain

BODY, PHYSICS = Morphology(), Physics()
PAIRS = 6


def steady(fraction, count=3):
    """The same fractions at every instant, (count, pairs, 1)."""
    return np.tile(np.reshape(fraction, (1, PAIRS, 1)), (count, 1, 1)).astype(float)


def pulse(pair, instants=60):
    """One pair that contracts and relaxes twice, (instants, pairs, 1)."""
    fractions = np.zeros((instants, PAIRS, 1))
    fractions[:, pair, 0] = np.sin(np.linspace(0, 2 * np.pi, instants)) ** 2
    return fractions


def test_cold_robot_hardly_moves():
    # Smoothed friction lets loaded feet creep about 1 mm per period. The best wave moves 22 mm.
    positions = PlanarChain([BODY], PHYSICS).crawl(steady([0] * PAIRS, 101), 0.05)
    assert abs(positions[-1, 0] - positions[0, 0]) < 1.5e-3


def test_derivatives_agree_with_finite_differences():
    chain = PlanarChain([BODY], PHYSICS)
    rng = np.random.default_rng(0)
    q = 0.1 * rng.standard_normal((9, 1))
    step = 1e-6
    for i in range(9):
        moved = np.zeros((9, 1))
        moved[i] = step
        slope = (chain.locate(q + moved).vectors_m - chain.locate(q - moved).vectors_m) / (2 * step)
        assert chain.locate(q).jacobian[:, :, i] == pytest.approx(slope, abs=1e-8)


def test_first_prismatic_joint_follows_hookes_law():
    # Both pairs of the first gap are hot, and the body stays straight: 4 hot springs compress the
    # segment beyond its rest by (4 F_hot - 4 F_cold) / k, up to the travel of the joint.
    stiff = replace(PHYSICS, axial_stiffness_n_m=5000.0)
    chain = PlanarChain([BODY], stiff)
    hot = chain.settle(steady([1, 1, 0, 0, 0, 0])[0])
    spring, length_m = stiff.spring, 0.036 + hot[6, 0]
    forces = 4 * (35.0 * (length_m - 0.016)), 4 * 14.5 * (0.036 - 0.0222)
    assert spring.austenite_stiffness_n_m == 35.0
    assert hot[6, 0] == pytest.approx(-(forces[0] - forces[1]) / 5000.0, rel=0.02)
    assert np.abs(hot[2:6]).max() < 0.02  # hardly bent


def test_dorsal_pair_raises_the_ends_and_ventral_pair_the_middle():
    chain = PlanarChain([BODY], PHYSICS)
    dorsal, ventral = (chain.settle(steady(row)[0]) for row in np.eye(PAIRS)[2:4])
    neck_up, neck_down = (q[4, 0] - q[3, 0] for q in (dorsal, ventral))
    # Positive pitch is nose up: with a short back, the segment behind points down towards the middle.
    assert neck_up < -0.1
    assert neck_down > 0.1


def test_feet_carry_the_weight():
    chain = PlanarChain([BODY], PHYSICS)
    for row in np.eye(PAIRS):
        q = chain.settle(steady(row)[0])
        assert chain.loads_n(q).sum() == pytest.approx(4 * 0.008 * 9.81, rel=1e-3)


def test_robot_without_friction_does_not_advance():
    # A frictionless robot cannot advance: over a closed cycle of shapes it returns to its place.
    slippery = replace(PHYSICS, friction=0.0)
    positions = PlanarChain([BODY], slippery).crawl(pulse(2), 0.1)
    assert abs(positions[-1, 0] - positions[0, 0]) < 1e-4


def test_gaits_solved_in_a_batch_equal_gaits_solved_alone():
    chain = PlanarChain([BODY], PHYSICS)
    together = chain.crawl(np.concatenate([pulse(0), pulse(3)], axis=2), 0.1)
    assert together[:, 1:] == pytest.approx(chain.crawl(pulse(3), 0.1), abs=1e-9)


def test_bodies_solved_in_a_batch_equal_bodies_solved_alone():
    other = replace(BODY, segment_length_m=0.034, segment_mass_kg=0.012, segment_radius_m=0.012)
    uneven = (BODY, other, BODY, other)
    bodies, gaits = [BODY, other, uneven], [pulse(0), pulse(3), pulse(2)]
    together = PlanarChain(bodies, PHYSICS).crawl(np.concatenate(gaits, axis=2), 0.1)
    for number, (body, gait) in enumerate(zip(bodies, gaits, strict=True)):
        alone = PlanarChain([body], PHYSICS).crawl(gait, 0.1)
        assert together[:, [number]] == pytest.approx(alone, abs=1e-9)


def test_four_equal_segments_match_a_shared_body():
    one, four = (PlanarChain([body], PHYSICS).crawl(pulse(2), 0.1) for body in (BODY, (BODY,) * 4))
    assert np.array_equal(one, four)


def test_robot_with_different_segments_stands_as_in_the_simulator():
    # At rest and cold, the positions of the segments are those of the compiled robot.
    bodies = tuple(
        replace(BODY, segment_radius_m=radius, segment_length_m=length)
        for radius, length in ((0.009, 0.022), (0.012, 0.030), (0.010, 0.025), (0.012, 0.022))
    )
    chain = PlanarChain([bodies], PHYSICS)
    straight = np.zeros((9, 1))
    straight[1] = 2 * bodies[0].segment_radius_m
    feet = chain.locate(straight).vectors_m[:, :4, 0]
    model = build_model(bodies, PHYSICS, scenery=False)
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    xpos = np.array([data.body(f"element{2 * segment}").xpos for segment in range(4)])
    assert feet[0] == pytest.approx(xpos[:, 0], abs=1e-9)
    assert feet[1] == pytest.approx(np.zeros(4), abs=1e-9)
