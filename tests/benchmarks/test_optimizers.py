"""The comparison of optimizers: its adapter, its own mutation and its table."""

from dataclasses import replace

import numpy as np
import polars
import pytest

from benchmarks import optimizers, packages
from caterpillar_env import Physics
from caterpillar_env.errors import CaterpillarError
from evolution import load
from evolution.priors.distributions import Gaussian, Uniform, draw

SMALL = replace(
    optimizers.BASE, physics=Physics(num_segments=2, timestep_s=0.01), budget_s=60.0, prior="body",
    race_share=1.0,
)  # fmt: skip


def test_minimizer_is_wrapped_as_an_ask_tell_optimizer():
    seen = []

    def minimize(function):
        costs = function([[0.2, 2.0], [0.4, 0.5]])
        seen.extend(costs)
        function([[0.1, 0.1]])

    asked = packages.Asked(minimize)
    genomes = asked.ask()
    np.testing.assert_array_equal(genomes, [[0.2, 1.0], [0.4, 0.5]])  # within the bounds
    asked.tell(genomes, np.array([3.0, 4.0]))
    assert asked.ask().shape == (1, 2)
    assert seen == [-3.0, -4.0]
    asked.tell(genomes[:1], np.zeros(1))
    with pytest.raises(CaterpillarError, match="the optimizer ended before the budget was spent"):
        asked.ask()


def test_creep_moves_some_genes_by_small_steps():
    creep = packages.Creep(SMALL)
    parents = creep.ask()
    creep.tell(parents, np.ones(len(parents)))
    children = creep.ask()
    # Distance to the nearest parent, gene by gene.
    nearest = np.abs(children[:, None] - parents).min(axis=1)
    nearest = np.minimum(nearest, 1 - nearest)
    assert 0.05 < (nearest > 0).mean() < 0.3
    assert nearest.max() < 0.3


def test_circular_genes_are_centred_at_their_peak():
    config = optimizers.BASE
    centred, shapes = packages.Centred(config), config.distributions()
    genomes = draw(shapes, np.random.default_rng(0), 50)
    points = centred._from_genes(genomes)
    np.testing.assert_allclose(centred._to_genes(points), genomes)
    peaks = np.array([d.mu if isinstance(d, Gaussian) else 0.5 for d in shapes])
    circular = np.array([gene.circular for gene in config.encoding.genes])
    expected = np.where(circular, 0.5, peaks)
    np.testing.assert_allclose(centred._from_genes(peaks[None])[0], expected)


def test_warm_start_begins_near_the_peaks_of_the_prior():
    pytest.importorskip("cmaes")
    config = optimizers.BASE
    warm, cold = packages.WarmStart(config), draw([Uniform()] * 12, np.random.default_rng(0), 400)
    asked = np.concatenate([warm.ask() for _ in range(40)])
    shapes = config.distributions()

    def density(genomes):
        return np.mean([np.log(d.density(x)).mean() for d, x in zip(shapes, genomes.T, strict=True)])

    prior = density(draw(shapes, np.random.default_rng(1), 400))
    assert density(asked) > prior > density(cold)


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore")
def test_pibo_prefers_the_prior_at_first_and_learns():
    pytest.importorskip("smac")
    pibo, shapes = packages.PiBO(optimizers.BASE), optimizers.BASE.distributions()
    asked = []
    for _ in range(36):  # six more than the initial design
        genomes = pibo.ask()
        asked.append(genomes[0])
        pibo.tell(genomes, -((genomes - 0.3) ** 2).sum(axis=1))
    logs = np.array([[np.log(d.density(x)) for d, x in zip(shapes, g, strict=True)] for g in asked])
    assert logs[30:].sum(axis=1).mean() > logs[:30].sum(axis=1).mean()


@pytest.mark.parametrize("name", ["shade", *optimizers.OTHERS])
@pytest.mark.filterwarnings("ignore")
def test_run_spends_its_budget_and_returns_a_row(monkeypatch, tmp_path, name):
    if name == "pibo":
        pytest.importorskip("smac")
    monkeypatch.setattr(optimizers, "BASE", SMALL)
    monkeypatch.setattr(optimizers, "BUDGET_S", SMALL.budget_s)
    monkeypatch.setitem(optimizers.OURS, "shade", replace(SMALL, optimizer="shade"))
    row = optimizers.run(name, 3, tmp_path)
    assert row["seed"] == 3
    history = load(tmp_path / name / "seed-3")
    assert history.simulated_s >= SMALL.budget_s
    before = history.table().filter(polars.col("simulated_s").cum_sum() <= SMALL.budget_s)
    assert row["best_mm"] == 1000 * max(before.filter(failure="ok")["distance_m"].max() or 0.0, 0.0)
    better = {**row, "best_mm": 250.0, "s_to_200_mm": 70.0}
    summary = optimizers.summarize(polars.DataFrame([row, better]), polars.DataFrame([row, row]))
    assert summary["runs"] == 2
    assert summary["A12 against shade"].startswith("0.75 (")
    assert summary["ERT to 200 mm, s"] == "120; 1 reached"
