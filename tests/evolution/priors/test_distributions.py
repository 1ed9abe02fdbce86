"""Distributions that genes are drawn from."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats
from scipy.integrate import quad

from evolution.priors.distributions import ClippedGaussian, Uniform, WrappedGaussian

PEAKS = [0.0, 1 / 9, 0.5, 7 / 9, 1.0]
SHAPES = [ClippedGaussian.with_floor(mu) for mu in PEAKS] + [
    ClippedGaussian(0.3, 0.05),
    ClippedGaussian(1.0, 5.0),
]


def reference(gaussian):
    low, high = -gaussian.mu / gaussian.sigma, (1 - gaussian.mu) / gaussian.sigma
    return stats.truncnorm(low, high, loc=gaussian.mu, scale=gaussian.sigma)


@pytest.mark.parametrize(
    ("mu", "distance"), [(0.0, 1.0), (1.0, 1.0), (0.5, 0.5), (0.25, 0.75), (0.75, 0.75)]
)
def test_sigma_is_the_distance_to_the_farther_bound_over_sqrt_2_ln_3(mu, distance):
    # 1 / sqrt(2 ln 3) = 1 / 1.4823038 = 0.6746255
    assert ClippedGaussian.with_floor(mu).sigma == pytest.approx(0.6746255 * distance, rel=1e-6)


@pytest.mark.parametrize("mu", PEAKS)
@pytest.mark.parametrize("ratio", [3.0, 10.0, 100.0])
def test_ratio_of_highest_to_lowest_density_is_the_floor_ratio(mu, ratio):
    gaussian = ClippedGaussian.with_floor(mu, ratio)
    density = gaussian.density(np.append(np.linspace(0, 1, 10_001), mu))
    assert density.min() / density.max() == pytest.approx(1 / ratio, rel=1e-12)
    assert density[-1] == density.max()


@pytest.mark.parametrize("distribution", [Uniform(), *SHAPES, WrappedGaussian(0.3, 0.2)], ids=str)
def test_density_integrates_to_one(distribution):
    total, _ = quad(lambda x: float(distribution.density(np.float64(x))), 0, 1, points=[0.3])
    assert total == pytest.approx(1.0, abs=1e-8)


@pytest.mark.parametrize("distribution", [Uniform(), *SHAPES], ids=str)
def test_density_outside_the_range_is_zero(distribution):
    outside = np.array([-1.0, -1e-9, 1 + 1e-9, 2.0])
    assert distribution.density(outside).tolist() == [0.0] * 4


@pytest.mark.parametrize("gaussian", SHAPES, ids=str)
def test_density_equals_that_of_a_truncated_normal(gaussian):
    x = np.linspace(0, 1, 101)
    np.testing.assert_allclose(gaussian.density(x), reference(gaussian).pdf(x), rtol=1e-9)


def test_uniform_samples_follow_the_uniform_distribution():
    draws = Uniform().sample(np.random.default_rng(7), 20_000)
    assert stats.kstest(draws, "uniform").pvalue > 0.01


def test_no_mass_piles_up_on_the_bounds():
    # Clamping instead of truncating would put half of the draws on the bound itself.
    draws = ClippedGaussian.with_floor(1.0).sample(np.random.default_rng(0), 10_000)
    assert not np.any((draws == 0.0) | (draws == 1.0))


def test_clamped_gaussian_puts_the_rest_of_its_mass_on_the_bounds():
    draws = ClippedGaussian(0.9, 0.2, "clamped").sample(np.random.default_rng(0), 20_000)
    assert np.mean(draws == 1.0) == pytest.approx(stats.norm.sf(0.5), abs=0.01)
    assert np.all((draws >= 0.0) & (draws <= 1.0))


@settings(deadline=None)
@given(
    mu=st.floats(0.0, 1.0),
    sigma=st.floats(1e-3, 1e3),
    seed=st.integers(0, 2**32 - 1),
)
def test_samples_lie_in_the_unit_interval(mu, sigma, seed):
    draws = ClippedGaussian(mu, sigma).sample(np.random.default_rng(seed), 50)
    assert draws.shape == (50,)
    assert np.all((draws >= 0) & (draws <= 1))


@pytest.mark.parametrize("distribution", [Uniform(), *SHAPES], ids=str)
def test_a_draw_uses_one_uniform_number(distribution):
    # Study arms that differ in the distribution of one gene then draw equal values for other genes.
    used, counted = np.random.default_rng(5), np.random.default_rng(5)
    distribution.sample(used, 17)
    counted.random(17)
    assert used.random() == counted.random()


@pytest.mark.parametrize("gaussian", SHAPES, ids=str)
def test_a_draw_is_the_quantile_of_its_uniform_number(gaussian):
    quantiles = np.random.default_rng(11).random(100)
    draws = gaussian.sample(np.random.default_rng(11), 100)
    np.testing.assert_allclose(draws, reference(gaussian).ppf(quantiles), rtol=1e-9, atol=1e-12)


def test_wide_gaussian_approaches_the_uniform_distribution():
    density = ClippedGaussian(0.2, 1e3).density(np.linspace(0, 1, 11))
    np.testing.assert_allclose(density, 1.0, rtol=1e-6)


# Circular genes


CIRCLES = [WrappedGaussian.with_floor(mu) for mu in (0.0, 0.2, 0.5, 0.9)]


@pytest.mark.parametrize("circle", CIRCLES, ids=str)
def test_circular_density_depends_on_the_distance_around_the_circle(circle):
    x = np.linspace(0, 1, 101)
    way = np.abs((x - circle.mu + 0.5) % 1.0 - 0.5)
    centred = ClippedGaussian.with_floor(0.5)
    np.testing.assert_allclose(circle.density(x), centred.density(0.5 + way))
    assert circle.density(np.array([0.0])) == pytest.approx(circle.density(np.array([1.0])))


@pytest.mark.parametrize("circle", CIRCLES, ids=str)
def test_circular_samples_follow_their_density(circle):
    draws = circle.sample(np.random.default_rng(7), 20_000)
    counts, edges = np.histogram(draws, bins=20, range=(0, 1))
    middles = (edges[1:] + edges[:-1]) / 2
    expected = circle.density(middles)
    assert stats.chisquare(counts, expected * counts.sum() / expected.sum()).pvalue > 0.01


def test_least_circular_density_is_opposite_to_the_peak():
    circle = WrappedGaussian.with_floor(0.7, 3.0)
    density = circle.density(np.array([0.7, 0.2]))
    assert density[0] / density[1] == pytest.approx(3.0)


def test_mirrored_peaks_are_at_the_other_end_or_opposite_on_the_circle():
    assert ClippedGaussian(0.9, 0.3).mirrored() == ClippedGaussian(pytest.approx(0.1), 0.3)
    assert WrappedGaussian(0.7, 0.3).mirrored() == WrappedGaussian(pytest.approx(0.2), 0.3)
