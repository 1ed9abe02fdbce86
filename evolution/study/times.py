"""Times to threshold distances, and the speed-up of each arm over its reference."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache, partial
from typing import NamedTuple, TypeVar

import numpy as np
from numpy.typing import NDArray

from caterpillar_env.arrays import Array
from evolution.study import statistics
from evolution.study.config import StudyConfig
from evolution.study.results import Run
from evolution.study.statistics import Estimate

STEPS = 10  #: number of thresholds over which the speed-up is shown

Arrivals = tuple[Array, NDArray[np.bool_]]
Rows = NDArray[np.int64]
Runs = dict[str, list[Run]]
G = TypeVar("G")
T = TypeVar("T")


class Threshold(NamedTuple):
    """A distance to reach: fixed, or the reference's median distance after some generations."""

    fixed_m: float | None = None
    generations: int = 0  #: number of generations, if the distance is not fixed

    def __str__(self) -> str:
        if self.fixed_m is not None:
            return f"{1000 * self.fixed_m:.0f} mm"
        unit = "generation" if self.generations == 1 else "generations"
        return f"the reference's distance after {self.generations} {unit}"

    def find(self, reference: Sequence[Run]) -> Callable[[Rows], float]:
        """Return a function that computes the threshold (m) from indices of the reference's runs.

        The threshold is NaN if these runs do not define it.
        """
        best_m = np.array([run.best_after(self.generations) for run in reference])

        def find(rows: Rows) -> float:
            if self.fixed_m is not None:
                return self.fixed_m
            known = best_m[rows][~np.isnan(best_m[rows])]
            median_m = float(np.median(known)) if known.size else 0.0
            return median_m if median_m > 0 else float("nan")

        return find

    def count_defining(self, reference: Sequence[Run]) -> int | None:
        """Return how many of the reference's runs define the threshold, or None if it is fixed."""
        if self.fixed_m is not None:
            return None
        return sum(bool(np.isfinite(run.best_after(self.generations))) for run in reference)

    def of(self, reference: Sequence[Run]) -> float:
        """Return the threshold for all runs of the reference, m, or NaN."""
        return self.find(reference)(np.arange(len(reference)))


class Times(NamedTuple):
    """Simulated times at which the runs of an arm reach a threshold."""

    arm: str
    threshold_m: float  #: NaN if the runs of the reference do not define it
    defined_by: int | None  #: number of the reference's runs that define the threshold, if not fixed
    runs: int
    completed: int  #: number of generations that all runs completed
    reached: int  #: number of runs that reach it within the study's `budget_s`
    median_s: Estimate  #: Kaplan-Meier
    median_generations: Estimate | None  #: the same in generations; None if not comparable
    #: Speed-up in generations, as in the paper: the number of generations that defines the threshold,
    #: divided by the number after which the arm's median run reaches it. 0 if fewer than half of the
    #: runs reach it; None for a fixed threshold, or another algorithm than that of the reference of the
    #: study. The value of a reference exceeds 1 if its median run reaches the threshold earlier.
    acceleration: Estimate | None
    running_time_s: Estimate  #: expected running time (ERT) within the study's `budget_s`
    speed_up: Estimate | None  #: ratio of ERTs, reference to arm; None for a reference
    #: against the reference, corrected over the arms (Holm); None if the threshold is not known
    log_rank_p: float | None


def arrivals(runs: Sequence[Run], threshold_m: float, budget_s: float = np.inf) -> Arrivals:
    """Return each run's time (s) to a threshold or to the end of its budget, (n,).

    The second array, (n,), is True where a run reached the threshold. With `budget_s`, longer runs are
    censored at this time.
    """
    times = np.array([run.time_to(threshold_m) for run in runs])
    ends = np.minimum([run.budget_s for run in runs], budget_s)
    return np.minimum(times, ends), times <= ends


def count_generations(runs: Sequence[Run], threshold_m: float) -> Arrivals:
    """Return each run's number of generations to a threshold, or to the end of the run, (n,).

    The second array, (n,), is True where a run reached the threshold.
    """
    counts = np.array([run.generations_to(threshold_m) for run in runs])
    reached = np.isfinite(counts)
    return np.where(reached, counts, [run.generations for run in runs]), reached


def compare(config: StudyConfig, groups: dict[str, G], statistic: Callable[[G, G], T]) -> dict[str, T]:
    """Compare each arm with its reference, where both have runs."""
    found = {}
    for arm, group in groups.items():
        name = config.reference_of(arm)
        if name != arm and name in groups:
            found[arm] = statistic(group, groups[name])
    return found


def find_times(config: StudyConfig, runs: Runs, threshold: Threshold) -> list[Times]:
    """Return the times of all arms to a threshold.

    Where the threshold depends on the reference's runs, bootstrap intervals of running times and
    speed-ups include the uncertainty of the threshold: each resample has its own one. So does each
    permutation of the log-rank test, unless some runs ended before the generation that defines it. If
    fewer than `statistics.FEWEST` runs define the threshold, there are neither these intervals nor
    a p value.
    """
    comparable, budget_s = config.comparable(), config.budget_s
    p = compare(config, runs, partial(_log_rank, threshold, budget_s=budget_s))
    known = {arm: value for arm, value in p.items() if value is not None}
    log_rank = statistics.holm(known, config.comparisons())
    speed_up = compare(config, runs, partial(estimate_speed_up, threshold, budget_s=budget_s))
    rows = []
    for arm, found in runs.items():
        reference = runs.get(config.reference_of(arm), [])
        level_m = threshold.of(reference)
        counts = acceleration = None
        if arm in comparable:
            counts = count_generations(found, level_m)
            if config.reference_of(arm) in comparable and reference and threshold.fixed_m is None:
                acceleration = _accelerate(threshold, found, reference)
        rows.append(
            Times(
                arm=arm,
                threshold_m=level_m,
                defined_by=threshold.count_defining(reference),
                runs=len(found),
                completed=min(run.generations for run in found),
                reached=int(arrivals(found, level_m, budget_s)[1].sum()),
                median_s=statistics.kaplan_meier(*arrivals(found, level_m)).median,
                median_generations=counts and statistics.kaplan_meier(*counts).median,
                acceleration=acceleration,
                running_time_s=_running_time(threshold, found, reference, budget_s),
                speed_up=speed_up.get(arm),
                log_rank_p=log_rank.get(arm),
            )
        )
    return rows


def find_speed_ups(config: StudyConfig, runs: Runs) -> dict[str, list[tuple[float, Estimate]]]:
    """Return the speed-up of each arm over a range of thresholds (m).

    The last threshold is the distance that a quarter of the reference's runs exceed.
    """

    def find(group: list[Run], reference: list[Run]) -> list[tuple[float, Estimate]]:
        best_m = [run.best_at(config.budget_s) for run in reference]
        levels_m = np.quantile(best_m, 0.75) * np.linspace(1 / STEPS, 1.0, STEPS)
        return [
            (level_m, estimate_speed_up(Threshold(level_m), group, reference, budget_s=config.budget_s))
            for level_m in levels_m.tolist()
            if level_m > 0
        ]

    return {arm: rows for arm, rows in compare(config, runs, find).items() if rows}


def indices(runs: Sequence[Run]) -> tuple[Rows]:
    """Return the indices of runs as a group for `statistics.bootstrap`."""
    return (np.arange(len(runs)),)


def _log_rank(
    threshold: Threshold, runs: list[Run], reference: list[Run], *, budget_s: float
) -> float | None:
    """Return the p value of a log-rank test with permutations, with all runs censored at `budget_s`.

    It is None if too few runs define the threshold.
    """
    both, known_m = [*runs, *reference], threshold.of(reference)
    defined_by = threshold.count_defining(reference)
    if defined_by is not None and (defined_by < statistics.FEWEST or np.isnan(known_m)):
        return None
    find, level = cache(partial(arrivals, both, budget_s=budget_s)), threshold.find(both)
    is_fixed = np.isnan([run.best_after(threshold.generations) for run in both]).any()

    def statistic(first: NDArray[np.bool_]) -> float:
        level_m = known_m if is_fixed else level(np.flatnonzero(~first))
        return 0.0 if np.isnan(level_m) else statistics.log_rank_statistic(*find(level_m), first)

    return statistics.permutation_p(statistic, len(runs), len(both))


def _accelerate(threshold: Threshold, runs: list[Run], reference: list[Run]) -> Estimate:
    """Estimate the speed-up in generations, see `Times.acceleration`."""
    level, find = threshold.find(reference), cache(partial(count_generations, runs))

    def acceleration(rows: Rows, base: Rows | None = None) -> float:
        level_m = level(rows if base is None else base)
        counts, reached = find(level_m)
        median = statistics.find_median(counts[rows], reached[rows])
        return float("nan") if np.isnan(level_m) else threshold.generations / median

    groups = (runs,) if runs is reference else (runs, reference)
    return statistics.bootstrap(
        acceleration, *map(indices, groups), defined_by=threshold.count_defining(reference)
    )


def _running_time(
    threshold: Threshold, runs: list[Run], reference: list[Run], budget_s: float
) -> Estimate:
    """Estimate the expected running time (ERT) to a threshold."""
    level, find = threshold.find(reference), cache(partial(arrivals, runs, budget_s=budget_s))

    def running_time(rows: Rows, base: Rows | None = None) -> float:
        level_m = level(rows if base is None else base)
        time, reached = find(level_m)
        ert = statistics.expected_running_time(time[rows], reached[rows])
        return float("nan") if np.isnan(level_m) else ert

    groups = (runs,) if threshold.fixed_m is not None or runs is reference else (runs, reference)
    return statistics.bootstrap(
        running_time, *map(indices, groups), defined_by=threshold.count_defining(reference)
    )


def speed_up_function(
    threshold: Threshold, runs: list[Run], reference: list[Run], *, budget_s: float
) -> Callable[[Rows, Rows], float]:
    """Return a function that computes the ratio of ERTs (reference to arm) from indices of runs."""
    level = threshold.find(reference)
    find, find_base = (cache(partial(arrivals, group, budget_s=budget_s)) for group in (runs, reference))

    def speed_up(rows: Rows, base: Rows) -> float:
        level_m = level(base)
        (time, reached), (base_time, base_reached) = find(level_m), find_base(level_m)
        return statistics.speed_up(time[rows], reached[rows], base_time[base], base_reached[base])

    return speed_up


def estimate_speed_up(
    threshold: Threshold, runs: list[Run], reference: list[Run], *, budget_s: float
) -> Estimate:
    """Estimate the ratio of ERTs to a threshold, reference to arm."""
    speed_up = speed_up_function(threshold, runs, reference, budget_s=budget_s)
    both, level_m = (indices(runs), indices(reference)), threshold.of(reference)
    if not all(arrivals(group, level_m, budget_s)[1].any() for group in (runs, reference)):
        return Estimate(speed_up(both[0][0], both[1][0]), float("nan"), float("nan"))  # no interval
    return statistics.bootstrap(speed_up, *both, defined_by=threshold.count_defining(reference))
