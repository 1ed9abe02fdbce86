"""The paper's design parameters of the body, and the table of priors that they give."""

from functools import partial

import numpy as np
import pytest

from caterpillar_env.errors import CaterpillarError
from caterpillar_env.morphology import PARAMETERS
from caterpillar_env.physics import GRAVITY_M_S2, Physics
from evolution.genome import Encoding
from evolution.priors import make_priors
from evolution.priors.body import (
    PITCH_ANGLES,
    body_parameters,
    lifting_moment,
    roll_stability,
    yaw_stability,
)
from evolution.priors.distributions import ClippedGaussian, Uniform
from evolution.priors.preprocessor import search_grid

BOUNDS = {p.name: (p.lower, p.upper) for p in PARAMETERS}


def table_one(**kwargs):
    rows = make_priors(Encoding(Physics(**kwargs), 3.0))
    return {row.gene.name: row for row in rows}


def array(*values):
    return tuple(np.array(v) for v in values)


def lift(stiffness_n_m=35.0, rest_length_m=0.016, joint_limit_rad=0.0):
    """Return the lifting moment as a function of its genes, by default for a level segment."""
    return partial(
        lifting_moment, stiffness_n_m=stiffness_n_m, rest_length_m=rest_length_m,
        radius_m=0.012, joint_limit_rad=joint_limit_rad,
    )  # fmt: skip


# Formulas


def test_roll_stability_of_a_hand_computed_segment():
    # 8 g, w = 16 mm, R = 12 mm: 0.008 * 9.81 * (16 / 24) / 2 N
    assert roll_stability(*array(0.008, 0.016, 0.012)) == pytest.approx(0.02616, rel=1e-12)


def test_roll_stability_balances_the_moments_about_a_foot():
    force = roll_stability(*array(0.01, 0.02, 0.01))
    height, half_track = 2 * 0.01, 0.02 / 2
    assert force * height == pytest.approx(0.01 * 9.81 * half_track, rel=1e-12)


def test_yaw_stability_of_a_hand_computed_segment():
    # 0.8 * 0.008 * 9.81 * 16 / (2 * 6 + 16) N = 0.062784 * 4 / 7 N
    value = yaw_stability(*array(0.008, 0.016, 0.006), friction=0.8)
    assert value == pytest.approx(0.062784 * 4 / 7, rel=1e-12)


def test_level_lifting_moment_of_a_hand_computed_segment():
    # k (L + 2x - Delta)(y + 2R) - m g L / 2 = 35 * 0.020 * 0.0305 - 0.008 * 9.81 * 0.015 N m
    value = lift()(*array(0.003, 0.0065, 0.008, 0.030))
    assert value == pytest.approx(0.02135 - 0.0011772, rel=1e-12)


def test_slack_spring_adds_no_lifting_moment():
    moment = lift(rest_length_m=0.050)(*array(0.0, 0.0065, 0.008, 0.030))  # longer than L + 2x
    assert moment == pytest.approx(-0.0011772, rel=1e-12)


def test_lifting_moment_is_the_slope_of_the_potential_energy():
    # Virtual work: the moment about b is -dU/dtheta of the spring's and the weight's energy.
    k, rest, radius, limit = 35.0, 0.016, 0.012, 0.6
    x, y, m, length = 0.003, 0.0065, 0.008, 0.030
    h = 2 * radius

    def energy(theta):
        turn = np.array([[np.cos(theta), -np.sin(theta)], [np.sin(theta), np.cos(theta)]])
        anchor = turn @ [length / 2 + x, y + h]
        stretch = np.linalg.norm(anchor - [-length / 2 - x, y + h]) - rest
        return k * stretch**2 / 2 + m * GRAVITY_M_S2 * (turn @ [length / 2, h])[1]

    angles, step = np.linspace(0, limit, PITCH_ANGLES), 1e-6
    slopes = [(energy(t + step) - energy(t - step)) / (2 * step) for t in angles]
    value = lift(k, rest, limit)(*array(x, y, m, length))
    assert value == pytest.approx(-np.mean(slopes), rel=1e-7)


SIGNS = [
    (body_parameters(Physics())[0], ["segment_mass_kg", "leg_separation_m"], ["segment_radius_m"]),
    (body_parameters(Physics())[1], ["segment_mass_kg", "leg_separation_m"], ["attachment_z_m"]),
    (
        body_parameters(Physics())[2]._replace(name="level lift", formula=lift()),
        ["attachment_x_m", "attachment_y_m", "segment_length_m"],
        ["segment_mass_kg"],
    ),
]


def changes(parameter, gene):
    """Change of K_i when one gene grows by a thousandth of its range, at random bodies."""
    rng = np.random.default_rng(0)
    points = {n: rng.uniform(*BOUNDS[n], size=500) for n in parameter.gene_names}
    low, high = BOUNDS[gene]
    moved = {**points, gene: points[gene] + 1e-3 * (high - low)}
    return parameter.formula(*moved.values()) - parameter.formula(*points.values())


@pytest.mark.parametrize(("parameter", "rising", "falling"), SIGNS, ids=lambda p: getattr(p, "name", ""))
def test_each_gene_changes_its_parameter_as_in_the_paper(parameter, rising, falling):
    assert {*rising, *falling} == set(parameter.gene_names)
    for gene in rising:
        assert np.all(changes(parameter, gene) > 0), gene
    for gene in falling:
        assert np.all(changes(parameter, gene) < 0), gene


def test_lift_over_all_pitch_angles_keeps_the_signs_for_nearly_all_bodies():
    # With a higher anchor, a pitched spring goes slack sooner: for a few bodies, y lowers the mean.
    moment = body_parameters(Physics())[2]
    for gene in ("attachment_x_m", "attachment_y_m", "segment_length_m"):
        assert np.mean(changes(moment, gene) > 0) > 0.95, gene
    assert np.mean(changes(moment, "segment_mass_kg") < 0) > 0.95


# Table I


@pytest.mark.parametrize(
    ("gene", "peak"),
    [
        ("leg_separation_m", 1.0),
        ("segment_length_m", 1.0),
        ("attachment_x_m", 1.0),
        ("attachment_y_m", 1.0),
        ("segment_radius_m", 0.0),
        ("attachment_z_m", 0.0),
    ],
)
def test_paper_genes_peak_at_their_bounds(gene, peak):
    assert table_one()[gene].distribution == ClippedGaussian.with_floor(peak)


def test_mass_is_uniform_because_lift_contradicts_stability():
    row = table_one()["segment_mass_kg"]
    assert row.distribution == Uniform()
    assert row.reason.startswith("contradiction")
    assert dict(row.signs) == {"roll stability": 1, "yaw stability": 1, "lifting moment": -1}


def test_joint_limit_and_timings_are_uniform_without_a_design_parameter():
    rows = table_one()
    free = {n: r for n, r in rows.items() if n == "joint_limit_rad" or n.startswith("gap")}
    assert len(free) == 13
    assert {r.distribution for r in free.values()} == {Uniform()}
    assert {r.reason for r in free.values()} == {"in no design parameter"}
    assert {r.signs for r in free.values()} == {()}


def test_roll_and_yaw_both_prefer_wide_feet():
    row = table_one()["leg_separation_m"]
    assert dict(row.signs) == {"roll stability": 1, "yaw stability": 1}
    assert "roll stability" in row.reason
    assert "yaw stability" in row.reason


def test_longer_robot_has_the_same_table_with_more_timings():
    four, six = table_one(), table_one(num_segments=6)
    assert len(six) == 8 + 4 * 5
    for p in PARAMETERS:
        assert six[p.name].distribution == four[p.name].distribution
    assert six["gap5_ventral_off_s"].distribution == Uniform()


def test_per_segment_genes_have_the_same_priors_as_shared_genes():
    shared = table_one()
    rows = make_priors(Encoding(Physics(), 3.0, "per-segment"))
    assert len(rows) == 44
    for row in rows[:32]:
        segment, name = row.gene.name.split("_", 1)
        assert segment in ("segment1", "segment2", "segment3", "segment4")
        assert row.distribution == shared[name].distribution
        assert row.signs == shared[name].signs


def test_timings_of_single_springs_are_uniform_like_those_of_pairs():
    rows = {r.gene.name: r for r in make_priors(Encoding(Physics(), 3.0, "full"))}
    assert len(rows) == 32
    for name, row in table_one().items():
        if name in rows:
            assert row.distribution == rows[name].distribution
    assert rows["gap3_ventral_right_off_s"].distribution == Uniform()


def test_without_spring_force_lift_prefers_short_and_light_segments():
    # Only the weight's moment m g L / 2 is left, which a short segment keeps small.
    moment = body_parameters(Physics())[2]
    genes = {gene.name: gene for gene in Encoding().genes}
    chosen = tuple(genes[name] for name in moment.gene_names)
    search = search_grid(moment._replace(formula=lift(stiffness_n_m=1e-9)), chosen)
    assert search.node("segment_length_m") == 0
    assert search.node("segment_mass_kg") == 0


def test_floor_ratio_narrows_the_gaussians():
    rows = make_priors(Encoding(Physics(), 3.0), floor_ratio=10.0)
    row = next(r for r in rows if r.gene.name == "leg_separation_m")
    # 1 / sqrt(2 ln 10) = 0.4659906
    assert row.distribution.sigma == pytest.approx(0.4659906, rel=1e-6)


@pytest.mark.parametrize("ratio", [1.0, 0.5, -3.0, np.nan, np.inf])
def test_floor_ratio_that_makes_no_gaussian_is_refused(ratio):
    with pytest.raises(CaterpillarError, match="floor_ratio"):
        make_priors(Encoding(Physics(), 3.0), floor_ratio=ratio)


def test_rows_as_json_are_in_the_genes_unit():
    rows = {r.gene.name: r.to_dict() for r in make_priors(Encoding(Physics(), 3.0))}
    wide = rows["leg_separation_m"]  # 8 to 24 mm, peak at the upper bound
    assert set(wide) == {
        "gene", "symbol", "unit", "kind", "mu", "sigma", "lower", "upper", "reason",
    }  # fmt: skip
    assert wide["kind"] == "truncated_gaussian"
    assert wide["mu"] == pytest.approx(0.024)
    assert wide["sigma"] == pytest.approx(0.6746255 * 0.016, rel=1e-6)
    assert (wide["symbol"], wide["unit"]) == ("w", "m")
    timing = rows["gap1_dorsal_on_s"]
    assert timing["kind"] == "uniform"
    assert (timing["mu"], timing["sigma"]) == (None, None)
    assert (timing["lower"], timing["upper"]) == (0.0, 3.0)
