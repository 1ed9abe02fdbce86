"""The comparison of optimizers: its adapter, its own mutation and its table."""

from dataclasses import replace

import numpy as np
import polars
import pytest

from benchmarks import optimizers
from caterpillar_env import Physics
from caterpillar_env.errors import CaterpillarError

SMALL = replace(
    optimizers.BASE, physics=Physics(num_segments=2, timestep_s=0.01), budget_s=60.0, prior="body"
)  # fmt: skip


def test_a_function_that_minimizes_can_be_asked_and_told():
    seen = []

    def minimize(function):
        costs = function([[0.2, 2.0], [0.4, 0.5]])
        seen.extend(costs)
        function([[0.1, 0.1]])

    asked = optimizers.Asked(minimize)
    genomes = asked.ask()
    np.testing.assert_array_equal(genomes, [[0.2, 1.0], [0.4, 0.5]])  # within the bounds
    asked.tell(genomes, np.array([3.0, 4.0]))
    assert asked.ask().shape == (1, 2)
    assert seen == [-3.0, -4.0]
    asked.tell(genomes[:1], np.zeros(1))
    with pytest.raises(CaterpillarError, match="the optimizer ended before the budget was spent"):
        asked.ask()


def test_creep_moves_some_genes_by_small_steps():
    creep = optimizers.Creep(SMALL)
    parents = creep.ask()
    creep.tell(parents, np.ones(len(parents)))
    children = creep.ask()
    nearest = np.abs(children[:, None] - parents).min(axis=1)  # of any parent, gene by gene
    nearest = np.minimum(nearest, 1 - nearest)
    assert 0.05 < (nearest > 0).mean() < 0.3
    assert nearest.max() < 0.3


@pytest.mark.parametrize("name", ["shade", "ga-creep", "lq-cma-es"])
def test_a_run_ends_with_its_budget_and_has_a_row(monkeypatch, tmp_path, name):
    monkeypatch.setattr(optimizers, "BASE", SMALL)
    monkeypatch.setitem(optimizers.OURS, "shade", replace(SMALL, optimizer="shade"))
    row = optimizers.run(name, 3, tmp_path)
    assert row["seed"] == 3
    summary = optimizers.summarize(
        polars.DataFrame([row, {**row, "best_mm": 250.0, "s_to_200_mm": 70.0}])
    )
    assert summary["runs"] == 2
    assert summary["ERT to 200 mm, s"] == "9,070 (1 reached)"
