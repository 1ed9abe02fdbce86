"""What a study's runs amount to: tables and sentences, from `study.collect`."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
import polars
from numpy.typing import NDArray

from caterpillar_env.arrays import Array
from evolution.study import statistics
from evolution.study.arms import EvolutionArm
from evolution.study.config import Cell, StudyConfig
from evolution.study.results import Course, courses
from evolution.study.statistics import Estimate

TARGETS = 50
_SEED = 2009  # of the bootstrap


class Times(NamedTuple):
    """How soon an arm's runs reach a threshold; simulated seconds."""

    arm: str
    runs: int
    reached: int
    median_s: Estimate  #: Kaplan-Meier
    restricted_mean_s: Estimate  #: none counted beyond the budget
    running_time_s: Estimate  #: ERT
    speed_up: Estimate | None  #: over the reference; None for itself
    log_rank_p: float | None  #: against the reference, Holm-corrected over the arms


class Finals(NamedTuple):
    """How far an arm's best robots get by the end of the budget, m."""

    arm: str
    runs: int
    median_m: float
    quartiles_m: tuple[float, float]
    interquartile_mean_m: float
    best_m: float
    failed: float  #: share of all evaluations
    a12: Estimate | None  #: against the reference
    mann_whitney_p: float | None  #: likewise, Holm-corrected
    wilcoxon_p: float | None  #: of seeds paired, likewise
    wall_s: float | None  #: median wall time of a run that was not interrupted


class Gain(NamedTuple):
    """Best distance at a generation, over the reference's."""

    arm: str
    generation: int
    runs: int  #: that got so far within the budget
    ratio: Estimate  #: of the medians


@dataclass(frozen=True)
class Analysis:
    """All that is said of a study."""

    config: StudyConfig
    missing: Sequence[Cell]  #: cells that are not finished
    thresholds_m: list[float] | None  #: None as long as the pilot seeds are not through
    courses: dict[str, list[Course]]
    times: dict[float, list[Times]]  #: by threshold
    finals: list[Finals]
    gains: list[Gain]
    ecdf: dict[str, Array]  #: share of (run, target) pairs, over `grid_s`
    grid_s: Array


def analyse(
    config: StudyConfig,
    frame: polars.DataFrame,
    missing: Sequence[Cell],
    thresholds_m: list[float] | None,
) -> Analysis:
    """The tables of a study, of those of its cells that are finished."""
    runs = {arm: found for arm, found in courses(frame, config, config.seeds).items() if found}
    grid_s = np.linspace(0.0, config.budget_s, 201)
    levels = np.linspace(0.02, 1.0, TARGETS) * max(
        (c.best_m[-1] for found in runs.values() for c in found), default=1.0
    )
    return Analysis(
        config=config,
        missing=missing,
        thresholds_m=thresholds_m,
        courses=runs,
        times={t: _times(config, runs, t) for t in thresholds_m or []},
        finals=_finals(config, runs, frame),
        gains=_gains(config, runs),
        ecdf={
            arm: statistics.target_ecdf(
                np.array([[c.reaches(level, np.inf)[0] for level in levels] for c in found]), grid_s
            )
            for arm, found in runs.items()
        },
        grid_s=grid_s,
    )


def arrival(
    found: Sequence[Course], threshold_m: float, budget_s: float
) -> tuple[Array, NDArray[np.bool_]]:
    """When runs reach a threshold, or the budget; and which of them do: (n,) each."""
    pairs = [c.reaches(threshold_m, budget_s) for c in found]
    return np.array([time for time, _ in pairs]), np.array([reached for _, reached in pairs])


def _times(config: StudyConfig, runs: dict[str, list[Course]], threshold_m: float) -> list[Times]:
    arrivals = {arm: arrival(found, threshold_m, config.budget_s) for arm, found in runs.items()}
    reference = arrivals.get(config.reference)
    others = [arm for arm in runs if arm != config.reference and reference is not None]
    tests = [statistics.log_rank(*arrivals[arm], *reference) for arm in others] if reference else []
    corrected = dict(zip(others, statistics.holm(tests), strict=True))
    rows = []
    for arm, (time, reached) in arrivals.items():
        rng = np.random.default_rng(_SEED)
        rows.append(
            Times(
                arm=arm,
                runs=len(time),
                reached=int(reached.sum()),
                median_s=statistics.kaplan_meier(time, reached).median,
                restricted_mean_s=_drawn(
                    lambda t, r: statistics.restricted_mean_time(t, r, config.budget_s),
                    [(time, reached)], rng, resamples=999,
                ),
                running_time_s=statistics.bootstrap(
                    statistics.expected_running_time, [(time, reached)], rng
                ),
                speed_up=_drawn(statistics.speed_up, [(time, reached), reference], rng)
                if arm in corrected and reference is not None
                else None,
                log_rank_p=corrected.get(arm),
            )
        )  # fmt: skip
    return rows


def _drawn(
    statistic: Callable[..., float],
    groups: list[tuple[Array, NDArray[np.bool_]]],
    rng: np.random.Generator,
    **kwargs: Any,
) -> Estimate:
    """The bootstrap; where nobody of a group arrives, drawing anew cannot tell how sure that is."""
    if all(reached.any() for _, reached in groups):
        return statistics.bootstrap(statistic, groups, rng, **kwargs)
    value = statistic(*(array for group in groups for array in group))
    return Estimate(value, float("nan"), float("nan"))


def _finals(config: StudyConfig, runs: dict[str, list[Course]], frame: polars.DataFrame) -> list[Finals]:
    final = {arm: {c.seed: float(c.best_m[-1]) for c in found} for arm, found in runs.items()}
    reference = final.get(config.reference, {})
    others = [arm for arm in final if arm != config.reference and reference]
    base = np.array(list(reference.values()))
    mann = dict(
        zip(
            others,
            statistics.holm(
                [statistics.mann_whitney(np.array(list(final[a].values())), base) for a in others]
            ),
            strict=True,
        )
    )
    paired = {}
    for arm in others:
        seeds = sorted(set(final[arm]) & set(reference))
        paired[arm] = statistics.wilcoxon(
            np.array([final[arm][s] for s in seeds]), np.array([reference[s] for s in seeds])
        )
    signed = dict(zip(others, statistics.holm(list(paired.values())), strict=True))
    rows = []
    for arm, by_seed in final.items():
        values = np.array(list(by_seed.values()))
        mine = within_budget(frame, config, arm)
        walls = mine.group_by("seed").first()["wall_s"].drop_nulls()
        rows.append(
            Finals(
                arm=arm,
                runs=len(values),
                median_m=float(np.median(values)),
                quartiles_m=(float(np.quantile(values, 0.25)), float(np.quantile(values, 0.75))),
                interquartile_mean_m=statistics.interquartile_mean(values),
                best_m=float(values.max()),
                failed=float((mine["failure"] != "ok").mean() or 0.0),  # type: ignore[arg-type]
                a12=statistics.a12(values, base) if arm in mann else None,
                mann_whitney_p=mann.get(arm),
                wilcoxon_p=signed.get(arm),
                wall_s=float(np.median(walls.to_numpy())) if len(walls) else None,
            )
        )
    return rows


def within_budget(frame: polars.DataFrame, config: StudyConfig, arm: str) -> polars.DataFrame:
    """The evaluations of an arm that count, with the simulated seconds `spent` by the end of each."""
    mine = frame.filter((polars.col("arm") == arm) & polars.col("seed").is_in(config.seeds))
    spent = polars.col("simulated_s").cum_sum().over("seed", order_by="evaluation")
    return mine.with_columns(spent=spent).filter(polars.col("spent") <= config.budget_s)


def _gains(config: StudyConfig, runs: dict[str, list[Course]]) -> list[Gain]:
    """Only arms of the reference's optimizer have generations that compare."""
    searches = {a: kind.config for a, kind in config.arms.items() if isinstance(kind, EvolutionArm)}
    same = searches.get(config.reference)
    at = {}
    for arm, found in runs.items():
        mine = searches.get(arm)
        if mine and same and (mine.optimizer, mine.ga) == (same.optimizer, same.ga):
            values = np.array([c.at_generation(config.generation) for c in found])
            if np.isfinite(values).any():
                at[arm] = values[np.isfinite(values)]
    base = at.get(config.reference)
    if base is None or np.median(base) <= 0:
        return []
    rng = np.random.default_rng(_SEED)
    return [
        Gain(
            arm,
            config.generation,
            len(values),
            statistics.bootstrap(
                lambda a, b: float(np.median(a) / np.median(b)) if np.median(b) > 0 else np.inf,
                [(values,), (base,)],
                rng,
            ),
        )
        for arm, values in at.items()
        if arm != config.reference
    ]
