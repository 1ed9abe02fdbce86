"""SHADE: first population, trials, replacement, memory and candidates."""

import numpy as np
import pytest

from caterpillar_env.errors import CaterpillarError
from evolution.optimizers.shade import DRAWS, Shade, ShadeConfig
from evolution.priors.distributions import ClippedGaussian, Uniform, WrappedGaussian

SIZE = 10


def started(seed=0, genes=None, candidates=1, **settings):
    genes = genes or [Uniform()] * 5
    return Shade(genes, ShadeConfig(SIZE, candidates), np.random.default_rng(seed), **settings)


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


def test_trials_stay_within_the_bounds():
    # The optimum lies outside of the range, so that mutants overshoot.
    for genomes in run(started(), 40, lambda x: x.sum(axis=1)):
        assert ((genomes >= 0) & (genomes <= 1)).all()
    assert genomes.min() > 0.9


def test_circular_genes_wrap_around():
    genes = [WrappedGaussian.with_floor(0.1), Uniform()]
    optimizer = started(genes=genes, circular=[True, False])
    asked = run(optimizer, 60, lambda x: np.cos(2 * np.pi * (x[:, 0] - 0.98)) - (x[:, 1] - 0.3) ** 2)
    last = asked[-1]
    assert ((last >= 0) & (last < 1)).all()
    away = np.abs((last[:, 0] - 0.98 + 0.5) % 1 - 0.5)
    assert np.median(away) < 0.02


def test_differences_of_circular_genes_take_the_shorter_way_around():
    genes = [WrappedGaussian.with_floor(0.1)]
    optimizer = started(genes=genes, circular=[True])
    first = np.tile([0.02, 0.98], DRAWS * SIZE // 2)[:, None]  # on both sides of 0
    optimizer.ask()
    optimizer._asked = first
    optimizer.tell(first, np.zeros(len(first)))
    trials = optimizer.ask()
    assert np.abs((trials + 0.5) % 1 - 0.5).max() < 0.2


def test_differences_use_two_distinct_genomes_other_than_the_target(monkeypatch):
    optimizer, pairs = started(), []
    run(optimizer, 3, sphere)
    genomes = optimizer._genomes
    subtract = optimizer._subtract
    monkeypatch.setattr(optimizer, "_subtract", lambda a, b: pairs.append((a, b)) or subtract(a, b))
    for _ in range(50):
        optimizer._draw_differences()
    assert len(pairs) == 100
    for one, two in pairs[1::2]:
        assert (one != two).any(axis=1).all()
        assert (one != genomes).any(axis=1).all()
        assert (two != genomes).any(axis=1).all()


def test_trial_that_is_as_good_replaces_the_genome():
    first, trials, again = run(started(), 3, lambda x: np.zeros(len(x)))
    best = first[:SIZE]
    assert (again == trials).any()
    assert not ((again == best) & (trials != best)).any()


@pytest.mark.parametrize("gains", [(1, 1), (3, 1)])
def test_memory_holds_the_lehmer_mean_of_successful_settings(monkeypatch, gains):
    """Tanabe and Fukunaga 2013: sum of w F^2 over sum of w F, with the gains as weights."""
    used = np.full((2, SIZE), 0.9)
    used[:, 0] = 0.5
    optimizer = started()
    run(optimizer, 1, lambda x: np.zeros(len(x)))
    monkeypatch.setattr(optimizer, "_draw_settings", lambda: used)
    trials = optimizer.ask()
    optimizer.tell(trials, np.array([*gains, *[-1] * (SIZE - 2)], dtype=float))
    expected = (gains[0] * 0.25 + gains[1] * 0.81) / (gains[0] * 0.5 + gains[1] * 0.9)
    np.testing.assert_allclose(optimizer._memory[:, 0], expected)
    np.testing.assert_array_equal(optimizer._memory[:, 1:], 0.5)


def test_memory_learns_from_the_candidate_that_was_proposed(monkeypatch):
    def predict(genomes):  # the last candidate of each genome is the most promising
        return np.repeat([0.0, 1.0], len(genomes) // 2)

    optimizer = started(candidates=2, predict=predict)
    run(optimizer, 1, lambda x: np.zeros(len(x)))
    settings = iter([np.full((2, SIZE), 0.1), np.full((2, SIZE), 0.7)])
    monkeypatch.setattr(optimizer, "_draw_settings", lambda: next(settings))
    run(optimizer, 1, lambda x: np.ones(len(x)))
    np.testing.assert_allclose(optimizer._memory[:, 0], 0.7)


def test_same_seed_gives_the_same_genomes():
    one, two, other = (run(started(seed), 20, sphere) for seed in (3, 3, 4))
    assert all(np.array_equal(a, b) for a, b in zip(one, two, strict=True))
    assert not np.array_equal(one[0], other[0])


def test_most_promising_candidates_are_proposed():
    plain, chosen = started(), started(candidates=4, predict=lambda genomes: genomes[:, 0])
    first, best_of_four = plain.ask(), chosen.ask()
    assert best_of_four.shape == first.shape
    # The mean of the largest of four uniform numbers is 0.8.
    assert best_of_four[:, 0].mean() == pytest.approx(0.8, abs=0.1)
    assert best_of_four[:, 1].mean() == pytest.approx(0.5, abs=0.15)
    for optimizer in (plain, chosen):
        run(optimizer, 1, lambda x: np.zeros(len(x)))
    assert np.median(chosen.ask()[:, 0]) > np.median(plain.ask()[:, 0])


def test_good_prediction_speeds_up_the_search():
    plain, helped = started(), started(candidates=5, predict=sphere)
    best = [max(sphere(g).max() for g in run(optimizer, 15, sphere)) for optimizer in (plain, helped)]
    assert best[1] > 0.2 * best[0]  # both are negative


def test_candidate_without_a_prediction_is_the_last_choice():
    def predict(genomes):
        return np.where(genomes[:, 0] > 0.5, np.nan, -1.0)

    first = started(candidates=8, predict=predict).ask()
    assert (first[:, 0] <= 0.5).mean() > 0.9


def test_search_with_equal_predictions_still_adapts():
    optimizer = started(5, candidates=2, predict=lambda genomes: np.zeros(len(genomes)))
    values = [sphere(genomes).max() for genomes in run(optimizer, 60, sphere)]
    assert values[-1] > -1e-3


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"shade_population": 3}, "shade_population = 3 must be an integer from 4"),
        ({"shade_candidates": 0}, "shade_candidates = 0 must be an integer from 1"),
    ],
)
def test_values_out_of_range_are_refused(settings, message):
    with pytest.raises(CaterpillarError, match=message):
        ShadeConfig(**settings)


def test_candidates_need_a_prediction():
    with pytest.raises(CaterpillarError, match="shade_candidates = 2 needs predict"):
        started(candidates=2)
