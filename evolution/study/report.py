"""Draws the figures of a study, and writes its HTML page."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from caterpillar_env.files import COPY, name_of, write_bytes
from evolution.report.figures import save
from evolution.report.page import data_url, render
from evolution.study import statistics
from evolution.study.analysis import Analysis, arrivals, format_estimate, format_p, summarize
from evolution.study.winners import Comparison, Winner

_KILO = 1000.0  # the time axes are in 1000 s
_TIME = "simulated time (1000 s)"

_CAPTIONS = {
    "best-so-far": "Best distance so far. Thick lines: medians; bands: quartiles; thin lines: all runs; "
    "dotted lines: thresholds.",
    "survival": "Share of runs that have not reached a threshold (Kaplan-Meier, 95 % intervals). Runs "
    "that never reach it are censored at the budget.",
    "targets": "Share of 50 target distances reached, over all runs.",
}


def draw_best(analysis: Analysis) -> Figure:
    """Draw the best distance so far over simulated time: every run, medians and quartiles."""
    figure, axis = _new_figure("best distance so far (mm)")
    time = analysis.grid_s / _KILO
    for arm, colour in _colours(analysis).items():
        runs = analysis.runs[arm]
        steps_mm = np.array(
            [
                np.append(0.0, 1000 * run.best_m)[
                    np.searchsorted(run.spent_s, analysis.grid_s, side="right")
                ]
                for run in runs
            ]
        )
        for row in steps_mm:
            axis.plot(time, row, color=colour, alpha=0.25, linewidth=0.7)
        low, median, high = np.quantile(steps_mm, [0.25, 0.5, 0.75], axis=0)
        axis.fill_between(time, low, high, color=colour, alpha=0.12)
        axis.plot(time, median, color=colour, linewidth=2, label=f"{arm} ({len(runs)})")
    for threshold_m in analysis.thresholds_m or []:
        axis.axhline(1000 * threshold_m, color="black", linewidth=0.6, linestyle=":")
    axis.set(xlim=(0, None), ylim=(0, None))
    _add_legend(axis)
    return figure


def draw_survival(analysis: Analysis) -> Figure | None:
    """Draw Kaplan-Meier curves of the time to each threshold, or return None without thresholds."""
    thresholds_m = analysis.thresholds_m or []
    if not thresholds_m:
        return None
    figure = Figure(figsize=(4.2 * len(thresholds_m), 4.4), layout="constrained")
    axes = np.atleast_1d(figure.subplots(1, len(thresholds_m), sharey=True))
    budget_s = analysis.config.budget_s
    for axis, threshold_m in zip(axes, thresholds_m, strict=True):
        for arm, colour in _colours(analysis).items():
            curve = statistics.kaplan_meier(*arrivals(analysis.runs[arm], threshold_m, budget_s))
            time = np.concatenate([[0.0], curve.time, [budget_s]]) / _KILO
            share, low, high = (
                np.concatenate([[1.0], values, values[-1:]])
                for values in (curve.share, curve.low, curve.high)
            )
            axis.step(time, share, where="post", color=colour, label=arm)
            axis.fill_between(time, low, high, step="post", color=colour, alpha=0.08)
        axis.set(title=f"{1000 * threshold_m:.0f} mm", xlabel=_TIME, ylim=(-0.02, 1.02))
    axes[0].set_ylabel("share of runs below the threshold")
    _add_legend(axes[-1])
    return figure


def draw_targets(analysis: Analysis) -> Figure:
    """Draw the share of (run, target) pairs reached over simulated time."""
    figure, axis = _new_figure("share of (run, target) pairs reached")
    for arm, colour in _colours(analysis).items():
        axis.plot(analysis.grid_s / _KILO, analysis.ecdf[arm], color=colour, label=arm)
    axis.set(xlim=(0, None), ylim=(0, 1))
    _add_legend(axis)
    return figure


def _new_figure(ylabel: str) -> tuple[Figure, Axes]:
    figure = Figure(figsize=(9, 5), layout="constrained")
    axis = figure.subplots()
    axis.set(xlabel=_TIME, ylabel=ylabel)
    return figure, axis


def _colours(analysis: Analysis) -> dict[str, Any]:
    """Return the colour of each arm that has runs."""
    palette = colormaps["tab10" if len(analysis.runs) <= 10 else "tab20"]
    return {arm: palette(number % 20) for number, arm in enumerate(analysis.runs)}


def _add_legend(axis: Axes) -> None:
    axis.grid(alpha=0.3)
    axis.legend(fontsize="small", loc="upper left", bbox_to_anchor=(1.0, 1.0))


def write(
    analysis: Analysis,
    winners: Sequence[Winner],
    folder: Path,
    compared: Sequence[Comparison] = (),
) -> Path:
    """Write `figures/*.png` and `report.html` into a study's folder; return the path of the page."""
    (folder / "figures").mkdir(exist_ok=True)
    figures = []
    if analysis.runs:
        drawn = {
            "best-so-far": draw_best(analysis),
            "survival": draw_survival(analysis),
            "targets": draw_targets(analysis),
        }
        for name, figure in drawn.items():
            if figure is not None:
                path = folder / "figures" / f"{name}.png"
                save(figure, path)
                figures.append((name, _CAPTIONS[name], data_url("image/png", path.read_bytes())))
    filters = {
        "mm": lambda metres: f"{1000 * metres:.1f}",
        "percent": lambda share: f"{100 * share:.1f} %",
        "mm_interval": lambda estimate: format_estimate(estimate, "{:.1f}", 1000.0),
        "seconds": lambda estimate: format_estimate(estimate, "{:,.0f}"),
        "ratio": format_estimate,
        "p": format_p,
    }
    page = folder / "report.html"
    text = render(
        "study.html", filters, name=name_of(folder), analysis=analysis, config=analysis.config,
        winners=winners, compared=compared, sentences=summarize(analysis), figures=figures,
        version=version("caterpillar-sma"),
    )  # fmt: skip
    write_bytes(page, text.encode(), COPY)
    return page
