"""What a study says of its runs: times to a threshold, some of them censored, and final fitness.

Every function takes plain arrays, one value a run. Intervals are of 95 % unless asked otherwise.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, stats

from caterpillar_env.arrays import Array

Flags = NDArray[np.bool_]

LEVEL = 0.95
RESAMPLES = 4_999


class Estimate(NamedTuple):
    """A value with its confidence interval."""

    value: float
    low: float
    high: float


class Survival(NamedTuple):
    """Kaplan-Meier's share of runs that have not reached the threshold, a step function of time."""

    time: Array  #: where it steps, ascending, (K,)
    share: Array  #: from each time on, (K,)
    low: Array  #: Greenwood's interval on the log-log scale, (K,)
    high: Array
    median: Estimate  #: infinite where fewer than half have reached it


def kaplan_meier(time: Array, reached: Flags, level: float = LEVEL) -> Survival:
    """Share of runs still under way (Kaplan and Meier 1958), with Greenwood's log-log interval.

    Args:
        time: when a run reached the threshold, or stopped short of it, (n,).
        reached: which of the two, (n,).
        level: of the interval.
    """
    function = _under_way(time, reached)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the interval is undefined where the share is 0 or 1
        interval = function.confidence_interval(level, method="log-log")
    times, share = function.quantiles, function.probabilities
    low = np.where(np.isnan(interval.low.probabilities), share, interval.low.probabilities)
    high = np.where(np.isnan(interval.high.probabilities), 1.0, interval.high.probabilities)
    # Where nobody is left the formula has no value; what is known is what was known before.
    last = int(np.argmax(share == 0)) if np.any(share == 0) else len(share)
    high[last:] = high[last - 1] if last else 1.0
    # Brookmeyer and Crowley 1982: the median's interval is where the curve's covers one half.
    median = Estimate(*(_first_below(times, curve) for curve in (share, low, high)))
    if not np.any(reached):  # nothing tells when half of them would have
        median = Estimate(float("inf"), float("nan"), float("nan"))
    return Survival(times, share, low, high, median)


def _under_way(time: Array, reached: Flags) -> Any:
    """SciPy's Kaplan-Meier estimate."""
    data = stats.CensoredData.right_censored(np.asarray(time, dtype=float), ~np.asarray(reached))
    return stats.ecdf(data).sf


def _first_below(times: Array, share: Array) -> float:
    below = np.flatnonzero(share <= 0.5)
    return float(times[below[0]]) if below.size else float("inf")


def log_rank(time_a: Array, reached_a: Flags, time_b: Array, reached_b: Flags) -> float:
    """P value of two groups having one distribution of times (Mantel 1966)."""
    if not (np.any(reached_a) or np.any(reached_b)):
        return 1.0  # nobody got there: nothing tells them apart
    first, second = (
        stats.CensoredData.right_censored(np.asarray(t, dtype=float), ~np.asarray(r))
        for t, r in ((time_a, reached_a), (time_b, reached_b))
    )
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # all at one moment: undefined, and telling nothing
        p = float(stats.logrank(first, second).pvalue)
    return p if np.isfinite(p) else 1.0


def expected_running_time(time: Array, reached: Flags) -> float:
    """Time spent by all runs over the number of those that got there (Hansen et al. 2021, ERT)."""
    successes = int(np.count_nonzero(reached))
    return float(np.sum(time)) / successes if successes else float("inf")


def restricted_mean_time(time: Array, reached: Flags, horizon: float) -> float:
    """Mean time to the threshold, none counted as more than `horizon`: area below the survival curve."""
    curve = _under_way(time, reached)
    inside = curve.quantiles < horizon
    edges = np.concatenate([[0.0], curve.quantiles[inside], [horizon]])
    heights = np.concatenate([[1.0], curve.probabilities[inside]])
    return float(np.sum(np.diff(edges) * heights))


def bootstrap(
    statistic: Callable[..., float],
    groups: Sequence[tuple[NDArray[Any], ...]],
    rng: np.random.Generator,
    *,
    level: float = LEVEL,
    resamples: int = RESAMPLES,
) -> Estimate:
    """A statistic of groups of runs, with the percentile interval of the bootstrap.

    Where the statistic is infinite or undefined (nobody reached the threshold), no interval can be had
    by drawing runs anew: its ends are NaN. Draws in which it is undefined are left out.

    Args:
        statistic: takes the arrays of the first group, then those of the next.
        groups: arrays of one length within a group; the runs of each are drawn anew, with replacement.
        rng: draws.
        level: of the interval.
        resamples: how often.
    """
    value = statistic(*(array for group in groups for array in group))
    if not np.isfinite(value):
        return Estimate(value, float("nan"), float("nan"))
    drawn = np.empty(resamples)
    for i in range(resamples):
        arrays = []
        for group in groups:
            rows = rng.integers(0, len(group[0]), len(group[0]))
            arrays += [array[rows] for array in group]
        drawn[i] = statistic(*arrays)
    tail = (1.0 - level) / 2
    # Infinite times (nobody reached it) are values like others: no interpolation between them.
    drawn = np.sort(drawn[~np.isnan(drawn)])
    low, high = (drawn[round(q * (len(drawn) - 1))] for q in (tail, 1.0 - tail))
    return Estimate(value, float(low), float(high))


def speed_up(time: Array, reached: Flags, reference_time: Array, reference_reached: Flags) -> float:
    """How many times faster than the reference: the ratio of the expected running times."""
    ours = expected_running_time(time, reached)
    theirs = expected_running_time(reference_time, reference_reached)
    if np.isinf(ours) and np.isinf(theirs):
        return float("nan")
    return theirs / ours


def a12(a: Array, b: Array, level: float = LEVEL) -> Estimate:
    """Probability that a run of `a` beats one of `b`, ties half (Vargha and Delaney 2000).

    The interval is Newcombe's fifth (2006): it does not collapse where one group beats the other always.
    """
    u = stats.mannwhitneyu(a, b).statistic
    pairs = len(a) * len(b)
    value = float(u) / pairs
    others = (len(a) + len(b)) / 2 - 1
    z = float(stats.norm.ppf(0.5 + level / 2))

    def excess(theta: float) -> float:
        spread = theta * (1 - theta) / pairs
        spread *= 1 + others * ((1 - theta) / (2 - theta) + theta / (1 + theta))
        return (value - theta) ** 2 - z * z * spread

    inside = min(max(value, 1e-12), 1 - 1e-12)  # at 0 and 1 themselves the spread vanishes
    low = 0.0 if value == 0 else float(optimize.brentq(excess, 0.0, inside))
    high = 1.0 if value == 1 else float(optimize.brentq(excess, inside, 1.0))
    return Estimate(value, low, high)


def mann_whitney(a: Array, b: Array) -> float:
    """P value of two groups having one distribution; exact for small groups without ties."""
    return float(stats.mannwhitneyu(a, b).pvalue)


def wilcoxon(a: Array, b: Array) -> float:
    """P value of paired differences being symmetric about zero (Wilcoxon's signed ranks)."""
    difference = np.asarray(a) - np.asarray(b)
    return float(stats.wilcoxon(difference).pvalue) if np.any(difference) else 1.0


def holm(p: Sequence[float]) -> Array:
    """P values of a family of tests, corrected for their number (Holm 1979)."""
    values = np.asarray(p, dtype=float)
    order = np.argsort(values)
    steps = np.maximum.accumulate(values[order] * np.arange(len(values), 0, -1))
    corrected = np.empty_like(values)
    corrected[order] = np.minimum(steps, 1.0)
    return corrected


def interquartile_mean(values: Array) -> float:
    """Mean of the middle half (Agarwal et al. 2021, IQM)."""
    return float(stats.trim_mean(values, 0.25))


def target_ecdf(times: Array, grid: Array) -> Array:
    """Share of (run, target) pairs reached by each time of `grid`.

    Args:
        times: of reaching each target, infinite if never, (runs, targets).
        grid: (T,).
    """
    flat = np.sort(np.ravel(times))
    share: Array = np.searchsorted(flat, grid, side="right") / flat.size
    return share
