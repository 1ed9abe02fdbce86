"""SHADE: its first population, its trials, and what it keeps."""

import numpy as np
import pytest

from caterpillar_env.errors import CaterpillarError
from evolution.optimizers.shade import DRAWS, Shade, ShadeConfig
from evolution.priors.distributions import ClippedGaussian, Uniform, WrappedGaussian

SIZE = 10


def started(seed=0, genes=None, **settings):
    genes = genes or [Uniform()] * 5
    return Shade(genes, ShadeConfig(SIZE), np.random.default_rng(seed), **settings)


def run(optimizer, generations, fitness_of):
    asked = []
    for _ in range(generations):
        genomes = optimizer.ask()
        asked.append(genomes)
        optimizer.tell(genomes, fitness_of(genomes))
    return asked


def sphere(genomes):
    return -((genomes - 0.3) ** 2).sum(axis=1)


def test_first_generation_follows_the_prior_and_its_best_are_kept():
    optimizer = started(genes=[ClippedGaussian(0.9, 0.05), Uniform()])
    first = optimizer.ask()
    assert first.shape == (DRAWS * SIZE, 2)
    assert np.median(first[:, 0]) == pytest.approx(0.9, abs=0.04)
    optimizer.tell(first, sphere(first))
    assert optimizer.ask().shape == (SIZE, 2)


def test_genome_is_replaced_only_by_a_trial_that_is_at_least_as_good():
    optimizer = started()
    first = optimizer.ask()
    optimizer.tell(first, sphere(first))
    trials = optimizer.ask()
    optimizer.tell(trials, np.full(SIZE, -np.finfo(float).max))  # all worse
    again = optimizer.ask()
    best = first[np.argsort(-sphere(first), kind="stable")[:SIZE]]
    # Every trial has at least one gene of its mutant; the others come from the genome itself.
    assert ((again == best).sum(axis=1) < 5).all()
    assert (again == best).any()


def test_best_value_never_gets_worse():
    values = [sphere(genomes).max() for genomes in run(started(), 60, sphere)]
    assert values[-1] > -1e-3
    assert np.maximum.accumulate(values)[-1] == max(values)


def test_trials_stay_within_the_bounds():
    # The optimum lies outside of the range, so that mutants overshoot.
    for genomes in run(started(), 40, lambda x: x.sum(axis=1)):
        assert ((genomes >= 0) & (genomes <= 1)).all()
    assert genomes.min() > 0.9


def test_circular_genes_pass_from_one_to_zero():
    genes = [WrappedGaussian.with_floor(0.1), Uniform()]
    optimizer = started(genes=genes, circular=[True, False])
    asked = run(optimizer, 60, lambda x: np.cos(2 * np.pi * (x[:, 0] - 0.98)) - (x[:, 1] - 0.3) ** 2)
    last = asked[-1]
    assert ((last >= 0) & (last < 1)).all()
    away = np.abs((last[:, 0] - 0.98 + 0.5) % 1 - 0.5)
    assert np.median(away) < 0.02


def test_same_seed_gives_the_same_genomes():
    one, two, other = (run(started(seed), 20, sphere) for seed in (3, 3, 4))
    assert all(np.array_equal(a, b) for a, b in zip(one, two, strict=True))
    assert not np.array_equal(one[0], other[0])


def test_equal_fitness_is_no_error():
    assert len(run(started(), 10, lambda x: np.zeros(len(x)))) == 10


def test_population_that_is_too_small_is_refused():
    with pytest.raises(CaterpillarError, match="shade_population = 3 must be at least 4"):
        ShadeConfig(3)
