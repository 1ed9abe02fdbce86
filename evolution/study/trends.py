"""How the speed-up by a prior changes with the number of genes (the conjecture of Saunders 2009)."""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np

from evolution.config import RunConfig
from evolution.study import statistics
from evolution.study.arms import EvolutionArm
from evolution.study.config import StudyConfig
from evolution.study.statistics import Estimate
from evolution.study.times import Rows, Runs, Threshold, Times, indices, speed_up_function

LARGEST_SPEED_UP = 100.0  #: speed-ups in trends and figures are clipped to 1 / 100 to 100


class Trend(NamedTuple):
    """Speed-up by a prior for robots with different numbers of genes."""

    name: str  #: optimizer, prior, genome and timing of the arms
    genes: tuple[int, ...]  #: number of genes of each robot, ascending
    speed_ups: tuple[Estimate, ...]  #: ratio of ERTs for each robot, reference to arm
    #: Factor by which the speed-up changes if the number of genes doubles: least squares of the
    #: logarithms. NaN if an arm and its reference never reach the threshold.
    per_doubling: Estimate


def find_trends(config: StudyConfig, runs: Runs, threshold: Threshold, rows: list[Times]) -> list[Trend]:
    """Return the trends over arms that differ from their references in the prior only.

    Args:
        config: the study.
        runs: finished runs by arm.
        threshold: distance to reach.
        rows: times of the arms to this threshold.
    """
    found: dict[str, list[tuple[int, str, Estimate]]] = {}
    for row in rows:
        arm, base = config.arms[row.arm], config.arms[config.reference_of(row.arm)]
        if row.speed_up is None or not (
            isinstance(arm, EvolutionArm) and isinstance(base, EvolutionArm)
        ):
            continue
        run = arm.config
        if _without_prior(run) == _without_prior(base.config):
            name = f"{run.optimizer}, prior {run.prior}, genome {run.genome}, timing {run.timing}"
            found.setdefault(name, []).append((len(run.encoding.genes), row.arm, row.speed_up))
    trends = []
    for name, robots in found.items():
        genes, arms, speed_ups = zip(*sorted(robots), strict=True)
        if len(set(genes)) > 1:
            per_doubling = _fit(config, runs, threshold, genes, arms)
            trends.append(Trend(name, genes, speed_ups, per_doubling))
    return trends


def _without_prior(run: RunConfig) -> dict[str, Any]:
    """Return all settings but the prior. (`replace` would refuse some priors with other settings.)"""
    return {name: value for name, value in run.to_dict().items() if name != "prior"}


def _fit(
    config: StudyConfig, runs: Runs, threshold: Threshold, genes: tuple[int, ...], arms: tuple[str, ...]
) -> Estimate:
    pairs = [(runs[arm], runs[config.reference_of(arm)]) for arm in arms]
    functions = [speed_up_function(threshold, *pair, budget_s=config.budget_s) for pair in pairs]
    x = np.log2(genes)
    x -= x.mean()

    def per_doubling(*rows: Rows) -> float:
        ratios = [f(rows[2 * i], rows[2 * i + 1]) for i, f in enumerate(functions)]
        if np.isnan(ratios).any():
            return float("nan")
        y = np.log2(np.clip(ratios, 1 / LARGEST_SPEED_UP, LARGEST_SPEED_UP))
        return float(2.0 ** (np.dot(x, y) / np.dot(x, x)))

    return statistics.bootstrap(per_doubling, *(indices(group) for pair in pairs for group in pair))
