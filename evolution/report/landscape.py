"""Fitness landscapes around the best robot of a run, as in Figs 2 and 3 of Saunders et al. (2009)."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from matplotlib.colors import ListedColormap
from matplotlib.figure import Figure

from caterpillar_env.arrays import Array
from caterpillar_env.errors import CaterpillarError
from caterpillar_env.task import Failure
from evolution.genome import Gene
from evolution.run.evaluators import OnProgress, evaluate
from evolution.run.history import History

_POINTS = 25  #: values of each gene


class Landscape(NamedTuple):
    """Distances of robots that differ from the best one in two genes."""

    genes: tuple[Gene, Gene]
    best: Array  #: both genes of the best robot, in [0, 1], (2,)
    shares: Array  #: swept values of each gene, in [0, 1], (K,)
    distance_m: Array  #: by first and second gene, 0 for robots that fail or crawl backwards, (K, K)
    failed: Array  #: 1 for robots that fail, else 0, (K, K)


def sweep(
    history: History,
    names: Sequence[str],
    points: int | None = None,
    on_progress: OnProgress | None = None,
) -> Landscape:
    """Simulate robots that differ from the best robot of a run in two genes.

    Args:
        history: an evolution run.
        names: names of two different genes.
        points: number of values of each gene, from its lower to its upper bound; 25 by default.
        on_progress: called with the simulated share, in [0, 1].

    Raises:
        CaterpillarError: the names are not two different gene names, or the run has no best robot.
    """
    if history.kind != "evolution" or history.best is None:
        raise CaterpillarError(
            f"{history.folder} has no evolved robot that crawled forwards; a landscape needs one"
        )
    encoding = history.config.encoding
    known = {gene.name: place for place, gene in enumerate(encoding.genes)}
    if len(set(names)) != 2 or not known.keys() >= set(names):
        raise CaterpillarError(
            f"a landscape needs two different genes from {', '.join(known)}; got {', '.join(names)}"
        )
    first, second = (known[name] for name in names)
    points = points or _POINTS
    shares = np.linspace(0.0, 1.0, points)
    genomes = np.tile(history.best.genome, (points, points, 1))
    genomes[..., first], genomes[..., second] = shares[:, None], shares
    outcomes = evaluate(genomes.reshape(points**2, -1), encoding, on_progress=on_progress)
    return Landscape(
        (encoding.genes[first], encoding.genes[second]),
        np.array(history.best.genome)[[first, second]],
        shares,
        outcomes.fitness().reshape(points, points),
        (outcomes.failure != Failure.NONE).reshape(points, points).astype(float),
    )


def draw(landscape: Landscape) -> Figure:
    """Plot a landscape beside a sphere function with its optimum at the same place."""
    figure = Figure(figsize=(12.0, 4.6), layout="constrained")
    left, right = figure.subplots(1, 2)
    away = landscape.shares - landscape.best[:, None]
    sphere = 1.0 - (away[0][:, None] ** 2 + away[1] ** 2)
    x, y = (gene.shown[0] * gene.value(landscape.shares) for gene in landscape.genes)
    titles = (
        "robots that differ from the best one in two genes (grey: failed)",
        "sphere function, for comparison",
    )
    units = ("distance in 30 s (mm)", "fitness")
    for axes, title, unit, values in zip(
        (left, right), titles, units, (1000 * landscape.distance_m, sphere), strict=True
    ):
        image = axes.pcolormesh(x, y, values.T, cmap="viridis")
        figure.colorbar(image, ax=axes, label=unit)
        place = [np.interp(b, landscape.shares, v) for b, v in zip(landscape.best, (x, y), strict=True)]
        axes.plot(*place, "o", markerfacecolor="none", markeredgecolor="tab:red", markersize=10)
        for gene, label in zip(landscape.genes, (axes.set_xlabel, axes.set_ylabel), strict=True):
            label(f"{gene.title} ({gene.shown[1]})")
        axes.set_title(title, loc="left", fontsize="medium")
    failed = np.ma.masked_equal(landscape.failed.T, 0.0)
    left.pcolormesh(x, y, failed, cmap=ListedColormap(["0.75"]))
    return figure
