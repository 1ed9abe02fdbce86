"""Draws the figures of a study."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.figure import Figure
from matplotlib.ticker import LogLocator

from caterpillar_env.arrays import Array
from evolution.study import statistics
from evolution.study.analysis import Analysis
from evolution.study.times import arrivals
from evolution.study.trends import LARGEST_RATIO

_KILO = 1000.0  # the time axes are in 1000 s
_TIME = "simulated time (1000 s)"
_RATIO = "ratio of expected running times\n(reference to arm)"
_THIN: dict[str, Any] = {"alpha": 0.4, "linewidth": 0.7}  # lines of single runs
FEW_ARMS = 12  #: with more arms, figures over time have neither bands nor lines of single runs
_LONG_LEGEND, _LONG_LABEL = 12, 30  # entries of a legend, and characters of an entry
_BAND: dict[str, Any] = {"alpha": 0.12, "linewidth": 0}  # quartiles


def draw_best(analysis: Analysis) -> Figure:
    """Draw the best distance so far over simulated time: every run, medians and quartiles."""
    figure, axis = _new_figure("best distance so far (mm)")
    time = analysis.grid_s / _KILO
    for arm, colour in _colours(analysis).items():
        runs = analysis.runs[arm]
        steps_mm = 1000 * np.array([run.best_at_times(analysis.grid_s) for run in runs])
        low, median, high = np.quantile(steps_mm, [0.25, 0.5, 0.75], axis=0)
        if _has_few_arms(analysis):
            axis.step(time, steps_mm.T, where="post", color=colour, **_THIN)
            axis.fill_between(time, low, high, step="post", color=colour, **_BAND)
        axis.step(time, median, where="post", color=colour, linewidth=2, label=f"{arm} ({len(runs)})")
    for level_m in {row.threshold_m for rows in analysis.times.values() for row in rows}:
        axis.axhline(1000 * level_m, color="black", linewidth=0.6, linestyle=":")
    axis.set(xlim=(0, None), ylim=(0, None))
    _add_legend(figure)
    return figure


def draw_generations(analysis: Analysis) -> Figure | None:
    """Draw the best distance over generations, or return None if no comparable arm completed any.

    Medians and quartiles end with the shortest run of an arm.
    """
    arms = [arm for arm in analysis.config.comparable() if arm in analysis.runs]
    figure, axis = _new_figure("best distance so far (mm)")
    axis.set_xlabel("generations")
    colours = _colours(analysis)
    for arm in arms:
        runs, colour = analysis.runs[arm], colours[arm]
        fewest, most = (count(run.generations for run in runs) for count in (min, max))
        if most == 0:
            continue
        generations = np.arange(1, most + 1)
        best_mm = 1000 * np.array([[run.best_after(n) for n in generations.tolist()] for run in runs])
        low, median, high = np.quantile(best_mm[:, :fewest], [0.25, 0.5, 0.75], axis=0)
        if _has_few_arms(analysis):
            axis.plot(generations, best_mm.T, color=colour, **_THIN)
            axis.fill_between(generations[:fewest], low, high, color=colour, **_BAND)
        label = f"{arm} ({len(runs)})"
        axis.plot(generations[:fewest], median, color=colour, linewidth=2, label=label)
    if not axis.lines:
        return None
    axis.set(xlim=(0, None), ylim=(0, None))
    _add_legend(figure)
    return figure


def draw_survival(analysis: Analysis) -> Figure | None:
    """Draw Kaplan-Meier curves of the time to each threshold, or None if no threshold is known."""
    known = {
        threshold: {row.arm: row.threshold_m for row in rows if not np.isnan(row.threshold_m)}
        for threshold, rows in analysis.times.items()
    }
    known = {threshold: levels_m for threshold, levels_m in known.items() if levels_m}
    if not known:
        return None
    figure = Figure(figsize=(max(4.2 * len(known), 9), 4.4), layout="constrained")
    axes = np.atleast_1d(figure.subplots(1, len(known), sharey=True))
    for axis, (threshold, levels_m) in zip(axes, known.items(), strict=True):
        for arm, colour in _colours(analysis).items():
            if arm not in levels_m:
                continue
            runs = analysis.runs[arm]
            ends, reached = arrivals(runs, levels_m[arm])
            curve = statistics.kaplan_meier(ends, reached)
            end_s = max(run.budget_s for run in runs)
            time = np.concatenate([[0.0], curve.time, [end_s]]) / _KILO
            share, low, high = (
                np.concatenate([[1.0], values, values[-1:]])
                for values in (curve.share, curve.low, curve.high)
            )
            axis.step(time, share, where="post", color=colour, label=arm)
            if _has_few_arms(analysis):
                axis.fill_between(time, low, high, step="post", color=colour, alpha=0.08)
            censored = ends[~reached] / _KILO
            rows = np.searchsorted(time, censored, side="right") - 1
            axis.plot(censored, share[rows], "|", color=colour, markersize=9)
        title = str(threshold).removeprefix("the ")
        if threshold.fixed_m is None and len(set(levels_m.values())) == 1:
            title += f"\n({1000 * next(iter(levels_m.values())):.0f} mm)"
        axis.set_title(title, fontsize="medium")
        axis.set(xlabel=_TIME, ylim=(-0.02, 1.02))
        axis.grid(alpha=0.3)
    axes[0].set_ylabel("share of runs below the threshold")
    _add_legend(figure)
    return figure


def draw_speed_ups(analysis: Analysis) -> Figure | None:
    """Draw the speed-up of each arm over a range of thresholds, or return None if there is none."""
    if not analysis.speed_ups:
        return None
    figure, axis = _new_figure(_RATIO)
    axis.set_xlabel("distance to reach (mm)")
    colours = _colours(analysis)
    for arm, rows in analysis.speed_ups.items():
        levels_mm = 1000 * np.array([level_m for level_m, _ in rows])
        value, low, high = np.array([estimate for _, estimate in rows]).T
        if _has_few_arms(analysis):
            axis.fill_between(levels_mm, _bound(low), _bound(high), color=colours[arm], **_BAND)
        _plot_ratios(axis, levels_mm, value, colours[arm], label=arm, line="-")
    _finish_ratios(axis)
    _add_legend(figure)
    return figure


def draw_genes(analysis: Analysis) -> Figure | None:
    """Draw the effects of priors over the number of genes, or return None if there are no trends."""
    trends = [trend for trend in analysis.trends if trend.groups == 1]
    if not trends:
        return None
    figure = Figure(figsize=(9, 5), layout="constrained")
    titles = ("ratio of median distances\n(arm to reference)", _RATIO)
    for axis, title, field in zip(
        figure.subplots(1, 2), titles, ("distances", "speed_ups"), strict=True
    ):
        for number, trend in enumerate(trends):
            genes = np.array(trend.genes) * 1.01**number  # so that intervals do not hide each other
            value, low, high = np.array(getattr(trend, field)).T
            colour = colormaps["tab10"](number)
            axis.vlines(genes, _bound(low), _bound(high), color=colour, alpha=0.6)
            _plot_ratios(axis, genes, value, colour, label=trend.name, line=":")
        axis.set(xlabel="number of genes", ylabel=title, xscale="log")
        _label_decades(axis.xaxis)
        _finish_ratios(axis)
    _add_legend(figure)
    return figure


def _bound(ratios: Array) -> Array:
    """Clip ratios to the range of the axis. Undefined ratios stay NaN."""
    bounded: Array = np.clip(ratios, 1 / LARGEST_RATIO, LARGEST_RATIO)
    return bounded


def _plot_ratios(axis: Axes, x: Array, ratios: Array, colour: Any, *, label: str, line: str) -> None:
    """Plot ratios, with triangles for those that are 0 or infinite."""
    inside = np.isfinite(ratios) & (ratios > 0)
    axis.plot(
        x[inside],
        _bound(ratios[inside]),
        linestyle=line,
        marker="o",
        markersize=4,
        color=colour,
        label=label,
    )
    for beyond, marker in ((np.isposinf(ratios), "^"), (ratios == 0, "v")):
        axis.plot(x[beyond], _bound(ratios[beyond]), marker, color=colour, markersize=6)


def _finish_ratios(axis: Axes) -> None:
    axis.axhline(1.0, color="black", linewidth=0.8)
    axis.set_yscale("log")
    _label_decades(axis.yaxis)
    axis.grid(alpha=0.3)


def _label_decades(axis: Axis) -> None:
    """Label a logarithmic axis at 1, 2 and 5 times the powers of ten."""
    axis.set_minor_locator(LogLocator(subs=(2.0, 5.0)))
    axis.set_major_formatter("{x:g}")
    axis.set_minor_formatter("{x:g}")


def draw_targets(analysis: Analysis) -> Figure:
    """Draw the share of (run, target) pairs reached over simulated time."""
    figure, axis = _new_figure("share of (run, target) pairs reached")
    for arm, colour in _colours(analysis).items():
        axis.plot(analysis.grid_s / _KILO, analysis.ecdf[arm], color=colour, label=arm)
    axis.set(xlim=(0, None), ylim=(0, 1))
    _add_legend(figure)
    return figure


def _new_figure(ylabel: str) -> tuple[Figure, Axes]:
    figure = Figure(figsize=(9, 5), layout="constrained")
    axis = figure.subplots()
    axis.set(xlabel=_TIME, ylabel=ylabel)
    axis.grid(alpha=0.3)
    return figure, axis


def _has_few_arms(analysis: Analysis) -> bool:
    return len(analysis.runs) <= FEW_ARMS


def _colours(analysis: Analysis) -> dict[str, Any]:
    """Return the colour of each arm that has runs."""
    count = len(analysis.runs)
    if count > 20:
        return dict(zip(analysis.runs, colormaps["turbo"](np.linspace(0, 1, count)), strict=True))
    palette = colormaps["tab10" if count <= 10 else "tab20"]
    return {arm: palette(number) for number, arm in enumerate(analysis.runs)}


def _add_legend(figure: Figure) -> None:
    """Add a legend of all lines beside the axes or, if it is long, below them."""
    lines = {str(line.get_label()): line for axis in figure.axes for line in axis.lines}
    shown = {label: line for label, line in lines.items() if not label.startswith("_")}
    longest = max(map(len, shown), default=0)
    if len(shown) <= _LONG_LEGEND and longest <= _LONG_LABEL:
        figure.legend(list(shown.values()), list(shown), fontsize="small", loc="outside right upper")
        return
    columns = max(1, int(figure.get_figwidth() / (0.5 + 0.065 * longest)))  # inches per entry
    figure.set_figheight(figure.get_figheight() + 0.2 * -(-len(shown) // columns))
    figure.legend(
        list(shown.values()), list(shown), fontsize="small", loc="outside lower center", ncols=columns
    )
