"""Compares the arms of a study, in tables and in sentences."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray
from scipy import stats

from caterpillar_env.arrays import Array
from evolution.study import statistics
from evolution.study.config import Cell, StudyConfig
from evolution.study.results import Results, Run, read_runs
from evolution.study.statistics import Estimate

TARGETS = 50

Arrivals = tuple[Array, NDArray[np.bool_]]
G = TypeVar("G")
T = TypeVar("T")


class Times(NamedTuple):
    """Simulated times at which the runs of an arm reach a threshold."""

    arm: str
    runs: int
    reached: int
    median_s: Estimate  #: Kaplan-Meier
    running_time_s: Estimate  #: ERT
    speed_up: Estimate | None  #: ratio of ERTs, reference to arm; None for the reference
    log_rank_p: float | None  #: against the reference, corrected over the arms (Holm)


class Finals(NamedTuple):
    """Best distances of the runs of an arm when their budget is spent."""

    arm: str
    runs: int
    median_m: Estimate
    best_m: float
    failed: float  #: share of evaluations that failed
    a12: Estimate | None  #: against the reference
    mann_whitney_p: float | None  #: against the reference, corrected over the arms (Holm)


class Gain(NamedTuple):
    """Median best distance of an arm at a generation, relative to the reference."""

    arm: str
    runs: int  #: number of runs that completed this generation within the budget
    ratio: Estimate  #: ratio of the medians, arm to reference


@dataclass(frozen=True)
class Analysis:
    """Comparison of the arms of a study."""

    config: StudyConfig
    missing: Sequence[Cell]  #: runs that are not finished
    thresholds_m: list[float] | None  #: None until all pilot runs are finished
    runs: dict[str, list[Run]]  #: finished runs by arm, without pilot runs
    times: dict[float, list[Times]]  #: by threshold (m)
    finals: list[Finals]
    gains: list[Gain]
    ecdf: dict[str, Array]  #: share of (run, target) pairs reached at each time of `grid_s`
    grid_s: Array


def analyse(config: StudyConfig, results: Results, thresholds_m: list[float] | None) -> Analysis:
    """Compare the arms, using their finished runs only."""
    found = read_runs(results.table, config, config.seeds)
    runs = {arm: arm_runs for arm, arm_runs in found.items() if arm_runs}
    grid_s = np.linspace(0.0, config.budget_s, 201)
    best_m = max((run.best_m[-1] for arm_runs in runs.values() for run in arm_runs), default=1.0)
    targets_m = np.linspace(0.02, 1.0, TARGETS) * best_m
    return Analysis(
        config=config,
        missing=results.missing,
        thresholds_m=thresholds_m,
        runs=runs,
        times={threshold: _times(config, runs, threshold) for threshold in thresholds_m or []},
        finals=_finals(config, runs),
        gains=_gains(config, runs),
        ecdf={
            arm: statistics.target_ecdf(
                np.array([[run.time_to(t) for t in targets_m] for run in arm_runs]), grid_s
            )
            for arm, arm_runs in runs.items()
        },
        grid_s=grid_s,
    )


def arrivals(runs: Sequence[Run], threshold_m: float, budget_s: float) -> Arrivals:
    """Return each run's time (s) to a threshold or to the end of its budget, (n,).

    The second array, (n,), is True where a run reached the threshold.
    """
    times = np.array([run.time_to(threshold_m) for run in runs])
    return np.minimum(times, budget_s), np.isfinite(times)


def _times(config: StudyConfig, runs: dict[str, list[Run]], threshold_m: float) -> list[Times]:
    groups = {arm: arrivals(found, threshold_m, config.budget_s) for arm, found in runs.items()}
    speed_up = _compare(config, groups, _speed_up)
    log_rank = statistics.holm(_compare(config, groups, lambda a, b: statistics.log_rank(*a, *b)))
    return [
        Times(
            arm=arm,
            runs=len(time),
            reached=int(reached.sum()),
            median_s=statistics.kaplan_meier(time, reached).median,
            running_time_s=statistics.bootstrap(statistics.expected_running_time, (time, reached)),
            speed_up=speed_up.get(arm),
            log_rank_p=log_rank.get(arm),
        )
        for arm, (time, reached) in groups.items()
    ]


def _finals(config: StudyConfig, runs: dict[str, list[Run]]) -> list[Finals]:
    final_m = {arm: np.array([run.best_m[-1] for run in found]) for arm, found in runs.items()}
    a12 = _compare(config, final_m, statistics.a12)
    p = statistics.holm(_compare(config, final_m, lambda a, b: float(stats.mannwhitneyu(a, b).pvalue)))
    rows = []
    for arm, values in final_m.items():
        failures = np.concatenate([run.failure for run in runs[arm]])
        rows.append(
            Finals(
                arm=arm,
                runs=len(values),
                median_m=statistics.bootstrap(lambda x: float(np.median(x)), (values,)),
                best_m=float(values.max()),
                failed=float(np.mean(failures != "ok")),
                a12=a12.get(arm),
                mann_whitney_p=p.get(arm),
            )
        )
    return rows


def _gains(config: StudyConfig, runs: dict[str, list[Run]]) -> list[Gain]:
    reached = {}
    for arm in config.comparable():
        values = np.array([run.at_generation(config.generation) for run in runs.get(arm, [])])
        if np.isfinite(values).any():
            reached[arm] = values[np.isfinite(values)]
    if np.median(reached.get(config.reference, 0.0)) <= 0:
        return []

    def ratio(a: Array, b: Array) -> float:
        return float(np.median(a) / np.median(b)) if np.median(b) > 0 else np.inf

    ratios = _compare(config, reached, lambda a, b: statistics.bootstrap(ratio, (a,), (b,)))
    return [Gain(arm, len(reached[arm]), estimate) for arm, estimate in ratios.items()]


def _compare(config: StudyConfig, groups: dict[str, G], compare: Callable[[G, G], T]) -> dict[str, T]:
    """Compare each arm with the reference, if the reference has runs."""
    base = groups.get(config.reference)
    if base is None:
        return {}
    return {arm: compare(group, base) for arm, group in groups.items() if arm != config.reference}


def _speed_up(group: Arrivals, reference: Arrivals) -> Estimate:
    if not (group[1].any() and reference[1].any()):  # no interval can be estimated
        return Estimate(statistics.speed_up(*group, *reference), float("nan"), float("nan"))
    return statistics.bootstrap(statistics.speed_up, group, reference)


def summarize(analysis: Analysis) -> list[str]:
    """State the results of a study in sentences."""
    config, lines = analysis.config, []
    if analysis.missing:
        shown = ", ".join(map(str, analysis.missing[:6])) + (", ..." if analysis.missing[6:] else "")
        lines.append(
            f"UNFINISHED: {len(analysis.missing)} of {len(config.cells())} runs are missing ({shown}); "
            "these results cover the others."
        )
    if analysis.thresholds_m is None:
        lines.append("There are no thresholds yet: the pilot runs are not finished.")
    elif not analysis.thresholds_m:
        lines.append("There are no thresholds: most pilot runs of the reference never crawled forwards.")
    else:
        lines += _summarize_times(analysis, analysis.thresholds_m[-1])
    medians = {row.arm: row.median_m.value for row in analysis.finals}
    lines += [
        f"{row.arm}: median final distance {_mm(row.median_m.value)}, against "
        f"{_mm(medians[config.reference])} for the reference; A12 {format_estimate(row.a12)}, "
        f"Mann-Whitney p {format_p(row.mann_whitney_p)}."
        for row in analysis.finals
        if row.a12 is not None
    ]
    for gain in analysis.gains:
        value, low, high = (100 * (ratio - 1) for ratio in gain.ratio)
        lines.append(
            f"{gain.arm}: {value:+.0f} % distance at generation {config.generation} "
            f"against the reference ({low:+.0f} to {high:+.0f} %; {gain.runs} runs)."
        )
    return lines


def _summarize_times(analysis: Analysis, threshold_m: float) -> list[str]:
    lines = []
    for row in analysis.times[threshold_m]:
        line = f"{row.arm}: {row.reached} of {row.runs} runs reach {_mm(threshold_m)}"
        if row.speed_up is not None:
            line += f"; speed-up {format_estimate(row.speed_up)}, log-rank p {format_p(row.log_rank_p)}"
        lines.append(line + ".")
    return lines


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


def format_p(p: float | None) -> str:
    """Format a p value with three decimals."""
    if p is None:
        return ""
    return "< 0.001" if p < 0.001 else f"{p:.3f}"
