"""What a study's runs amount to: tables and sentences, from `study.collect`."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
import polars
from numpy.typing import NDArray

from caterpillar_env.task import label
from evolution import statistics
from evolution.arms import EvolutionArm
from evolution.individual import Robot, write_json
from evolution.statistics import Estimate
from evolution.study import Cell, Course, StudyConfig, courses, is_finished

Array = NDArray[np.float64]
REFERENCE_TIMESTEP_S = 0.00025  #: see docs/physics.md
ARTEFACT_SHARE = 0.1  #: a winner whose distance changes by more at the reference timestep is one
FRICTIONS = (0.6, 0.7, 0.9, 1.0)
MISMATCH_SEEDS = (1001, 1002, 1003, 1004)
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


class Winner(NamedTuple):
    """An arm's best robot, looked at again."""

    arm: str
    seed: int
    recorded_m: float
    reference_m: float  #: at the reference timestep
    failure: str  #: there
    friction_m: tuple[float, float]  #: least and greatest over other frictions; a failure counts as 0
    mismatch_m: tuple[float, float] | None  #: likewise over other draws of the springs' strengths
    timestep_s: float  #: that it was evolved at
    friction: float  #: likewise

    @property
    def artefact(self) -> bool:
        """Whether it does not hold at the reference timestep."""
        change = abs(self.reference_m - self.recorded_m)
        return self.failure != "ok" or change > ARTEFACT_SHARE * self.recorded_m


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


def winners(config: StudyConfig, folder: Path) -> list[Winner]:
    """Each arm's best robot, simulated anew at the reference timestep and as slightly other robots.

    The robots are kept as `winners/ARM.json`, the results as `winners/winners.json`; what is known of
    a robot is not computed again.
    """
    kept = folder / "winners"
    file = kept / "winners.json"
    known = json.loads(file.read_text(encoding="utf-8")) if file.exists() else {}
    found = []
    for arm in config.arms:
        best = [_best(config, Cell(arm, seed), folder) for seed in config.seeds]
        robots = [robot for robot in best if robot is not None]
        if not robots:
            if arm in known:  # the runs themselves are not there
                found.append(_winner(known[arm]))
            continue
        seed, robot = max(robots, key=lambda pair: pair[1].fitness_m or 0.0)
        if arm not in known or known[arm]["recorded_m"] != robot.fitness_m:
            kept.mkdir(exist_ok=True)
            robot.save(kept / f"{arm}.json")
            known[arm] = _look_again(arm, seed, robot)._asdict()
            write_json(file, known)
        found.append(_winner(known[arm]))
    return found


def _best(config: StudyConfig, cell: Cell, folder: Path) -> tuple[int, Robot] | None:
    """A finished run's seed and best robot within the budget, if one crawled forwards."""
    if not is_finished(config, cell, folder):
        return None
    robot = config.arms[cell.arm].best(cell.folder(folder), config.budget_s)
    return None if robot is None else (cell.seed, robot)


def _winner(data: dict[str, Any]) -> Winner:
    low_high = {name: data[name] and tuple(data[name]) for name in ("friction_m", "mismatch_m")}
    return Winner(**{**data, **low_high})


def _look_again(arm: str, seed: int, robot: Robot) -> Winner:
    fine = robot.simulate(REFERENCE_TIMESTEP_S)
    drawn = robot.physics.spring_strengths is None and robot.physics.mismatch_std > 0

    def swing(name: str, values: Sequence[float]) -> tuple[float, float]:
        others = [
            replace(cast(Any, robot), physics=replace(robot.physics, **{name: value})).simulate()  # type: ignore[arg-type]
            for value in values
        ]
        distances = [float(o.fitness()[0]) for o in others]
        return min(distances), max(distances)

    return Winner(
        arm=arm,
        seed=seed,
        recorded_m=robot.fitness_m or 0.0,
        reference_m=float(fine.distance_m[0]),
        failure=label(fine.failure[0]),
        friction_m=swing("friction", FRICTIONS),
        # Measured or equal springs are not drawn.
        mismatch_m=swing("mismatch_seed", MISMATCH_SEEDS) if drawn else None,
        timestep_s=robot.physics.timestep_s,
        friction=robot.physics.friction,
    )


def headline(analysis: Analysis) -> list[str]:
    """The study's answers in words and numbers."""
    config, said = analysis.config, []
    if analysis.missing:
        shown = ", ".join(f"{c.arm} seed {c.seed}" for c in analysis.missing[:6])
        more = "" if len(analysis.missing) <= 6 else f" and {len(analysis.missing) - 6} more"
        said.append(
            f"UNFINISHED: {len(analysis.missing)} of {len(config.cells())} runs are missing "
            f"({shown}{more}); what follows is of the others."
        )
    if analysis.thresholds_m is None:
        said.append("The thresholds are not frozen yet: the pilot seeds are not through.")
    elif not analysis.thresholds_m:
        said.append("Most pilot runs of the reference never crawled forwards: there is nothing to time.")
    else:
        said += _races(analysis, analysis.thresholds_m[-1])
    reference = next((row for row in analysis.finals if row.arm == config.reference), None)
    for row in analysis.finals:
        if row.a12 is not None and reference is not None:
            chance = f"{row.a12.value:.2f} ({row.a12.low:.2f} to {row.a12.high:.2f})"
            said.append(
                f"{_role(config, row.arm)} ends at a median of {_mm(row.median_m)} against "
                f"{_mm(reference.median_m)}; A12 {chance}, Mann-Whitney p {_p(row.mann_whitney_p)}."
            )
    for gain in analysis.gains:
        percent = [100 * (value - 1) for value in gain.ratio]
        said.append(
            f"{_role(config, gain.arm)} has {percent[0]:+.0f} % of distance at generation "
            f"{gain.generation} ({percent[1]:+.0f} to {percent[2]:+.0f} %; {gain.runs} runs)."
        )
    return said


def _races(analysis: Analysis, threshold_m: float) -> list[str]:
    """Who reaches a threshold how soon."""
    config, said = analysis.config, []
    rows = analysis.times[threshold_m]
    for row in rows:
        count = f"{row.reached} of {row.runs} runs reach {_mm(threshold_m)}"
        if row.arm == config.reference:
            said.append(
                f"The reference, {row.arm}: {count} within {config.budget_s:,.0f} simulated seconds."
            )
        elif row.speed_up is not None:
            said.append(
                f"{_role(config, row.arm)}: {count}, {_times_faster(row.speed_up)}; log-rank p "
                f"{_p(row.log_rank_p)}."
            )
    quick = min(rows, key=lambda row: row.running_time_s.value, default=None)
    if quick is not None and np.isfinite(quick.running_time_s.value):
        said.append(
            f"Least simulated time to {_mm(threshold_m)}: {quick.arm}, "
            f"{quick.running_time_s.value:,.0f} s a success."
        )
    return said


def _role(config: StudyConfig, arm: str) -> str:
    """What an arm is there for, with its name."""
    role = config.arms[arm].role
    return arm if role is None else f"{role} ({arm})"


def _times_faster(ratio: Estimate) -> str:
    if np.isnan(ratio.value):
        return "nobody of either arm gets there"
    if ratio.value == 0:
        return "as against the reference, which does get there"
    if np.isinf(ratio.value):
        return "and the reference never does"
    return f"{ratio.value:.2f} times as fast ({ratio.low:.2f} to {ratio.high:.2f})"


def _mm(metres: float) -> str:
    return f"{1000 * metres:.0f} mm"


def _p(value: float | None) -> str:
    return "" if value is None else f"{value:.2g}"
