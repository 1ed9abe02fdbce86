"""Compares the arms of a study, in tables and in sentences."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, partial
from typing import NamedTuple

import numpy as np

from caterpillar_env.arrays import Array
from evolution.study import statistics
from evolution.study.config import Cell, StudyConfig
from evolution.study.results import Results, Run, read_runs
from evolution.study.statistics import Estimate
from evolution.study.times import (
    Rows,
    Runs,
    Threshold,
    Times,
    compare,
    count_generations,
    find_speed_ups,
    find_times,
    indices,
)
from evolution.study.trends import Trend, find_trends

TARGETS = 50


class Distances(NamedTuple):
    """Best distances that the runs of an arm have reached at a simulated time."""

    arm: str
    runs: int
    median_m: Estimate
    best_m: float
    failed: float  #: share of failures among the evaluations that racing did not stop
    a12: Estimate | None  #: against the reference
    mann_whitney_p: float | None  #: against the reference, corrected over the arms (Holm)


class Gain(NamedTuple):
    """Best distances that the runs of an arm have reached after a number of generations."""

    arm: str
    runs: int  #: number of runs that completed these generations within the budget
    median_m: Estimate
    ratio: Estimate | None  #: ratio of the medians, arm to reference
    a12: Estimate | None  #: against the reference
    #: Generations after which the median run of the reference (Kaplan-Meier) has reached `median_m`. For
    #: the reference itself, this can be fewer than the number of generations that defines `median_m`.
    reference_generations: Estimate | None


@dataclass(frozen=True)
class Analysis:
    """Comparison of the arms of a study."""

    config: StudyConfig
    missing: Sequence[Cell]  #: runs that are not finished
    runs: Runs  #: finished runs by arm
    times: dict[Threshold, list[Times]]
    distances: dict[float, list[Distances]]  #: by simulated time, s; the last one is the budget
    gains: dict[int, list[Gain]]  #: by number of generations
    speed_ups: dict[str, list[tuple[float, Estimate]]]  #: by arm, with thresholds in m
    trends: list[Trend]  #: how effects of priors change with the number of genes (last threshold)
    ecdf: dict[str, Array]  #: share of (run, target) pairs reached at each time of `grid_s`
    grid_s: Array


def analyse(config: StudyConfig, results: Results) -> Analysis:
    """Compare the arms, using their finished runs only."""
    runs = {arm: found for arm, found in read_runs(results.table, config).items() if found}
    grid_s = np.linspace(0.0, config.budget_s, 201)
    best_m = [run.best_at(config.budget_s) for found in runs.values() for run in found]
    targets_m = np.linspace(0.02, 1.0, TARGETS) * (max(best_m, default=0.0) or 1.0)
    thresholds = [Threshold(value) for value in config.thresholds_m]
    if not thresholds:
        thresholds = [Threshold(generations=count) for count in config.generations]
    gains = {count: _gains(config, runs, count) for count in config.generations}
    times = {threshold: find_times(config, runs, threshold) for threshold in thresholds}
    return Analysis(
        config=config,
        missing=results.missing,
        runs=runs,
        times=times,
        distances={
            time_s: _distances(config, runs, time_s)
            for time_s in (*sorted(config.compare_at_s), config.budget_s)
        },
        gains={count: rows for count, rows in gains.items() if rows},
        speed_ups=find_speed_ups(config, runs),
        trends=find_trends(config, runs, thresholds[-1]),
        ecdf={
            arm: statistics.target_ecdf(
                np.array([[run.time_to(t) for t in targets_m] for run in found]), grid_s
            )
            for arm, found in runs.items()
        },
        grid_s=grid_s,
    )


def _distances(config: StudyConfig, runs: Runs, time_s: float) -> list[Distances]:
    reached_m = {arm: np.array([run.best_at(time_s) for run in found]) for arm, found in runs.items()}
    a12 = compare(config, reached_m, statistics.a12)
    p = statistics.holm(compare(config, reached_m, statistics.mann_whitney), config.comparisons())
    rows = []
    for arm, values in reached_m.items():
        ends = np.concatenate([run.failure[run.spent_s <= time_s] for run in runs[arm]])
        failures = ends[ends != "stopped"]
        rows.append(
            Distances(
                arm=arm,
                runs=len(values),
                median_m=statistics.median(values),
                best_m=float(values.max()),
                failed=float(np.mean(failures != "ok")) if len(failures) else float("nan"),
                a12=a12.get(arm),
                mann_whitney_p=p.get(arm),
            )
        )
    return rows


def _gains(config: StudyConfig, runs: Runs, generations: int) -> list[Gain]:
    reached_m = {}
    for arm in config.comparable():
        values = np.array([run.best_after(generations) for run in runs.get(arm, [])])
        if np.isfinite(values).any():
            reached_m[arm] = values[np.isfinite(values)]

    def ratio(a: Array, b: Array) -> float:
        base = float(np.median(b))
        return float(np.median(a)) / base if base > 0 else np.inf

    ratios = compare(config, reached_m, lambda a, b: statistics.bootstrap(ratio, (a,), (b,)))
    a12 = compare(config, reached_m, statistics.a12)
    needed = {
        arm: _reference_generations(
            Threshold(generations=generations), runs[arm], runs[config.reference_of(arm)]
        )
        for arm in reached_m
        if config.reference_of(arm) in reached_m
    }
    return [
        Gain(arm, len(x), statistics.median(x), ratios.get(arm), a12.get(arm), needed.get(arm))
        for arm, x in reached_m.items()
    ]


def _reference_generations(threshold: Threshold, runs: list[Run], reference: list[Run]) -> Estimate:
    """Estimate how many generations the reference's median run needs to reach an arm's distance.

    The distance is the arm's median after `threshold.generations`.
    """
    level, find = threshold.find(runs), cache(partial(count_generations, reference))

    def generations(rows: Rows, base: Rows | None = None) -> float:
        level_m = level(rows)
        counts, reached = find(level_m)
        chosen = rows if base is None else base
        median = statistics.find_median(counts[chosen], reached[chosen])
        return float("nan") if np.isnan(level_m) else median

    groups = (runs,) if runs is reference else (runs, reference)
    return statistics.bootstrap(
        generations, *map(indices, groups), defined_by=threshold.count_defining(runs)
    )


def summarize(analysis: Analysis) -> list[str]:
    """State the results of a study in sentences."""
    config, lines = analysis.config, []
    if analysis.missing:
        shown = ", ".join(map(str, analysis.missing[:6])) + (", ..." if analysis.missing[6:] else "")
        lines.append(
            f"UNFINISHED: {len(analysis.missing)} of {len(config.cells())} runs are missing ({shown}); "
            "these results cover the others."
        )
    for threshold, rows in analysis.times.items():
        lines += [_summarize_times(config, threshold, row) for row in rows]
    for time_s, distances in analysis.distances.items():
        medians = {row.arm: row.median_m.value for row in distances}
        lines += [
            f"{row.arm}: median of the best distances after {time_s:,.0f} simulated seconds "
            f"{_mm(row.median_m.value)}, against "
            f"{_mm(medians[config.reference_of(row.arm)])} for {config.reference_of(row.arm)}; A12 "
            f"{format_estimate(row.a12)}, Mann-Whitney p {format_p(row.mann_whitney_p)}."
            for row in distances
            if row.a12 is not None
        ]
    for count, gains in analysis.gains.items():
        for gain in gains:
            if gain.ratio is not None and np.isfinite(gain.ratio.value):
                change = Estimate(*(100 * (ratio - 1) for ratio in gain.ratio))
                lines.append(
                    f"{gain.arm}: {format_estimate(change, '{:+z.0f}')} % distance after "
                    f"{_count(count, 'generation')} against {config.reference_of(gain.arm)} "
                    f"({_count(gain.runs, 'run')})."
                )
            needed_generations = gain.reference_generations
            if gain.a12 is None or needed_generations is None:
                continue
            if not np.isnan(needed_generations.value):
                needed = "fewer than half of the runs reached"
                if np.isfinite(needed_generations.value):
                    number = _count_generations(needed_generations)
                    needed = f"the median run needed {number} to reach"
                lines.append(
                    f"{config.reference_of(gain.arm)}: {needed} the median distance of {gain.arm} after "
                    f"{_count(count, 'generation')}."
                )
    lines += [
        f"{trend.name}: when the number of genes doubles ({trend.genes[0]} to {trend.genes[-1]} genes), "
        "the ratio of the median distances changes by a factor of "
        f"{format_estimate(trend.distance_per_doubling)}, and the ratio of expected running times by "
        f"a factor of {format_estimate(trend.speed_up_per_doubling)}."
        for trend in analysis.trends
    ]
    return lines


def _summarize_times(config: StudyConfig, threshold: Threshold, row: Times) -> str:
    reference = config.reference_of(row.arm)
    has_longer_runs = row.arm == config.reference and bool(config.long_seeds)
    if np.isnan(row.threshold_m):
        return f"{row.arm}: {threshold} is 0 or not known yet."
    level = _mm(row.threshold_m)
    if row.defined_by is not None:
        if row.defined_by < statistics.FEWEST:
            level += f", from only {_count(row.defined_by, 'run')}"
        level = f"{threshold} ({level})"
    line = f"{row.arm}: {row.reached} of {_count(row.runs, 'run')} reached {level}"
    if has_longer_runs:
        line += f" within {config.budget_s:,.0f} simulated seconds"
    if row.median_generations is not None:
        line += "; with the longer runs" if has_longer_runs else ""
        needed = f"more than {row.completed} generations"
        if np.isfinite(row.median_generations.value):
            needed = _count_generations(row.median_generations)
        line += f", the median run after {needed}"
    if row.arm != reference and row.acceleration is not None:
        line += f", {format_acceleration(threshold, row)} times as fast as {reference}"
    if row.speed_up is not None:
        line += (
            f"; ratio of expected running times, {reference} to {row.arm}, "
            f"{format_estimate(row.speed_up)}"
        )
    if row.log_rank_p is not None:
        line += f", log-rank p {format_p(row.log_rank_p)}"
    return line + "."


def _mm(metres: float) -> str:
    return f"{1000 * metres:.0f} mm"


def format_estimate(estimate: Estimate | None, pattern: str = "{:.2f}", factor: float = 1.0) -> str:
    """Format a value with its interval, both multiplied by `factor`."""
    if estimate is None:
        return ""
    if np.isnan(estimate.value):
        return "undefined"
    value, low, high = (pattern.format(factor * v) if np.isfinite(v) else "∞" for v in estimate)
    return value if np.isnan(estimate.low) else f"{value} ({low} to {high})"


def format_acceleration(threshold: Threshold, times: Times) -> str:
    """Format the speed-up in generations, as an upper bound if the median run missed the threshold."""
    estimate = times.acceleration
    if estimate is None or estimate.value != 0:
        return format_estimate(estimate)
    if times.completed == 0:
        return "unknown"
    bound = threshold.generations / times.completed
    return f"< {bound:.2f}" + (f" (up to {estimate.high:.2f})" if estimate.high > bound else "")


def _count(number: int, unit: str) -> str:
    """Return a number with its unit, such as `1 run` or `2 runs`."""
    return f"{number} {unit}" if number == 1 else f"{number} {unit}s"


def _count_generations(number: Estimate) -> str:
    """Return a number of generations with its interval and unit, such as `1 generation`."""
    text = format_estimate(number, "{:.0f}")
    return f"{text} generation" if text == "1" else f"{text} generations"


def format_p(p: float | None) -> str:
    """Format a p value with three decimals."""
    if p is None:
        return ""
    return "< 0.001" if p < 0.001 else f"{p:.3f}"
