import numpy as np
import pytest

from caterpillar_env.errors import CaterpillarError
from evolution.optimizers.cma_es import CmaConfig, CmaEs
from evolution.priors.distributions import ClippedGaussian, Uniform, WrappedGaussian

GENES = [Uniform(), ClippedGaussian(0.8, 0.1), ClippedGaussian(0.0, 0.67)]


def started(seed=0, genes=GENES, **config):
    return CmaEs(genes, CmaConfig(**config), np.random.default_rng(seed))


def asked(optimizer, generations, fitness_of=lambda genomes: genomes.sum(axis=1)):
    all_of_them = []
    for _ in range(generations):
        genomes = optimizer.ask()
        all_of_them.append(genomes)
        optimizer.tell(genomes, fitness_of(genomes))
    return all_of_them


def test_first_generation_follows_the_prior():
    genomes = started(cma_population=4_000).ask()
    np.testing.assert_allclose(np.median(genomes, axis=0)[:2], [0.5, 0.8], atol=0.02)
    assert np.median(genomes[:, 2]) < 0.25  # at the bound
    spread = np.percentile(genomes[:, :2], 84, axis=0) - np.percentile(genomes[:, :2], 16, axis=0)
    assert spread[0] == pytest.approx(0.6, abs=0.05)
    assert spread[1] == pytest.approx(0.2, abs=0.03)


def test_default_population_matches_pycma():
    assert started(genes=[Uniform()] * 20).ask().shape == (12, 20)  # 4 + 3 ln 20


def test_same_seed_gives_same_genomes_and_keeps_numpys_global_state():
    np.random.seed(1)  # noqa: NPY002  the test checks the global generator
    before = np.random.get_state()[1].tolist()  # noqa: NPY002
    one, two, other = asked(started(3), 30), asked(started(3), 30), asked(started(4), 30)
    assert all(np.array_equal(a, b) for a, b in zip(one, two, strict=True))
    assert not np.array_equal(one[0], other[0])
    assert np.random.get_state()[1].tolist() == before  # noqa: NPY002


def test_a_converged_search_restarts_with_twice_the_population():
    sizes = [len(g) for g in asked(started(cma_population=6), 400)]
    assert sizes[0] == 6
    assert set(sizes) > {6, 12}
    assert sizes == sorted(sizes)
    assert {len(g) for g in asked(started(cma_population=6, cma_restarts=False), 400)} == {6}


def test_equal_fitness_in_the_first_generations_causes_no_restart():
    genomes = asked(started(), 15, fitness_of=lambda g: np.zeros(len(g)))
    assert len({len(g) for g in genomes}) == 1


@pytest.mark.parametrize("settings", [{"cma_population": 3}, {"cma_sigma": 0.0}, {"cma_sigma": 1.5}])
def test_unusable_settings_are_refused(settings):
    with pytest.raises(CaterpillarError, match=next(iter(settings))):
        CmaConfig(**settings)


def test_circular_genes_wrap_around():
    # From the start at 0.1, the way to the optimum at 0.95 is shorter if it wraps around.
    genes = [WrappedGaussian.with_floor(0.1), ClippedGaussian.with_floor(0.5)]
    optimizer = CmaEs(genes, CmaConfig(), np.random.default_rng(0), [True, False])

    def fitness_of(genomes):
        return np.cos(2 * np.pi * (genomes[:, 0] - 0.95)) - (genomes[:, 1] - 0.3) ** 2

    genomes = np.concatenate(asked(optimizer, 60, fitness_of))
    assert ((genomes >= 0) & (genomes <= 1)).all()
    assert optimizer.centre == pytest.approx([0.95, 0.3], abs=0.01)
    assert genomes[:, 0].max() > 0.9  # some wrapped around
