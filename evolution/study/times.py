"""Times to threshold distances, and the speed-up of each arm over its reference."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cache, partial
from typing import Any, NamedTuple, TypeVar

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
        return f"the reference's distance after {self.generations} generations"

    def find(self, reference: Sequence[Run]) -> Callable[[Rows], float]:
        """Return a function from indices of the reference's runs to the threshold, m.

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

    def of(self, reference: Sequence[Run]) -> float:
        """Return the threshold for all runs of the reference, m, or NaN."""
        return self.find(reference)(np.arange(len(reference)))


class Times(NamedTuple):
    """Simulated times at which the runs of an arm reach a threshold."""

    arm: str
    threshold_m: float  #: NaN if the runs of the reference do not define it
    runs: int
    reached: int
    median_s: Estimate  #: Kaplan-Meier
    median_generations: Estimate | None  #: the same in generations; None if not comparable
    running_time_s: Estimate  #: ERT
    speed_up: Estimate | None  #: ratio of ERTs, reference to arm; None for a reference
    log_rank_p: float | None  #: against the reference, corrected over the arms (Holm)


def arrivals(runs: Sequence[Run], threshold_m: float) -> Arrivals:
    """Return each run's time (s) to a threshold or to the end of its budget, (n,).

    The second array, (n,), is True where a run reached the threshold.
    """
    times = np.array([run.time_to(threshold_m) for run in runs])
    return np.minimum(times, [run.budget_s for run in runs]), np.isfinite(times)


def count_generations(runs: Sequence[Run], threshold_m: float) -> Arrivals:
    """Return each run's number of generations to a threshold or to its end; see `arrivals`."""
    counts = np.array([run.generations_to(threshold_m) for run in runs])
    return np.minimum(counts, [run.generations for run in runs]), np.isfinite(counts)


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
    speed-ups include its uncertainty: each resample has its own threshold.
    """

    def test(group: list[Run], reference: list[Run]) -> float:
        level_m = threshold.of(reference)
        return statistics.log_rank(*arrivals(group, level_m), *arrivals(reference, level_m))

    comparable = config.comparable()
    log_rank = statistics.holm(compare(config, runs, test))
    speed_up = compare(config, runs, partial(_speed_up, threshold))
    rows = []
    for arm, found in runs.items():
        reference = runs.get(config.reference_of(arm), [])
        level_m = threshold.of(reference)
        time, reached = arrivals(found, level_m)
        counts = count_generations(found, level_m) if arm in comparable else None
        rows.append(
            Times(
                arm=arm,
                threshold_m=level_m,
                runs=len(time),
                reached=int(reached.sum()),
                median_s=statistics.kaplan_meier(time, reached).median,
                median_generations=counts and statistics.kaplan_meier(*counts).median,
                running_time_s=_running_time(threshold, found, reference),
                speed_up=speed_up.get(arm),
                log_rank_p=log_rank.get(arm),
            )
        )
    return rows


def find_speed_ups(config: StudyConfig, runs: Runs) -> dict[str, list[tuple[float, Estimate]]]:
    """Return the speed-up of each arm over a range of thresholds (m) that its reference reached."""

    def find(group: list[Run], reference: list[Run]) -> list[tuple[float, Estimate]]:
        farthest_m = max(run.best_m[-1] for run in reference)
        levels_m = farthest_m * np.linspace(1 / STEPS, 1.0, STEPS)
        return [(level, _speed_up(Threshold(level), group, reference)) for level in levels_m.tolist()]

    return compare(config, runs, find)


def _indices(runs: Sequence[Run]) -> tuple[NDArray[Any]]:
    return (np.arange(len(runs)),)


def _running_time(threshold: Threshold, runs: list[Run], reference: list[Run]) -> Estimate:
    """Estimate the ERT to a threshold."""
    level, find = threshold.find(reference), cache(partial(arrivals, runs))

    def running_time(rows: Rows, base: Rows | None = None) -> float:
        level_m = level(rows if base is None else base)
        time, reached = find(level_m)
        ert = statistics.expected_running_time(time[rows], reached[rows])
        return float("nan") if np.isnan(level_m) else ert

    if threshold.fixed_m is not None or runs is reference:
        return statistics.bootstrap(running_time, _indices(runs))
    return statistics.bootstrap(running_time, _indices(runs), _indices(reference))


def _speed_up(threshold: Threshold, runs: list[Run], reference: list[Run]) -> Estimate:
    """Estimate the ratio of ERTs to a threshold, reference to arm."""
    level = threshold.find(reference)
    find, find_base = cache(partial(arrivals, runs)), cache(partial(arrivals, reference))

    def speed_up(rows: Rows, base: Rows) -> float:
        level_m = level(base)
        (time, reached), (base_time, base_reached) = find(level_m), find_base(level_m)
        return statistics.speed_up(time[rows], reached[rows], base_time[base], base_reached[base])

    both, level_m = (_indices(runs), _indices(reference)), threshold.of(reference)
    if not (find(level_m)[1].any() and find_base(level_m)[1].any()):  # no interval can be estimated
        return Estimate(speed_up(both[0][0], both[1][0]), float("nan"), float("nan"))
    return statistics.bootstrap(speed_up, *both)
