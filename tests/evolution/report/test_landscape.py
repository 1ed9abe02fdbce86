"""The landscape around the best robot: its two genes, its distances and its figure."""

import numpy as np
import pytest

from caterpillar_env import Physics
from caterpillar_env.errors import CaterpillarError
from evolution import GaConfig, LocalEvaluator, RunConfig, cli, evaluate, evolve
from evolution.report import landscape
from evolution.report.landscape import Landscape, draw, sweep

CONFIG = RunConfig(
    generations=1, timing="wave", prior="body+gait", ga=GaConfig(population=6, hall_of_fame=1),
    physics=Physics(num_segments=2, timestep_s=0.01), seed=2,
)  # fmt: skip


@pytest.fixture(scope="module")
def history(tmp_path_factory):
    return evolve(CONFIG, tmp_path_factory.mktemp("run") / "run", evaluator=LocalEvaluator(1))


def test_two_genes_vary_and_the_others_are_those_of_the_best_robot(history):
    seen = []
    found = sweep(history, ("offset", "lag"), points=3, on_progress=seen.append)
    assert [gene.name for gene in found.genes] == ["offset", "lag"]
    np.testing.assert_array_equal(found.shares, [0.0, 0.5, 1.0])
    genome = np.array(history.best.genome)
    np.testing.assert_array_equal(found.best, genome[[10, 8]])
    genome[10], genome[8] = 0.5, 1.0
    one = evaluate(genome, CONFIG.encoding)
    assert found.distance_m[1, 2] == one.fitness()[0]
    assert found.failed[1, 2] == (one.failure[0] != 0)
    assert seen[-1] == 1.0


def test_failed_robots_are_grey(history):
    genes = CONFIG.encoding.genes[8:10]
    shares = np.linspace(0.0, 1.0, 3)
    failed = np.zeros((3, 3))
    failed[2, 0] = 1.0
    figure = draw(Landscape(genes, np.array([0.5, 0.1]), shares, np.ones((3, 3)), failed))
    left, right, *_ = figure.axes
    _, grey = left.collections
    assert grey.get_array().count() == 1  # the others are masked
    assert not np.ma.getmaskarray(grey.get_array())[0, 2]  # indices: second gene, first gene
    assert left.get_xlabel() == "lag (%)"
    # The sphere function has its largest value at the node next to the best robot.
    assert np.unravel_index(right.collections[0].get_array().argmax(), (3, 3)) == (0, 1)


def test_report_writes_the_figure(history, monkeypatch, capsys):
    monkeypatch.setattr(landscape, "_POINTS", 2)
    assert cli.main(["report", str(history.folder), "--no-video", "--landscape", "lag", "offset"]) == 0
    assert f"landscape: {history.folder}/landscape.png" in capsys.readouterr().out
    assert (history.folder / "landscape.png").stat().st_size > 10_000


@pytest.mark.parametrize("names", [("lag", "lag"), ("lag", "nose"), ("lag",)])
def test_landscape_requires_two_different_genes(history, names):
    with pytest.raises(CaterpillarError, match="a landscape needs two different genes from leg_sep"):
        sweep(history, names)
