"""Statistics of times to a threshold, which can be censored, and of distances.

All functions take plain arrays with one value per run. Confidence intervals are at the level `LEVEL`.
"""

from __future__ import annotations

import itertools
import math
import warnings
from collections.abc import Callable, Mapping
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy import optimize, stats

from caterpillar_env.arrays import Array

Flags = NDArray[np.bool_]

LEVEL = 0.95  #: confidence level of all intervals
FEWEST = 5  #: minimum number of runs in a group for a bootstrap interval
RESAMPLES = 4_999
PERMUTATIONS = 4_999
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


def find_median(time: Array, reached: Flags) -> float:
    """Return the median time of the Kaplan-Meier estimate, infinite if the share stays above 0.5."""
    order = np.lexsort((~reached, time))  # at equal times, runs that reached the threshold come first
    share = np.cumprod(1.0 - reached[order] / np.arange(len(time), 0, -1), dtype=np.float64)
    return _first_below(time[order], share)


def log_rank_statistic(time: Array, reached: Flags, first: Flags) -> float:
    """Return the statistic of the log-rank test (Mantel 1966), or 0 where it is undefined.

    Args:
        time: time at which each run of both groups reached the threshold or was censored, (n,).
        reached: True for runs that reached the threshold, False for censored runs, (n,).
        first: True for runs of the first group, (n,).

    Returns:
        The absolute difference between the observed and the expected number of runs of the first group
        that reach the threshold, in standard deviations.
    """
    at, events = np.unique(time[reached], return_counts=True)
    risk, risk_first = (
        len(group) - np.searchsorted(np.sort(group), at, side="left") for group in (time, time[first])
    )
    share = risk_first / risk
    expected = float(np.sum(events * share))
    variance = events * share * (1.0 - share) * (risk - events) / np.maximum(risk - 1, 1)
    spread = float(np.sqrt(np.sum(variance)))
    return abs(np.count_nonzero(reached & first) - expected) / spread if spread > 0 else 0.0


def permutation_p(statistic: Callable[[Flags], float], first: int, total: int) -> float:
    """Return the p value of a permutation test of two groups.

    All assignments of the runs to the groups are tried if there are at most `PERMUTATIONS`, else
    `PERMUTATIONS` random ones. The test is exact in both cases (Phipson and Smyth 2010).

    Args:
        statistic: function of a mask of the runs of the first group, (total,). Large values speak
            against equal groups.
        first: number of runs of the first group, which come first.
        total: number of runs of both groups.
    """
    observed = np.arange(total) < first
    least = statistic(observed) * (1.0 - 1e-9)
    if math.comb(total, first) <= PERMUTATIONS:
        masks = (np.isin(np.arange(total), rows) for rows in itertools.combinations(range(total), first))
        return float(np.mean([statistic(mask) >= least for mask in masks]))
    rng = np.random.default_rng(_SEED)
    extreme = sum(statistic(rng.permutation(observed)) >= least for _ in range(PERMUTATIONS))
    return (1 + extreme) / (1 + PERMUTATIONS)


def mann_whitney(a: Array, b: Array) -> float:
    """Return the p value of the Mann-Whitney test, which is exact without ties.

    With ties, it comes from permutations if both groups have at most ten runs, else from the normal
    approximation.
    """
    method: Any = "exact"
    if len(np.unique(np.concatenate([a, b]))) < len(a) + len(b):
        small = max(len(a), len(b)) <= 10
        rng = np.random.default_rng(_SEED)
        method = stats.PermutationMethod(n_resamples=PERMUTATIONS, rng=rng) if small else "asymptotic"
    return float(stats.mannwhitneyu(a, b, method=method).pvalue)


def expected_running_time(time: Array, reached: Flags) -> float:
    """Return the expected running time (ERT) to a threshold (Hansen et al. 2021).

    This is the total time of all runs, divided by the number of runs that reached the threshold.
    """
    successes = int(np.count_nonzero(reached))
    return float(np.sum(time)) / successes if successes else float("inf")


def speed_up(time: Array, reached: Flags, reference_time: Array, reference_reached: Flags) -> float:
    """Return the reference's ERT divided by the group's, or NaN if no run reached the threshold."""
    ert = expected_running_time(time, reached)
    reference_ert = expected_running_time(reference_time, reference_reached)
    return float("nan") if np.isinf(ert) and np.isinf(reference_ert) else reference_ert / ert


def bootstrap(
    statistic: Callable[..., float], *groups: tuple[NDArray[Any], ...], defined_by: int | None = None
) -> Estimate:
    """Estimate a statistic of one or more groups of runs, with a percentile bootstrap interval.

    The quantiles are those of Hesterberg (2015), which are wider for small groups. The interval is NaN
    if the statistic is infinite or undefined, or rests on fewer than `FEWEST` runs. Resamples in
    which the statistic is undefined are ignored. Equal arguments give equal intervals.

    Args:
        statistic: function of the arrays of all groups, in order.
        groups: arrays of each group, with one value per run. Arrays of a group are resampled together.
        defined_by: number of runs that the statistic rests on, if smaller than all groups.
    """
    rng = np.random.default_rng(_SEED)
    value = statistic(*(array for group in groups for array in group))
    size = min(len(group[0]) for group in groups)
    if defined_by is not None:
        size = min(size, defined_by)
    if not np.isfinite(value) or size < FEWEST:
        return Estimate(value, float("nan"), float("nan"))
    values = np.empty(RESAMPLES)
    for i in range(RESAMPLES):
        arrays = []
        for group in groups:
            rows = rng.integers(0, len(group[0]), len(group[0]))
            arrays += [array[rows] for array in group]
        values[i] = statistic(*arrays)
    tail = float(stats.norm.sf(np.sqrt(size / (size - 1)) * stats.t.ppf(0.5 + LEVEL / 2, size - 1)))
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


def holm(p: Mapping[str, float], planned: int = 0) -> dict[str, float]:
    """Correct the p values of a family of tests by Holm's method (1979).

    Args:
        p: p values by name.
        planned: number of tests in the complete family, if some p values are not known yet.
    """
    corrected, largest, count = {}, 0.0, max(planned, len(p))
    for rank, name in enumerate(sorted(p, key=p.__getitem__)):
        largest = max(largest, min((count - rank) * p[name], 1.0))
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
