"""The design parameters of the gait, and the priors that they give to each kind of gait genes."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.stats import spearmanr

from caterpillar_env.errors import CaterpillarError
from caterpillar_env.gait import GaitTimings
from caterpillar_env.morphology import Morphology
from caterpillar_env.physics import SMA_STEP_S, Physics
from caterpillar_env.robot import simulate
from caterpillar_env.sma import settle
from evolution.config import RunConfig
from evolution.genome import Encoding
from evolution.priors import make_priors, searches
from evolution.priors.distributions import ClippedGaussian, Uniform, WrappedGaussian
from evolution.priors.gait import INSTANTS, advance, gait_parameters
from evolution.priors.statics import PlanarChain

WAVE, PHASE = Encoding(timing="wave"), Encoding(timing="phase")
PHYSICS = Physics()
STROKE, ADVANCE = gait_parameters(PHYSICS, 5.0)


def distributions(encoding, prior="body+gait", **settings):
    return {row.gene.name: row.distribution for row in make_priors(encoding, prior, **settings)}


# K_4


def test_stroke_is_full_at_a_duty_of_one_fifth():
    # A spring heats in about 1 s and cools in 2.8 s: 1 s on and 4 s off give a full stroke.
    duty = np.array([0.0, 0.1, 0.2, 0.5, 0.75, 0.95])
    stroke = STROKE.formula(duty)
    assert stroke[[0, 4, 5]] == pytest.approx([0, 0, 0], abs=1e-6)  # never warm, or never cool
    assert stroke[2] == pytest.approx(1.0, abs=0.01)
    assert 0 < stroke[1] < stroke[2]
    assert 0.3 < stroke[3] < 0.6


def test_longer_period_leaves_more_time_to_cool():
    (short, _), (long, _) = (gait_parameters(PHYSICS, period) for period in (3.0, 10.0))
    half = np.array([0.5])
    assert short.formula(half) < STROKE.formula(half) < long.formula(half)


# K_5


def test_waves_from_the_tail_move_forwards_and_from_the_head_backwards():
    lag, offset, duty = np.array([0.7, 0.3, 0.0]), np.full(3, 0.5), np.full(3, 0.2)
    forward, backward, standing = ADVANCE.formula(lag, offset, duty)
    assert forward > 0.015
    assert backward < -0.010
    assert abs(standing) < 0.3 * forward


def test_springs_that_never_cool_do_not_advance():
    hot = ADVANCE.formula(np.array([0.7]), np.array([0.5]), np.array([0.9]))
    assert abs(hot[0]) < 0.002


def test_spring_that_is_always_powered_stays_hot():
    on_s = np.array([[0.0, 2.5, 3.3, 0.8, 1.7, 4.2]])
    off_s = on_s + 1.0
    advances_m = []
    for end_s in (0.0, 5.0, 4.9999):
        off_s[0, 0] = end_s
        timings = GaitTimings(5.0, on_s, np.where(off_s > 5.0, off_s - 5.0, off_s))
        advances_m.append(advance([Morphology()], timings, PHYSICS)[0])
    never, always, nearly = advances_m
    assert always == pytest.approx(nearly, abs=1e-5)
    assert abs(always - never) > 1e-3


@pytest.mark.slow
def test_advance_ranks_gaits_as_the_simulator_does():
    # `python -m benchmarks.advance` compares 200 gaits; 30 gaits scatter about its correlation.
    rng = np.random.default_rng(3)
    lag, offset, duty = rng.random(30), rng.random(30), rng.uniform(0.1, 0.4, 30)
    delay, duties = np.zeros((30, 6)), np.repeat(duty[:, None], 6, axis=1)
    delay[:, 2::2], delay[:, 1::2] = lag[:, None], offset[:, None]
    timings = GaitTimings.from_phases(delay, duties, 5.0)
    crawled = simulate([Morphology()] * 30, timings, Physics(), duration_s=10.0)
    assert spearmanr(ADVANCE.formula(lag, offset, duty), crawled.distance_m)[0] > 0.6


def test_advance_follows_the_springs_of_a_gait_with_different_duties():
    timings = GaitTimings(
        5.0, np.array([[0, 2.5, 1, 3.5, 2, 4.5]]), np.array([[1.0, 0.0, 2.2, 4.2, 4.0, 0.4]])
    )
    power = np.moveaxis(timings.power(SMA_STEP_S), 0, -1)  # (steps, pairs, robots)
    fraction = settle(PHYSICS.spring, power, SMA_STEP_S).path.fraction
    steps = np.arange(INSTANTS + 1) * len(fraction) // INSTANTS % len(fraction)
    head_m = PlanarChain([Morphology()], PHYSICS).crawl(fraction[steps], 5.0 / INSTANTS)
    found_m = advance([Morphology()], timings, PHYSICS)
    assert abs(found_m[0]) > 0.004
    assert found_m == pytest.approx(head_m[-1] - head_m[0], rel=0.02)


def test_advance_is_equal_for_pairs_and_springs_alone_and_in_batches():
    genomes = np.random.default_rng(1).random((3, len(WAVE.genes)))
    bodies, pairs = WAVE.decode(genomes)
    together = advance(bodies, pairs, PHYSICS)
    assert advance(bodies, pairs.mirrored(), PHYSICS) == pytest.approx(together, abs=1e-12)
    for body, on_s, off_s, expected in zip(bodies, pairs.on_s, pairs.off_s, together, strict=True):
        alone = advance([body], GaitTimings(5.0, on_s[None], off_s[None]), PHYSICS)
        assert alone == pytest.approx(expected, abs=1e-6)


def test_springs_of_one_side_advance_less_than_both():
    gap, ventral = np.divmod(np.arange(6), 2)
    on_s = np.repeat((gap * 0.7 + ventral * 0.5) % 1.0 * 5.0, 2)
    off_s = (on_s + 1.0) % 5.0
    is_left = np.tile([True, False], 6)
    rows = np.stack([off_s, np.where(is_left, off_s, on_s), np.where(is_left, on_s, off_s)])
    both, left, right = advance([Morphology()], GaitTimings(5.0, np.tile(on_s, (3, 1)), rows), PHYSICS)
    assert left == pytest.approx(right, abs=1e-12)
    assert 0.1 * both < left < 0.9 * both


# Priors


def test_best_wave_runs_from_the_tail_with_ventral_springs_half_a_period_later():
    found = {search.parameter.name: search for search in searches(WAVE, "gait")}
    lag, offset, _ = found["advance"].best
    assert lag in (7, 8)
    assert offset in (4, 5, 6)
    assert found["stroke"].best[0] == found["advance"].best[2] == 2  # a duty of 21 %


def test_wave_genes_have_the_peaks_of_the_best_nodes():
    gait = distributions(WAVE, "gait")
    lag, offset, duty = (gait[name] for name in ("lag", "offset", "dorsal_duty"))
    assert isinstance(lag, WrappedGaussian)
    assert isinstance(offset, WrappedGaussian)
    assert duty == gait["ventral_duty"] == ClippedGaussian.with_floor(2 / 9)
    assert gait["leg_separation_m"] == Uniform()
    assert distributions(WAVE)["leg_separation_m"] == ClippedGaussian.with_floor(1.0)


def test_phase_genes_share_the_peaks_of_the_wave():
    wave, phase = distributions(WAVE), distributions(PHASE)
    assert phase["gap1_dorsal_delay"] == Uniform()  # shifts the whole gait in time
    assert phase["gap2_dorsal_delay"] == phase["gap3_dorsal_delay"] == wave["lag"]
    assert phase["gap1_ventral_delay"] == phase["gap3_ventral_delay"] == wave["offset"]
    assert phase["gap1_dorsal_duty"] == phase["gap3_ventral_duty"] == wave["dorsal_duty"]


def test_on_and_off_times_peak_at_those_of_the_best_wave():
    wave, times = distributions(WAVE), distributions(Encoding())
    lag, offset, duty = wave["lag"].mu, wave["offset"].mu, 0.95 * wave["dorsal_duty"].mu
    on = {"gap1_dorsal": 0.0, "gap1_ventral": offset, "gap3_ventral": 2 * lag + offset}
    for pair, start in on.items():
        assert times[f"{pair}_on_s"].mu == pytest.approx(start % 1, abs=1e-6)
        assert times[f"{pair}_off_s"].mu == pytest.approx((start + duty) % 1, abs=1e-6)
    springs = distributions(Encoding(kind="full"))
    assert springs["gap2_dorsal_left_on_s"] == springs["gap2_dorsal_right_on_s"]
    assert springs["gap2_dorsal_left_on_s"] == times["gap2_dorsal_on_s"]


def test_delay_between_left_and_right_springs_is_uniform():
    springs = distributions(replace(PHASE, kind="full"))
    assert springs["gap2_dorsal_left_delay"] == distributions(PHASE)["gap2_dorsal_delay"]
    assert springs["gap2_dorsal_right_delay"] == Uniform()  # K_5 is planar


@pytest.mark.parametrize("encoding", [PHASE, replace(PHASE, kind="full")], ids=["pairs", "springs"])
def test_prior_of_the_body_leaves_the_gait_uniform(encoding):
    shapes = distributions(encoding, "body")
    assert {shape for name, shape in shapes.items() if name.startswith("gap")} == {Uniform()}


def test_robots_of_all_lengths_have_the_same_wave():
    four, eight = (distributions(Encoding(Physics(n), timing="wave"), "gait") for n in (4, 8))
    assert four == eight


def test_controls_mirror_or_shuffle_the_same_distributions():
    wave = distributions(WAVE)
    mirrored = distributions(WAVE, control="mirrored")
    shuffled = distributions(WAVE, control="shuffled", seed=1)
    assert mirrored["lag"].mu == pytest.approx((wave["lag"].mu + 0.5) % 1)
    assert mirrored["leg_separation_m"].mu == 0.0
    assert mirrored["joint_limit_rad"] == Uniform()
    assert sorted(map(repr, shuffled.values())) == sorted(map(repr, wave.values()))
    assert shuffled != wave
    assert shuffled != distributions(WAVE, control="shuffled", seed=2)
    assert shuffled == distributions(WAVE, control="shuffled", seed=1)


def test_mirrored_on_and_off_times_are_those_of_the_mirrored_wave():
    wave, times = (distributions(e, control="mirrored") for e in (WAVE, Encoding()))
    lag, offset, duty = wave["lag"].mu, wave["offset"].mu, 0.95 * wave["dorsal_duty"].mu
    assert duty > 0.7
    for pair, start in {"gap1_dorsal": 0.0, "gap3_ventral": 2 * lag + offset}.items():
        assert times[f"{pair}_on_s"].mu == pytest.approx(start % 1, abs=1e-6)
        assert times[f"{pair}_off_s"].mu == pytest.approx((start + duty) % 1, abs=1e-6)


def test_a_design_parameter_can_be_left_out():
    full, without = distributions(WAVE), distributions(WAVE, without="lifting moment")
    changed = {name for name in full if full[name] != without[name]}
    assert changed == {"segment_length_m", "segment_mass_kg", "attachment_x_m", "attachment_y_m"}
    assert isinstance(without["segment_length_m"], Uniform)
    times = distributions(Encoding(), without="advance")
    assert isinstance(times["gap1_dorsal_on_s"], Uniform)  # no K_i prefers a wave
    # The preset `ablation` states this in a comment.
    assert distributions(WAVE, without="stroke") == full
    with pytest.raises(
        CaterpillarError, match="to leave out, 'stroke', must belong to the prior 'body'"
    ):
        RunConfig(prior_without="stroke")
