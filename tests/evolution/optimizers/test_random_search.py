import numpy as np
import pytest
from scipy import stats

from evolution.optimizers.random_search import RandomSearch
from evolution.priors.distributions import ClippedGaussian, Uniform

GENES = [Uniform(), ClippedGaussian.with_floor(1.0)]


def draw(sampling, sizes, seed=0, genes=GENES):
    """Return the genomes of one call of `ask` for each population size in `sizes`."""
    parts = []
    for population in {*sizes}:
        search = RandomSearch(genes, population, sampling, np.random.default_rng(seed))
        for _ in range(sizes.count(population)):
            genomes = search.ask()
            search.tell(genomes, np.zeros(population))
            parts.append(genomes)
    return np.concatenate(parts)


@pytest.mark.parametrize("sampling", ["independent", "sobol"])
def test_genes_follow_their_distributions(sampling):
    genomes = draw(sampling, [2048])
    assert genomes.shape == (2048, 2)
    gaussian = GENES[1]
    truncated = stats.truncnorm(
        -gaussian.mu / gaussian.sigma, 0.0, loc=gaussian.mu, scale=gaussian.sigma
    )  # fmt: skip
    assert stats.kstest(genomes[:, 0], "uniform").pvalue > 0.01
    assert stats.kstest(genomes[:, 1], truncated.cdf).pvalue > 0.01


@pytest.mark.parametrize("sampling", ["independent", "sobol"])
def test_genomes_do_not_depend_on_the_population_size(sampling):
    np.testing.assert_array_equal(draw(sampling, [12]), draw(sampling, [4, 4, 4]))
    assert not np.array_equal(draw(sampling, [12]), draw(sampling, [12], seed=1))


def test_sobol_points_are_more_even_than_independent_ones():
    def largest_gap(sampling):
        return np.diff(np.sort(draw(sampling, [256], genes=[Uniform()] * 3)[:, 2])).max()

    assert largest_gap("sobol") < 2.5 / 256 < largest_gap("independent")
