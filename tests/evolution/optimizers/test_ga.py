"""The genetic algorithm: selection, crossover, mutation, hall of fame."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy import stats

from caterpillar_env.errors import CaterpillarError
from evolution.optimizers.ga import GaConfig, GeneticAlgorithm, roulette
from evolution.priors.distributions import ClippedGaussian, Uniform

CROSSOVERS = ["uniform", "one-point", "two-point"]


class Rank:
    """Genome i of n has the value i / n in every gene, so that a child shows whose genes it has."""

    def sample(self, rng, size):
        return np.arange(size) / size


class Phases:
    """The first draw is all zeros, every later one all ones, so that mutated genes stand out."""

    def __init__(self):
        self.calls = 0

    def sample(self, rng, size):
        self.calls += 1
        return np.full(size, 0.0 if self.calls == 1 else 1.0)


def ga(distributions=None, seed=0, **config):
    settings = {"population": 12, "hall_of_fame": 3, **config}
    genes = distributions or [Uniform()] * 6
    return GeneticAlgorithm(genes, genes, GaConfig(**settings), np.random.default_rng(seed))


def generations(algorithm, fitness_of, count):
    """Run the algorithm and return the genomes of each generation."""
    asked = []
    for _ in range(count):
        genomes = algorithm.ask()
        asked.append(genomes)
        algorithm.tell(genomes, fitness_of(genomes))
    return asked


# Selection


def test_lowest_positive_fitness_is_selected_in_proportion():
    copies = ga([Rank()], population=400, hall_of_fame=0, crossover_rate=0.0, mutation_rate=0.0)
    first = copies.ask()
    copies.tell(first, np.where(first[:, 0] < 0.5, 1.0, 3.0))
    assert np.mean(copies.ask() < 0.5) == pytest.approx(0.25, abs=0.06)


def test_ties_among_the_elites_go_to_the_first_genomes():
    copies = ga([Rank()], population=200, hall_of_fame=5, crossover_rate=0.0, mutation_rate=0.0)
    first = copies.ask()
    copies.tell(first, 1.0 + np.arange(200) % 2)
    assert not np.isin(first[1:10:2], copies.ask()).any()  # elites do not breed


# Roulette


def test_roulette_draws_in_proportion_to_fitness():
    fitness = np.array([0.0, 1.0, 2.0, 3.0, 4.0])
    draws = roulette(fitness, 50_000, np.random.default_rng(1))
    counts = np.bincount(draws, minlength=5)
    assert counts[0] == 0
    assert stats.chisquare(counts[1:], 50_000 * fitness[1:] / 10).pvalue > 0.01


@pytest.mark.parametrize("value", [0.0, 0.03, 5e-324, 1e-300, 1e300, 1.7e308])
def test_equal_fitness_makes_all_genomes_equally_likely(value):
    draws = roulette(np.full(8, value), 20_000, np.random.default_rng(2))
    assert stats.chisquare(np.bincount(draws, minlength=8)).pvalue > 0.01


@pytest.mark.parametrize("value", [5e-324, 1e-300, 1e-9, 1.0, 1e300, 1.7e308])
@pytest.mark.parametrize("place", [0, 3, 6])
def test_single_positive_fitness_is_always_selected(value, place):
    fitness = np.zeros(7)
    fitness[place] = value
    assert set(roulette(fitness, 500, np.random.default_rng(0)).tolist()) == {place}


@pytest.mark.parametrize("scale", [1e-300, 1.0, 1e300])
def test_scale_of_fitness_does_not_matter(scale):
    fitness = np.array([1.0, 5.0, 0.0, 2.0])
    plain = roulette(fitness, 200, np.random.default_rng(4))
    assert roulette(scale * fitness, 200, np.random.default_rng(4)).tolist() == plain.tolist()


@pytest.mark.parametrize("bad", [-1e-12, -1.0, np.nan, np.inf, -np.inf])
def test_roulette_rejects_negative_or_non_finite_fitness(bad):
    with pytest.raises(CaterpillarError, match="finite and not negative"):
        roulette(np.array([1.0, bad, 2.0]), 3, np.random.default_rng(0))


@settings(deadline=None)
@given(
    fitness=st.lists(st.floats(0.0, 1.7e308), min_size=1, max_size=30).map(np.array),
    seed=st.integers(0, 2**32 - 1),
)
def test_roulette_never_selects_zero_fitness(fitness, seed):
    draws = roulette(fitness, 20, np.random.default_rng(seed))
    assert draws.shape == (20,)
    assert np.all((draws >= 0) & (draws < len(fitness)))
    if fitness.max() > 0:
        assert np.all(fitness[draws] > 0)


class Always:
    """A generator that always draws the same number."""

    def __init__(self, value):
        self.value = value

    def random(self, size):
        return np.full(size, self.value)


@pytest.mark.parametrize(("draw", "expected"), [(0.0, 2), (np.nextafter(1.0, 0.0), 11)])
def test_roulette_never_selects_zero_fitness_at_extreme_draws(draw, expected):
    fitness = np.array([0.0] * 2 + [0.1] * 10 + [0.0] * 2)
    assert roulette(fitness, 3, Always(draw)).tolist() == [expected] * 3


# Ask and tell


def test_hall_of_fame_survives_unchanged():
    # Only one genome has positive fitness, and only in the first generation. Five generations later,
    # the roulette still selects only this genome, so all children are copies of it.
    algorithm = ga(hall_of_fame=1, mutation_rate=0.0, elites_breed=True)
    first = algorithm.ask()
    algorithm.tell(first, np.eye(len(first))[4])
    for _ in range(5):
        children = algorithm.ask()
        np.testing.assert_array_equal(children, np.tile(first[4], (11, 1)))
        algorithm.tell(children, np.zeros(11))


def test_hall_of_fame_holds_the_best_of_all_generations():
    algorithm = ga(hall_of_fame=2, mutation_rate=0.0, crossover_rate=0.0, elites_breed=True)
    first = algorithm.ask()
    scores = np.zeros(12)
    scores[[3, 8]] = [5.0, 1.0]
    algorithm.tell(first, scores)
    second = algorithm.ask()
    # A child with fitness 2 replaces the elite with fitness 1, not the elite with fitness 5.
    newcomer = np.flatnonzero((second == first[8]).all(axis=1))
    assert newcomer.size, "with this seed no child copies the second elite"
    scores = np.zeros(10)
    scores[newcomer[0]] = 2.0
    algorithm.tell(second, scores)
    third = algorithm.ask()
    kinds = {tuple(genome) for genome in third}
    assert kinds == {tuple(first[3]), tuple(first[8])}


def test_mutation_uses_the_mutation_distributions():
    low, high = ClippedGaussian(0.1, 0.01), ClippedGaussian(0.9, 0.01)
    config = GaConfig(population=12, hall_of_fame=3, mutation_rate=1.0)
    algorithm = GeneticAlgorithm([low] * 6, [high] * 6, config, np.random.default_rng(0))
    first, second = generations(algorithm, lambda g: g[:, 0], 2)
    assert (first < 0.2).all()
    assert (second > 0.8).all()


@pytest.mark.parametrize("ties_later", [False, True])
def test_ties_in_the_hall_of_fame_go_to_the_older_genome(ties_later):
    algorithm = ga([Rank()], population=4, hall_of_fame=1, mutation_rate=0.0, elites_breed=True)
    algorithm.tell(algorithm.ask(), np.array([0.0, 1.0, 1.0, 0.0]))  # a tie at 1/4 and 2/4
    if ties_later:
        children = algorithm.ask()
        assert 0.5 in children, "with this seed no child ties with the elite"
        algorithm.tell(children, np.ones(3))
    algorithm.tell(algorithm.ask(), np.zeros(3))
    assert algorithm.ask().tolist() == [[0.25]] * 3  # only the elite has positive fitness


@pytest.mark.parametrize("crossover", CROSSOVERS)
@pytest.mark.parametrize(("settings", "breeds"), [({}, False), ({"elites_breed": True}, True)])
def test_elites_breed_only_if_elites_breed_is_set(crossover, settings, breeds):
    # Each genome has its own value in every gene. The three elites have by far the highest fitness.
    algorithm = ga([Rank()] * 5, mutation_rate=0.0, crossover=crossover, **settings)
    first = algorithm.ask()
    fitness = np.where(np.isin(np.arange(12), [2, 5, 7]), 100.0, 1.0)
    algorithm.tell(first, fitness)
    inherited = np.unique(algorithm.ask())
    assert np.isin(first[[2, 5, 7], 0], inherited).any() == breeds
    assert np.isin(inherited, first[:, 0]).all()


def test_non_elites_breed_in_proportion_to_their_fitness():
    algorithm = ga([Rank()] * 2, population=6, hall_of_fame=2, mutation_rate=0.0)
    first = algorithm.ask()
    # Apart from the two elites, only one genome has positive fitness.
    algorithm.tell(first, np.array([9.0, 0.0, 8.0, 3.0, 0.0, 0.0]))
    np.testing.assert_array_equal(algorithm.ask(), np.tile(first[3], (4, 1)))


def test_non_elites_with_zero_fitness_are_selected_uniformly():
    algorithm = ga([Rank()] * 2, population=300, hall_of_fame=100, mutation_rate=0.0)
    first = algorithm.ask()
    algorithm.tell(first, np.repeat([1.0, 0.0], [100, 200]))
    inherited = np.unique(algorithm.ask())
    assert not np.isin(first[:100, 0], inherited).any()
    assert len(inherited) > 100  # 200 children with two parents each, of 200 equally likely genomes


def test_a_replaced_elite_breeds_as_a_non_elite():
    algorithm = ga([Rank()] * 2, population=4, hall_of_fame=1, mutation_rate=0.0)
    first = algorithm.ask()
    algorithm.tell(first, np.array([0.0, 1.0, 0.0, 0.0]))
    children = algorithm.ask()
    assert not (children == first[1]).any()
    algorithm.tell(children, np.array([2.0, 0.0, 0.0]))
    np.testing.assert_array_equal(algorithm.ask(), np.tile(first[1], (3, 1)))


def test_a_single_non_elite_is_both_parents():
    algorithm = ga([Rank()] * 3, population=5, hall_of_fame=4, mutation_rate=0.0)
    first = algorithm.ask()
    algorithm.tell(first, np.array([3.0, 2.0, 0.5, 4.0, 1.0]))
    child = algorithm.ask()
    np.testing.assert_array_equal(child, first[[2]])
    algorithm.tell(child, np.array([5.0]))  # the worst former elite is now the only non-elite
    np.testing.assert_array_equal(algorithm.ask(), first[[4]])


def test_asking_twice_gives_the_same_genomes():
    algorithm = ga()
    for _ in range(2):
        one, two = algorithm.ask(), algorithm.ask()
        np.testing.assert_array_equal(one, two)
        algorithm.tell(one, one[:, 0])


def test_modifying_returned_genomes_does_not_affect_the_algorithm():
    algorithm = ga()
    mine = algorithm.ask()
    kept = mine.copy()
    mine[:] = 0.0
    np.testing.assert_array_equal(algorithm.ask(), kept)


def test_tell_rejects_genomes_that_ask_did_not_return():
    algorithm = ga()
    genomes = algorithm.ask()
    for other in (genomes[::-1], genomes[:-1], genomes + 1e-9, genomes[:, :-1]):
        with pytest.raises(CaterpillarError, match="exactly the genomes that ask returned"):
            algorithm.tell(other, np.ones(len(other)))
    algorithm.tell(genomes, np.ones(12))


def test_tell_requires_a_preceding_ask():
    algorithm = ga()
    with pytest.raises(CaterpillarError, match="tell"):
        algorithm.tell(np.zeros((12, 6)), np.zeros(12))
    genomes = algorithm.ask()
    algorithm.tell(genomes, np.ones(12))
    with pytest.raises(CaterpillarError, match="tell"):
        algorithm.tell(genomes, np.ones(12))


@pytest.mark.parametrize("shape", [(11,), (13,), (12, 1), ()])
def test_tell_rejects_fitness_of_the_wrong_shape(shape):
    algorithm = ga()
    with pytest.raises(CaterpillarError, match=r"shape \(12,\)"):
        algorithm.tell(algorithm.ask(), np.ones(shape))


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_tell_rejects_non_finite_fitness(bad):
    algorithm = ga()
    genomes = algorithm.ask()
    fitness = np.ones(12)
    fitness[3] = bad
    with pytest.raises(CaterpillarError, match="must be finite"):
        algorithm.tell(genomes, fitness)
    algorithm.tell(genomes, np.ones(12))


def test_selection_with_negative_fitness_is_relative_to_the_worst():
    algorithm = ga([Rank()] * 2, population=6, hall_of_fame=2, mutation_rate=0.0)
    first = algorithm.ask()
    # Apart from the two elites, only one genome is better than the worst.
    algorithm.tell(first, np.array([-1.0, -9.0, -2.0, -8.5, -9.0, -9.0]))
    np.testing.assert_array_equal(algorithm.ask(), np.tile(first[3], (4, 1)))


def test_shifting_fitness_below_zero_does_not_change_the_draws():
    def second_generation(offset):
        algorithm = ga(seed=3, elites_breed=True)
        genomes = algorithm.ask()
        algorithm.tell(genomes, np.arange(12.0) + offset)
        return algorithm.ask()

    np.testing.assert_array_equal(second_generation(-64.0), second_generation(0.0))


@pytest.mark.parametrize(
    ("population", "hall_of_fame", "elites"),
    [(200, 10, 10), (11, 10, 10), (10, 10, 5), (3, 10, 1), (12, 0, 0), (2, 1, 1)],
)
def test_hall_of_fame_that_does_not_fit_shrinks_to_half_of_the_population(
    population, hall_of_fame, elites
):
    config = GaConfig(population=population, hall_of_fame=hall_of_fame)
    assert (config.hall_of_fame, config.elites) == (hall_of_fame, elites)
    asked = generations(ga(population=population, hall_of_fame=hall_of_fame), lambda g: g[:, 0], 3)
    assert [len(g) for g in asked] == [population, population - elites, population - elites]


# Crossover and mutation


def switches(children):
    """Number of switches between the genes of the two parents in each child."""
    return (np.diff(children, axis=1) != 0).sum(axis=1)


def children_of_rank(crossover, num_genes=10, rate=1.0):
    algorithm = ga(
        distributions=[Rank()] * num_genes, population=600, hall_of_fame=0,
        mutation_rate=0.0, crossover=crossover, crossover_rate=rate,
    )  # fmt: skip
    algorithm.tell(algorithm.ask(), np.ones(600))
    return algorithm.ask()


@pytest.mark.parametrize("crossover", CROSSOVERS)
def test_every_gene_comes_from_the_same_position_in_a_parent(crossover):
    children = children_of_rank(crossover)
    values = [set(child) for child in children]
    assert max(map(len, values)) == 2
    assert np.all(np.isin(children, np.arange(600) / 600))


def test_one_point_crossover_switches_once_anywhere():
    children = children_of_rank("one-point")
    assert set(switches(children).tolist()) <= {0, 1}  # 0: both parents are the same genome
    assert np.mean(switches(children) == 1) > 0.95
    assert set(np.nonzero(np.diff(children, axis=1))[1].tolist()) == set(range(9))


def test_two_point_crossover_takes_adjacent_genes_from_the_other_parent():
    children = children_of_rank("two-point")
    assert set(switches(children).tolist()) == {0, 2}  # 0: the cuts may coincide
    assert np.all(children[:, 0] == children[:, -1])
    assert set(np.nonzero(np.diff(children, axis=1))[1].tolist()) == set(range(9))


def test_uniform_crossover_takes_half_of_the_genes_from_each_parent():
    children = children_of_rank("uniform", num_genes=20)
    shares = np.mean(children == children[:, :1], axis=1)
    # A gene agrees with the first one in half of the cases: 1/20 + 19/20 * 1/2
    assert shares.mean() == pytest.approx(0.525, abs=0.02)


@pytest.mark.parametrize("crossover", CROSSOVERS)
def test_crossover_rate_is_the_share_of_children_with_two_parents(crossover):
    for rate, expected in ((0.0, 0.0), (0.4, 0.4), (1.0, 1.0)):
        mixed = np.mean(switches(children_of_rank(crossover, num_genes=40, rate=rate)) > 0)
        assert mixed == pytest.approx(expected, abs=0.06 if expected else 0.0)


def test_without_crossover_and_mutation_children_are_copies_of_parents():
    algorithm = ga(crossover_rate=0.0, mutation_rate=0.0)
    parents, children = generations(algorithm, lambda g: 0.1 + g[:, 0], 2)
    assert {tuple(c) for c in children} <= {tuple(p) for p in parents}


def test_mutation_rate_is_the_probability_for_each_gene():
    algorithm = ga(
        distributions=[Phases() for _ in range(20)], population=1000, hall_of_fame=0, mutation_rate=0.05
    )
    first, second = generations(algorithm, lambda g: np.ones(len(g)), 2)
    assert not first.any()
    # 20 000 genes: 1000 expected, standard deviation 31
    assert second.sum() == pytest.approx(1000, abs=125)
    assert np.all(second.sum(axis=0) > 0)


def test_mutated_genes_are_redrawn_from_their_own_distribution():
    peaks = np.array([0.1, 0.5, 0.9])
    narrow = [ClippedGaussian(mu, 0.01) for mu in peaks]
    algorithm = ga(distributions=narrow, population=300, mutation_rate=1.0)
    first, second = generations(algorithm, lambda g: np.ones(len(g)), 2)
    for genomes in (first, second):
        np.testing.assert_allclose(genomes.mean(axis=0), peaks, atol=0.003)
        np.testing.assert_allclose(genomes.std(axis=0), 0.01, rtol=0.2)
    assert not np.isin(second, first).any()


# The complete algorithm


@pytest.mark.parametrize("crossover", CROSSOVERS)
def test_only_equal_seeds_give_equal_genomes(crossover):
    def history(seed):
        asked = generations(ga(seed=seed, crossover=crossover), lambda g: g[:, 0], 4)
        return np.concatenate(asked)

    np.testing.assert_array_equal(history(5), history(5))
    assert not np.array_equal(history(5), history(6))


def test_defaults_match_the_paper():
    assert (GaConfig().population, GaConfig().hall_of_fame) == (200, 10)
    assert not GaConfig().elites_breed


@pytest.mark.parametrize(
    ("settings", "message"),
    [
        ({"population": 1, "hall_of_fame": 0}, "population = 1 must be an integer from 2"),
        ({"population": -200}, "population = -200"),
        ({"hall_of_fame": -1}, "hall_of_fame = -1"),
        ({"crossover_rate": 1.1}, "crossover_rate = 1.1"),
        ({"crossover_rate": np.nan}, "crossover_rate = nan"),
        ({"mutation_rate": -0.1}, "mutation_rate = -0.1"),
        ({"crossover": "three-point"}, "one of uniform, one-point, two-point"),
    ],
)
def test_unusable_settings_are_refused(settings, message):
    with pytest.raises(CaterpillarError, match=message):
        GaConfig(**settings)
