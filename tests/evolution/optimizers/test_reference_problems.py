"""Optimizers on problems with known answers, in the box [0, 1]^n; fitness is 1 / (1 + value)."""

import numpy as np
import pytest

from evolution.optimizers.cma_es import CmaConfig, CmaEs
from evolution.optimizers.ga import GaConfig, GeneticAlgorithm
from evolution.optimizers.random_search import RandomSearch
from evolution.optimizers.shade import Shade, ShadeConfig
from evolution.priors.distributions import Uniform

DIMENSIONS = 6


def sphere(x):
    """The minimum is 0, at 0.3 in every gene."""
    return ((10 * (x - 0.3)) ** 2).sum(axis=1)


def rastrigin(x):
    """The minimum is 0, at 0.6 in every gene, among a thousand local minima."""
    z = 10.24 * (x - 0.6)
    return (z**2 - 10 * np.cos(2 * np.pi * z) + 10).sum(axis=1)


def rosenbrock(x):
    """The minimum is 0, at 0.75 in every gene, at the end of a curved valley."""
    z = 4 * x - 2
    return (100 * (z[:, 1:] - z[:, :-1] ** 2) ** 2 + (1 - z[:, :-1]) ** 2).sum(axis=1)


def least(optimizer, problem, evaluations, enough=-np.inf):
    """Return the lowest value within ``evaluations``, and its genome; stop early below ``enough``."""
    best, where, done = np.inf, None, 0
    while done < evaluations and best >= enough:
        genomes = optimizer.ask()
        assert ((genomes >= 0) & (genomes <= 1)).all()
        values = problem(genomes)
        optimizer.tell(genomes, 1 / (1 + values))
        done += len(genomes)
        if values.min() < best:
            best, where = values.min(), genomes[values.argmin()]
    return best, where


def cma_es(seed=0, **config):
    return CmaEs([Uniform()] * DIMENSIONS, CmaConfig(**config), np.random.default_rng(seed))


def ga(seed=0):
    genes = [Uniform()] * DIMENSIONS
    return GeneticAlgorithm(genes, genes, GaConfig(population=100), np.random.default_rng(seed))


def shade(seed=0):
    genes = [Uniform()] * DIMENSIONS
    return Shade(genes, ShadeConfig(30), np.random.default_rng(seed))


def random_search(seed=0):
    return RandomSearch([Uniform()] * DIMENSIONS, 100, "independent", np.random.default_rng(seed))


@pytest.mark.parametrize(
    ("make", "problem", "optimum", "evaluations", "value", "near"),
    [
        (cma_es, sphere, 0.3, 2_000, 1e-9, 1e-5),
        (cma_es, rosenbrock, 0.75, 6_000, 1e-9, 1e-5),
        # The number of restarts needed depends on the seed and on the CPU's linear algebra.
        (cma_es, rastrigin, 0.6, 200_000, 1e-9, 1e-5),
        (shade, sphere, 0.3, 6_000, 1e-6, 1e-3),
        (shade, rosenbrock, 0.75, 20_000, 1e-6, 1e-3),
        (shade, rastrigin, 0.6, 20_000, 1e-6, 1e-3),
    ],
)
def test_the_known_optimum_is_found(make, problem, optimum, evaluations, value, near):
    found, where = least(make(), problem, evaluations, enough=value / 1000)
    assert found < value
    np.testing.assert_allclose(where, optimum, atol=near)


@pytest.mark.parametrize(("problem", "value"), [(sphere, 0.5), (rosenbrock, 15.0), (rastrigin, 12.0)])
def test_the_genetic_algorithm_beats_random_search_and_nears_the_optimum(problem, value):
    evolved = [least(ga(seed), problem, 10_000)[0] for seed in range(5)]
    random = [least(random_search(seed), problem, 10_000)[0] for seed in range(5)]
    assert np.median(evolved) < value
    assert np.median(evolved) < np.median(random)
