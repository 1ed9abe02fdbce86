"""The codec between [0, 1]^n and a body with its gait."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as hnp

from caterpillar_env.errors import CaterpillarError
from caterpillar_env.gait import GaitTimings
from caterpillar_env.morphology import LOWER, NAMES, UPPER, Morphology
from caterpillar_env.physics import Physics
from evolution.genome import Encoding

PERIOD_S = 3.0

unit_genomes = hnp.arrays(np.float64, (3, 20), elements=st.floats(0.0, 1.0))
# Near a gene of 0.5 (an action of 0), float32 actions resolve finer steps than times in seconds.
actions_apart_from_zero = hnp.arrays(
    np.float64, (3, 20), elements=st.floats(0.0, 1.0).filter(lambda g: abs(g - 0.5) > 1e-5)
)


def test_paper_genome_has_eight_body_and_twelve_control_genes():
    table = Encoding(Physics(), PERIOD_S).genes
    assert [g.name for g in table[:8]] == list(NAMES)
    assert [g.name for g in table[8:12]] == [
        "gap1_dorsal_on_s", "gap1_dorsal_off_s", "gap1_ventral_on_s", "gap1_ventral_off_s",
    ]  # fmt: skip
    assert len(table) == 20
    assert len({g.name for g in table}) == 20


@pytest.mark.parametrize(("num_segments", "expected"), [(2, 12), (3, 16), (4, 20), (6, 28)])
def test_every_gap_adds_four_control_genes(num_segments, expected):
    assert len(Encoding(Physics(num_segments), PERIOD_S).genes) == expected


def test_gene_bounds_match_the_body_and_the_period():
    table = Encoding(Physics(), 2.5).genes
    assert [g.lower for g in table[:8]] == LOWER.tolist()
    assert [g.upper for g in table[:8]] == UPPER.tolist()
    assert {(g.lower, g.upper, g.unit) for g in table[8:]} == {(0.0, 2.5, "s")}


def test_zero_and_one_decode_to_the_bounds():
    bodies, timings = Encoding(Physics(), PERIOD_S).decode(np.stack([np.zeros(20), np.ones(20)]))
    assert bodies[0].to_array().tolist() == LOWER.tolist()
    assert bodies[1].to_array().tolist() == UPPER.tolist()
    assert timings.on_s.tolist() == [[0.0] * 6, [PERIOD_S] * 6]
    assert timings.off_s.tolist() == [[0.0] * 6, [PERIOD_S] * 6]


def test_each_gene_sets_its_own_parameter():
    genome = np.zeros(20)
    genome[0] = 0.5  # w: half way from 8 to 24 mm
    genome[3] = 0.25  # m: a quarter of the way from 4 to 12 g
    genome[8:12] = [0.25, 0.5, 0.75, 1.0]  # gap 1: dorsal on, off, ventral on, off
    genome[19] = 0.125  # last gene: gap 3, ventral, off
    bodies, timings = Encoding(Physics(), 4.0).decode(genome[None])
    assert bodies[0].leg_separation_m == pytest.approx(0.016, abs=1e-15)
    assert bodies[0].segment_mass_kg == pytest.approx(0.006, abs=1e-15)
    assert timings.on_s[0].tolist() == [1.0, 3.0, 0.0, 0.0, 0.0, 0.0]
    assert timings.off_s[0].tolist() == [2.0, 4.0, 0.0, 0.0, 0.0, 0.5]


@settings(deadline=None)
@given(unit_genomes)
def test_any_genome_decodes_within_bounds(genomes):
    bodies, timings = Encoding(Physics(), PERIOD_S).decode(genomes)
    values = np.stack([body.to_array() for body in bodies])
    assert np.all((values >= LOWER) & (values <= UPPER))
    for times in (timings.on_s, timings.off_s):
        assert times.shape == (3, 6)
        assert np.all((times >= 0) & (times <= PERIOD_S))


@settings(deadline=None)
@given(unit_genomes)
def test_to_unit_inverts_the_decoding_of_a_body(genomes):
    bodies, _ = Encoding(Physics(), PERIOD_S).decode(genomes)
    for body, genome in zip(bodies, genomes, strict=True):
        np.testing.assert_allclose(body.to_unit(), genome[:8], atol=1e-12)


@settings(deadline=None, max_examples=50)
@given(actions_apart_from_zero, st.sampled_from([0.7, 2.0, 3.0, 4.0]))
def test_timings_round_trip_through_the_environment_action(genomes, period_s):
    _, timings = Encoding(Physics(), period_s).decode(genomes)
    action = timings.to_action()
    assert action.dtype == np.float32
    again = GaitTimings.from_action(action, period_s)
    np.testing.assert_array_equal(again.on_s, timings.on_s)
    np.testing.assert_array_equal(again.off_s, timings.off_s)


@settings(deadline=None)
@given(unit_genomes)
def test_genomes_decode_identically_alone_and_in_batches(genomes):
    bodies, timings = Encoding(Physics(), PERIOD_S).decode(genomes)
    for i, genome in enumerate(genomes):
        body, gait = Encoding(Physics(), PERIOD_S).decode(genome[None])
        assert body[0] == bodies[i]
        np.testing.assert_array_equal(gait.on_s[0], timings.on_s[i])
        np.testing.assert_array_equal(gait.off_s[0], timings.off_s[i])


def test_single_genome_is_a_population_of_one():
    encoding = Encoding(Physics(), PERIOD_S)
    genome = np.random.default_rng(0).random(20)
    np.testing.assert_array_equal(encoding.check(genome), genome[None])
    bodies, timings = encoding.decode(genome)
    robot = encoding.robot(genome, fitness_m=0.1)
    assert bodies == [robot.morphology]
    np.testing.assert_array_equal(timings.on_s[0], robot.timings.on_s)
    np.testing.assert_array_equal(timings.off_s[0], robot.timings.off_s)
    assert (robot.physics, robot.fitness_m) == (encoding.physics, 0.1)


def test_empty_population_decodes_to_no_robots():
    bodies, timings = Encoding(Physics(), PERIOD_S).decode(np.empty((0, 20)))
    assert bodies == []
    assert timings.on_s.shape == (0, 6)


def test_decoding_does_not_modify_the_genomes():
    genomes = np.full((2, 20), 0.3)
    Encoding(Physics(), PERIOD_S).decode(genomes)
    assert np.all(genomes == 0.3)


@pytest.mark.parametrize("shape", [(19,), (2, 19), (2, 21), (1, 2, 20), ()])
def test_error_for_a_wrong_shape_names_both_shapes(shape):
    with pytest.raises(CaterpillarError, match=r"shape \(20,\) or \(P, 20\); got \("):
        Encoding(Physics(), PERIOD_S).decode(np.zeros(shape))


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf, -1e-12, 1 + 1e-12, 7.0])
def test_error_for_a_value_outside_the_unit_interval_names_the_gene(value):
    genomes = np.full((3, 20), 0.5)
    genomes[2, 11] = value
    with pytest.raises(CaterpillarError, match="gene 11 of genome 2"):
        Encoding().check(genomes)


def test_unusable_encoding_is_refused():
    with pytest.raises(CaterpillarError, match=r"gait_period_s of 0\.25 s must be a whole multiple"):
        Encoding(Physics(), 0.25)
    with pytest.raises(CaterpillarError, match="must be one of shared, full, per-segment"):
        Encoding(kind="half")


# Other kinds of genome


def test_full_genome_has_timing_genes_for_every_spring():
    table = Encoding(Physics(), PERIOD_S, "full").genes
    assert len(table) == 32
    assert [g.name for g in table[8:12]] == [
        "gap1_dorsal_left_on_s", "gap1_dorsal_left_off_s",
        "gap1_dorsal_right_on_s", "gap1_dorsal_right_off_s",
    ]  # fmt: skip
    genome = np.zeros((1, 32))
    genome[0, 10:12] = 0.5, 1.0
    bodies, timings = Encoding(Physics(), 4.0, "full").decode(genome)
    assert isinstance(bodies[0], Morphology)
    assert timings.on_s.tolist() == [[0.0, 2.0] + [0.0] * 10]
    assert timings.off_s.tolist() == [[0.0, 4.0] + [0.0] * 10]


@pytest.mark.parametrize(("num_segments", "expected"), [(2, 20), (4, 44), (6, 68)])
def test_per_segment_genome_has_a_body_for_every_segment(num_segments, expected):
    table = Encoding(Physics(num_segments), PERIOD_S, "per-segment").genes
    assert len(table) == expected == len({g.name for g in table})
    assert [g.name for g in table[8:10]] == ["segment2_leg_separation_m", "segment2_segment_length_m"]
    unit = np.random.default_rng(0).random((2, expected))
    bodies, timings = Encoding(Physics(num_segments), PERIOD_S, "per-segment").decode(unit)
    assert timings.on_s.shape == (2, 2 * (num_segments - 1))
    for row, body in zip(unit, bodies, strict=True):
        assert len(body) == num_segments
        for number, segment in enumerate(body):
            np.testing.assert_allclose(segment.to_unit(), row[8 * number : 8 * number + 8], atol=1e-12)


@pytest.mark.parametrize(("kind", "size"), [("full", 20), ("per-segment", 32), ("shared", 44)])
def test_genome_of_another_kind_is_refused(kind, size):
    with pytest.raises(CaterpillarError, match=r"genomes must have shape"):
        Encoding(Physics(), PERIOD_S, kind).decode(np.zeros((1, size)))


# Delays and duties


def test_phase_genome_has_a_delay_and_a_duty_for_each_pair():
    table = Encoding(timing="phase").genes
    assert [g.name for g in table[8:12]] == [
        "gap1_dorsal_delay", "gap1_dorsal_duty", "gap1_ventral_delay", "gap1_ventral_duty",
    ]  # fmt: skip
    assert [g.circular for g in table[8:12]] == [True, False, True, False]
    assert [g.parameter for g in table[8:16:2]] == ["start", "offset", "lag", "offset"]
    assert len(table) == 20


def test_wave_genome_has_four_gait_genes_for_any_number_of_segments():
    for segments in (2, 4, 16):
        table = Encoding(Physics(segments), timing="wave").genes
        names = [g.name for g in table[8:]]
        assert names == ["lag", "dorsal_duty", "offset", "ventral_duty"]


@pytest.mark.parametrize(
    ("kind", "timing", "count"),
    [
        ("shared", "phase", 20), ("shared", "wave", 12), ("full", "phase", 32),
        ("per-segment", "phase", 44), ("per-segment", "wave", 36),
    ],
)  # fmt: skip
def test_every_genome_kind_works_with_every_timing(kind, timing, count):
    encoding = Encoding(kind=kind, timing=timing)
    assert len(encoding.genes) == count
    bodies, timings = encoding.decode(np.full((2, count), 0.4))
    assert len(bodies) == 2
    assert timings.on_s.shape == (2, 12 if kind == "full" else 6)


def test_phases_add_up_along_the_body():
    genome = np.full(20, 0.5)
    genome[8:] = [0.1, 0.4, 0.5, 0.4, 0.7, 0.4, 0.2, 0.4, 0.6, 0.4, 0.9, 0.4]
    _, timings = Encoding(timing="phase", gait_period_s=10.0).decode(genome)
    # Dorsal: 0.1, 0.1 + 0.7, 0.8 + 0.6 = 1.4 -> 0.4. Ventral: 0.6, 1.0 -> 0.0, 1.3 -> 0.3.
    assert timings.on_s[0] == pytest.approx([1, 6, 8, 0, 4, 3], abs=1e-5)
    assert timings.off_s[0] == pytest.approx([4.8, 9.8, 1.8, 3.8, 7.8, 6.8], abs=1e-5)  # 0.4 * 0.95


def test_wave_is_the_phase_genome_with_equal_delays_and_duties():
    rng = np.random.default_rng(0)
    body, (lag, dorsal, offset, ventral) = rng.random(8), rng.random(4)
    wave = np.array([*body, lag, dorsal, offset, ventral])
    gap = [lag, dorsal, offset, ventral]
    phase = np.array([*body, 0.0, *gap[1:], *gap, *gap])
    one, other = (
        Encoding(timing=timing).decode(genome)[1]
        for timing, genome in (("wave", wave), ("phase", phase))
    )
    np.testing.assert_array_equal(one.on_s, other.on_s)
    np.testing.assert_array_equal(one.off_s, other.off_s)


def test_right_springs_follow_left_springs_by_their_own_delay():
    encoding = Encoding(Physics(2), kind="full", timing="phase", gait_period_s=10.0)
    genome = np.full(16, 0.5)
    genome[8::2] = [0.1, 0.2, 0.3, 0.0]  # dorsal left, dorsal right, ventral left, ventral right
    _, timings = encoding.decode(genome)
    assert timings.on_s[0] == pytest.approx([1, 3, 4, 4], abs=1e-5)


def test_delays_of_zero_and_one_are_the_same_gait():
    genomes = np.full((2, 12), 0.3)
    genomes[:, 8] = 0.0, 1.0
    _, timings = Encoding(timing="wave").decode(genomes)
    np.testing.assert_allclose(timings.on_s[0], timings.on_s[1], atol=1e-6)


def test_largest_duty_leaves_a_spring_on_for_most_of_the_period():
    _, timings = Encoding(timing="wave").decode(np.ones(12))
    powered = timings.power(0.01).mean(axis=-2)
    assert powered == pytest.approx(0.95, abs=0.002)


def test_environment_reproduces_a_wave_bit_for_bit():
    _, timings = Encoding(timing="wave").decode(np.random.default_rng(1).random((4, 12)))
    again = GaitTimings.from_action(timings.to_action(), timings.period_s)
    np.testing.assert_array_equal(again.on_s, timings.on_s)
    np.testing.assert_array_equal(again.off_s, timings.off_s)


def test_values_are_in_the_units_of_the_genes():
    encoding = Encoding(timing="wave")
    (low, high), (lower, upper) = (
        encoding.values(np.array([np.zeros(12), np.ones(12)])),
        zip(*((gene.lower, gene.upper) for gene in encoding.genes), strict=True),
    )
    assert low.tolist() == list(lower)
    assert high.tolist() == pytest.approx(list(upper))
