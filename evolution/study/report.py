"""Draws the figures of a study, and writes its HTML page."""

from __future__ import annotations

from collections.abc import Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import polars
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from caterpillar_env.morphology import NAMES
from evolution.priors.preprocessor import paper_priors
from evolution.report.figures import FAILURE_COLOURS
from evolution.report.page import data_url, render
from evolution.study import statistics
from evolution.study.analysis import Analysis, arrivals, format_estimate, format_p, summarize
from evolution.study.arms import EvolutionArm
from evolution.study.winners import Winner

_KILO = 1000.0  # the time axes are in 1000 s
_TIME = "simulated time (1000 s)"
_TENTHS = 10

_CAPTIONS = {
    "best-so-far": "Best distance so far. Thick lines: medians; bands: quartiles; thin lines: all runs; "
    "dotted lines: thresholds.",
    "survival": "Share of runs that have not reached a threshold (Kaplan-Meier, 95 % intervals). Runs "
    "that never reach it are censored at the budget.",
    "targets": "Share of 50 target distances reached, over all runs.",
    "failures": "Share of evaluations that failed, in tenths of the budget.",
    "genes": "Body parameters of all genomes evaluated in a generation: medians and quartiles.",
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


def draw_failures(analysis: Analysis) -> Figure:
    """Draw the share of evaluations that failed, by failure, for each tenth of the budget."""
    columns = min(3, len(analysis.runs))
    rows = -(-len(analysis.runs) // columns)
    figure = Figure(figsize=(3.4 * columns, 2.4 * rows + 0.4), layout="constrained")
    axes = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
    edges_s = np.linspace(0.0, analysis.config.budget_s, _TENTHS + 1)
    for axis, (arm, runs) in zip(axes, analysis.runs.items(), strict=False):
        spent_s = np.concatenate([run.spent_s for run in runs])
        tenth = np.maximum(np.searchsorted(edges_s, spent_s) - 1, 0)
        failure = np.concatenate([run.failure for run in runs])
        total = np.maximum(np.bincount(tenth, minlength=_TENTHS), 1)
        bottom = np.zeros(_TENTHS)
        for name, colour in FAILURE_COLOURS.items():
            share = np.bincount(tenth[failure == name], minlength=_TENTHS) / total
            axis.bar(
                edges_s[:-1] / _KILO, share, np.diff(edges_s) / _KILO, bottom, align="edge", label=name,
                color=colour,
            )  # fmt: skip
            bottom += share
        axis.set(ylim=(0, 1))
        axis.set_title(arm, fontsize="small")
    for axis in axes[len(analysis.runs) :]:
        axis.set_axis_off()
    axes[0].legend(fontsize="x-small")
    figure.supxlabel(_TIME, fontsize="small")
    figure.supylabel("share of evaluations that failed", fontsize="small")
    return figure


def draw_genes(analysis: Analysis, table: polars.DataFrame) -> Figure | None:
    """Draw body parameters over the generations of the genetic algorithm, and the priors' peaks.

    Returns None if no arm is a genetic algorithm with the same body for all segments.
    """
    config = analysis.config
    searches = {a: kind.config for a, kind in config.arms.items() if isinstance(kind, EvolutionArm)}
    ga = {a: run for a, run in searches.items() if (run.optimizer, run.genome) == ("ga", "shared")}
    colours = {arm: colour for arm, colour in _colours(analysis).items() if arm in ga}
    if not colours:
        return None
    encoding = ga[next(iter(colours))].encoding
    rows = table.filter(polars.col("seed").is_in(config.seeds))
    figure = Figure(figsize=(12, 5.4), layout="constrained")
    axes = figure.subplots(2, 4, sharex=True).ravel()
    genes = zip(axes, encoding.genes[: len(NAMES)], paper_priors(encoding)[: len(NAMES)], strict=True)
    for axis, gene, prior in genes:
        factor, unit = gene.shown
        value = factor * polars.col(gene.name)
        for arm, colour in colours.items():
            lines = rows.filter(polars.col("arm") == arm).group_by("generation").agg(
                value.quantile(0.25).alias("low"), value.median().alias("median"),
                value.quantile(0.75).alias("high"),
            ).sort("generation")  # fmt: skip
            axis.plot(lines["generation"], lines["median"], color=colour, label=arm)
            axis.fill_between(lines["generation"], lines["low"], lines["high"], color=colour, alpha=0.1)
        if (peak := prior.to_dict()["mu"]) is not None:
            axis.axhline(factor * float(peak), color="black", linestyle=":", linewidth=0.8)
        margin = 0.04 * (gene.upper - gene.lower)
        axis.set_ylim(factor * (gene.lower - margin), factor * (gene.upper + margin))
        axis.set_title(f"{gene.title} ({unit})", fontsize="small")
    axes[0].legend(fontsize="x-small")
    figure.supxlabel("generation (dotted: peak of the preprocessor's distribution)", fontsize="small")
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
    crowded = len(axis.get_legend_handles_labels()[1]) > 8
    outside: dict[str, Any] = {"loc": "upper left", "bbox_to_anchor": (1.0, 1.0)} if crowded else {}
    axis.legend(fontsize="small", **outside)


def write(analysis: Analysis, table: polars.DataFrame, winners: Sequence[Winner], folder: Path) -> Path:
    """Write `figures/*.png` and `report.html` into a study's folder; return the path of the page."""
    (folder / "figures").mkdir(exist_ok=True)
    figures = []
    if analysis.runs:
        drawn = {
            "best-so-far": draw_best(analysis),
            "survival": draw_survival(analysis),
            "targets": draw_targets(analysis),
            "failures": draw_failures(analysis),
            "genes": draw_genes(analysis, table),
        }
        for name, figure in drawn.items():
            if figure is not None:
                path = folder / "figures" / f"{name}.png"
                figure.savefig(path, dpi=110)
                figures.append((name, _CAPTIONS[name], data_url("image/png", path.read_bytes())))
    filters = {
        "mm": lambda metres: f"{1000 * metres:.1f}",
        "mm_interval": lambda estimate: format_estimate(estimate, "{:.1f}", 1000.0),
        "seconds": lambda estimate: format_estimate(estimate, "{:,.0f}"),
        "ratio": format_estimate,
        "p": format_p,
    }
    page = folder / "report.html"
    text = render(
        "study.html", filters, name=folder.resolve().name, analysis=analysis, config=analysis.config,
        winners=winners, sentences=summarize(analysis), figures=figures,
        version=version("caterpillar-sma"),
    )  # fmt: skip
    page.write_text(text, encoding="utf-8")
    return page
