"""How the effect of a prior changes with the number of genes (the conjecture of Saunders 2009)."""

from __future__ import annotations

from collections.abc import Callable, Hashable, Sequence
from typing import Any, NamedTuple

import numpy as np

from caterpillar_env.arrays import Array
from evolution.config import RunConfig
from evolution.study import statistics
from evolution.study.arms import EvolutionArm
from evolution.study.config import StudyConfig
from evolution.study.results import Run
from evolution.study.statistics import Estimate
from evolution.study.times import (
    Rows,
    Runs,
    Threshold,
    estimate_speed_up,
    indices,
    speed_up_function,
)

LARGEST_RATIO = 100.0  #: ratios in trends and figures are clipped to 1 / 100 to 100
_Ratio = Callable[[Rows, Rows], float]  #: ratio of a pair of arms, from indices of their runs


class Trend(NamedTuple):
    """Effect of a prior for robots with different numbers of genes.

    The factors per doubling come from least squares of the logarithms of the ratios, with one intercept
    for each group of robots. They are NaN if a ratio is undefined.
    """

    name: str  #: optimizer, prior and timing of the arms, and the kind of the trend
    genes: tuple[int, ...]  #: number of genes of each robot, ascending
    distances: tuple[Estimate, ...]  #: ratio of the median distances at the budget, arm to reference
    speed_ups: tuple[Estimate, ...]  #: ratio of ERTs to the threshold, reference to arm
    distance_per_doubling: Estimate  #: factor of the first ratio if the number of genes doubles
    speed_up_per_doubling: Estimate  #: the same factor of the second ratio
    groups: int = 1  #: number of groups with an intercept of their own


class _Pair(NamedTuple):
    """An arm and its reference, which differ in the prior only."""

    run: RunConfig
    genes: int
    runs: list[Run]
    reference: list[Run]
    distance: Estimate
    speed_up: Estimate


def find_trends(config: StudyConfig, runs: Runs, threshold: Threshold) -> list[Trend]:
    """Return the trends over arms that differ from their references in the prior only.

    Arms with the same optimizer, prior and timing are compared in up to three ways: for each kind of
    genome, over robots with different numbers of segments; for all kinds of genome together; and for
    robots with the same number of segments, over the kinds of genome.

    Args:
        config: the study.
        runs: finished runs by arm.
        threshold: distance to reach.
    """
    searches: dict[str, list[_Pair]] = {}
    for name, group in runs.items():
        arm, base = config.arms[name], config.arms[config.reference_of(name)]
        reference = runs.get(config.reference_of(name), [])
        if arm is base or not (isinstance(arm, EvolutionArm) and isinstance(base, EvolutionArm)):
            continue
        run = arm.config
        if reference and _without_prior(run) == _without_prior(base.config):
            search = f"{run.optimizer}, prior {run.prior}, timing {run.timing}"
            distance = statistics.bootstrap(
                _distance_function(group, reference, config.budget_s), indices(group), indices(reference)
            )
            speed_up = estimate_speed_up(threshold, group, reference, budget_s=config.budget_s)
            pair = _Pair(run, len(run.encoding.genes), group, reference, distance, speed_up)
            searches.setdefault(search, []).append(pair)
    trends = []
    for search, pairs in searches.items():
        pairs.sort(key=lambda pair: pair.genes)
        genomes = _group(pairs, lambda pair: pair.run.genome)
        robots = _group(pairs, lambda pair: pair.run.physics.num_segments)
        found = [(f"genome {name}", [group]) for name, group in genomes.items()]
        if len(genomes) > 1:
            found.append(("all genomes", list(genomes.values())))
        if robots:
            found.append(("same robots", list(robots.values())))
        trends += [
            _fit(f"{search}, {kind}", groups, threshold, config.budget_s) for kind, groups in found
        ]
    return trends


def _without_prior(run: RunConfig) -> dict[str, Any]:
    """Return all settings but the prior. (`replace` would refuse some priors with other settings.)"""
    return {name: value for name, value in run.to_dict().items() if name != "prior"}


def _group(pairs: Sequence[_Pair], key: Callable[[_Pair], Hashable]) -> dict[Hashable, list[_Pair]]:
    """Group pairs by a property, and return the groups with different numbers of genes."""
    groups: dict[Hashable, list[_Pair]] = {}
    for pair in pairs:
        groups.setdefault(key(pair), []).append(pair)
    return {name: found for name, found in groups.items() if len({pair.genes for pair in found}) > 1}


def _fit(name: str, groups: list[list[_Pair]], threshold: Threshold, budget_s: float) -> Trend:
    pairs = [pair for group in groups for pair in group]
    x = np.concatenate([_center(np.log2([pair.genes for pair in group])) for group in groups])
    rows = [indices(runs) for pair in pairs for runs in (pair.runs, pair.reference)]
    distances = [_distance_function(pair.runs, pair.reference, budget_s) for pair in pairs]
    speed_ups = [
        speed_up_function(threshold, pair.runs, pair.reference, budget_s=budget_s) for pair in pairs
    ]
    defining = [threshold.count_defining(pair.reference) for pair in pairs]
    fewest = min((count for count in defining if count is not None), default=None)
    ordered = sorted(pairs, key=lambda pair: pair.genes)
    return Trend(
        name=name,
        genes=tuple(pair.genes for pair in ordered),
        distances=tuple(pair.distance for pair in ordered),
        speed_ups=tuple(pair.speed_up for pair in ordered),
        distance_per_doubling=statistics.bootstrap(_slope(x, distances), *rows),
        speed_up_per_doubling=statistics.bootstrap(_slope(x, speed_ups), *rows, defined_by=fewest),
        groups=len(groups),
    )


def _center(values: Array) -> Array:
    centered: Array = values - values.mean()
    return centered


def _distance_function(runs: list[Run], reference: list[Run], budget_s: float) -> _Ratio:
    """Return a function that computes the ratio of the median distances, arm to reference."""
    best_m, base_m = (np.array([run.best_at(budget_s) for run in group]) for group in (runs, reference))

    def ratio(rows: Rows, base: Rows) -> float:
        median_m, reference_m = float(np.median(best_m[rows])), float(np.median(base_m[base]))
        if reference_m > 0:
            return median_m / reference_m
        return float("inf") if median_m > 0 else float("nan")

    return ratio


def _slope(x: Array, ratios: Sequence[_Ratio]) -> Callable[..., float]:
    """Return a function that computes the factor per doubling from indices of the runs of all pairs.

    Args:
        x: base-2 logarithms of the numbers of genes, with a mean of 0 in each group, (pairs,).
        ratios: functions of the ratio of each pair.
    """

    def per_doubling(*rows: Rows) -> float:
        values = [ratio(rows[2 * i], rows[2 * i + 1]) for i, ratio in enumerate(ratios)]
        if np.isnan(values).any():
            return float("nan")
        y = np.log2(np.clip(values, 1 / LARGEST_RATIO, LARGEST_RATIO))
        return float(2.0 ** (np.dot(x, y) / np.dot(x, x)))

    return per_doubling
