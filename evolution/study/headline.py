"""A study's answers in sentences."""

from __future__ import annotations

import numpy as np

from evolution.study.analysis import Analysis
from evolution.study.config import StudyConfig
from evolution.study.statistics import Estimate


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
