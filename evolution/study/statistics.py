"""Statistics of times to a threshold, which can be censored, and of distances.

All functions take plain arrays with one value per run. Confidence intervals are at the level `LEVEL`.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, stats

from caterpillar_env.arrays import Array

Flags = NDArray[np.bool_]

LEVEL = 0.95  #: confidence level of all intervals
RESAMPLES = 4_999
_SEED = 2009


class Estimate(NamedTuple):
    """A value with its confidence interval. The bounds are NaN if there is no interval."""

    value: float
    low: float
    high: float


class Survival(NamedTuple):
    """Kaplan-Meier estimate of the share of runs that have not reached the threshold, over time."""

    time: Array  #: times at which the step function changes, ascending, (K,)
    share: Array  #: share from each time on, (K,)
    low: Array  #: lower bound of Greenwood's interval on the log-log scale, (K,)
    high: Array  #: upper bound, (K,)
    median: Estimate  #: median time; infinite if fewer than half of the runs reached the threshold


def kaplan_meier(time: Array, reached: Flags) -> Survival:
    """Estimate the survival curve (Kaplan and Meier 1958), with Greenwood's log-log interval.

    Args:
        time: time at which each run reached the threshold or was censored, (n,).
        reached: True for runs that reached the threshold, False for censored runs, (n,).
    """
    curve = stats.ecdf(_censored(time, reached)).sf
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # the interval is undefined where the share is 0 or 1
        interval = curve.confidence_interval(LEVEL, method="log-log")
    times, share = curve.quantiles, curve.probabilities
    low = np.where(np.isnan(interval.low.probabilities), share, interval.low.probabilities)
    high = np.where(np.isnan(interval.high.probabilities), 1.0, interval.high.probabilities)
    # Greenwood's formula is undefined at a share of 0: keep the last upper bound that is defined.
    last = int(np.argmax(share == 0)) if np.any(share == 0) else len(share)
    high[last:] = high[last - 1] if last else 1.0
    # Brookmeyer and Crowley 1982: the interval of the median contains the times whose band covers 0.5.
    median = Estimate(*(_first_below(times, values) for values in (share, low, high)))
    if not np.any(reached):
        median = Estimate(float("inf"), float("nan"), float("nan"))
    return Survival(times, share, low, high, median)


def _censored(time: Array, reached: Flags) -> Any:
    """Convert times to SciPy's censored data."""
    return stats.CensoredData.right_censored(np.asarray(time, dtype=float), ~np.asarray(reached))


def _first_below(times: Array, share: Array) -> float:
    below = np.flatnonzero(share <= 0.5 + 1e-9)  # products of shares are rounded
    return float(times[below[0]]) if below.size else float("inf")


def log_rank(time_a: Array, reached_a: Flags, time_b: Array, reached_b: Flags) -> float:
    """Return the p value of the log-rank test (Mantel 1966), or 1 where it is undefined."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # undefined where all times are equal
        p = float(stats.logrank(_censored(time_a, reached_a), _censored(time_b, reached_b)).pvalue)
    return p if np.isfinite(p) else 1.0


def expected_running_time(time: Array, reached: Flags) -> float:
    """Return the ERT: total time of all runs per run that reached the threshold (Hansen et al. 2021)."""
    successes = int(np.count_nonzero(reached))
    return float(np.sum(time)) / successes if successes else float("inf")


def speed_up(time: Array, reached: Flags, reference_time: Array, reference_reached: Flags) -> float:
    """Return the ratio of ERTs, reference to group. It is NaN if no run reached the threshold."""
    ert = expected_running_time(time, reached)
    reference_ert = expected_running_time(reference_time, reference_reached)
    return float("nan") if np.isinf(ert) and np.isinf(reference_ert) else reference_ert / ert


def bootstrap(statistic: Callable[..., float], *groups: tuple[NDArray[Any], ...]) -> Estimate:
    """Estimate a statistic of groups of runs with the percentile interval of the bootstrap.

    The interval is NaN if the statistic is infinite or undefined. Resamples in which the statistic is
    undefined are ignored. Equal arguments give equal intervals.

    Args:
        statistic: function of the arrays of all groups, in order.
        groups: arrays of each group, with one value per run. Arrays of a group are resampled together.
    """
    rng = np.random.default_rng(_SEED)
    value = statistic(*(array for group in groups for array in group))
    if not np.isfinite(value):
        return Estimate(value, float("nan"), float("nan"))
    values = np.empty(RESAMPLES)
    for i in range(RESAMPLES):
        arrays = []
        for group in groups:
            rows = rng.integers(0, len(group[0]), len(group[0]))
            arrays += [array[rows] for array in group]
        values[i] = statistic(*arrays)
    tail = (1.0 - LEVEL) / 2
    # The statistic may be infinite (no run reached the threshold), so do not interpolate quantiles.
    values = np.sort(values[~np.isnan(values)])
    low, high = (values[round(q * (len(values) - 1))] for q in (tail, 1.0 - tail))
    return Estimate(value, float(low), float(high))


def median(values: Array) -> Estimate:
    """Estimate the median."""
    return bootstrap(lambda sample: float(np.median(sample)), (values,))


def a12(a: Array, b: Array) -> Estimate:
    """Estimate the probability that a run of `a` is better than one of `b` (Vargha and Delaney 2000).

    Ties count half. The interval is that of Newcombe's method 5 (2006), which has a positive width even
    if one group always wins.
    """
    u = stats.mannwhitneyu(a, b).statistic
    pairs = len(a) * len(b)
    value = float(u) / pairs
    others = (len(a) + len(b)) / 2 - 1
    z = float(stats.norm.ppf(0.5 + LEVEL / 2))

    def excess(theta: float) -> float:
        spread = theta * (1 - theta) / pairs
        spread *= 1 + others * ((1 - theta) / (2 - theta) + theta / (1 + theta))
        return (value - theta) ** 2 - z * z * spread

    inside = min(max(value, 1e-12), 1 - 1e-12)  # the spread vanishes at exactly 0 and 1
    low = 0.0 if value == 0 else float(optimize.brentq(excess, 0.0, inside))
    high = 1.0 if value == 1 else float(optimize.brentq(excess, inside, 1.0))
    return Estimate(value, low, high)


def holm(p: Mapping[str, float]) -> dict[str, float]:
    """Correct the p values of a family of tests by Holm's method (1979)."""
    corrected, largest = {}, 0.0
    for rank, name in enumerate(sorted(p, key=p.__getitem__)):
        largest = max(largest, min((len(p) - rank) * p[name], 1.0))
        corrected[name] = largest
    return corrected


def target_ecdf(times: Array, grid: Array) -> Array:
    """Return the share of (run, target) pairs reached by each time of `grid`, (T,).

    Args:
        times: time at which each run reached each target, infinite if never, (runs, targets).
        grid: times, (T,).
    """
    flat = np.sort(np.ravel(times))
    share: Array = np.searchsorted(flat, grid, side="right") / flat.size
    return share
