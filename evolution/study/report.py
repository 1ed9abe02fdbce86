"""A study's figures, and one page that holds them all."""

from __future__ import annotations

import io
from collections.abc import Callable, Sequence
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np
import polars
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from caterpillar_env.morphology import NAMES
from evolution.config import RunConfig
from evolution.priors.preprocessor import paper_priors
from evolution.report.figures import FAILURE_COLOURS
from evolution.report.page import data_url, render
from evolution.study import statistics
from evolution.study.analysis import Analysis, arrival, within_budget
from evolution.study.arms import EvolutionArm
from evolution.study.headline import headline
from evolution.study.statistics import Estimate
from evolution.study.winners import Winner

_KILO = 1000.0  # simulated seconds on the axes


def courses(analysis: Analysis) -> Figure:
    """Best distance so far over simulated time: medians, middle halves, and every run."""
    figure = Figure(figsize=(9, 5), layout="constrained")
    axis = figure.subplots()
    grid = analysis.grid_s
    for number, (arm, found) in enumerate(analysis.courses.items()):
        colour = _colour(number, len(analysis.courses))
        steps = np.array([_at(c.spent_s, c.best_m, grid) for c in found])
        for row in steps:
            axis.plot(grid / _KILO, 1000 * row, color=colour, alpha=0.25, linewidth=0.7)
        low, middle, high = np.quantile(steps, [0.25, 0.5, 0.75], axis=0)
        axis.fill_between(grid / _KILO, 1000 * low, 1000 * high, color=colour, alpha=0.12)
        axis.plot(grid / _KILO, 1000 * middle, color=colour, linewidth=2, label=f"{arm} ({len(found)})")
    for threshold in analysis.thresholds_m or []:
        axis.axhline(1000 * threshold, color="black", linewidth=0.6, linestyle=":")
    axis.set(
        xlabel="simulated time (1000 s)", ylabel="best distance so far (mm)", xlim=(0, None),
        ylim=(0, None),
    )  # fmt: skip
    _legend(axis)
    return figure


def _at(time: Any, value: Any, grid: Any) -> Any:
    """A step function at the times of a grid, 0 before its first step."""
    place = np.searchsorted(time, grid, side="right")
    return np.concatenate([[0.0], value])[place]


def survival(analysis: Analysis) -> Figure | None:
    """Kaplan-Meier's curves of the time to each threshold, with their intervals."""
    levels = analysis.thresholds_m or []
    if not levels:
        return None
    figure = Figure(figsize=(4.2 * len(levels), 4.4), layout="constrained")
    axes = np.atleast_1d(figure.subplots(1, len(levels), sharey=True))
    budget_s = analysis.config.budget_s
    for axis, threshold in zip(axes, levels, strict=True):
        for number, (arm, found) in enumerate(analysis.courses.items()):
            curve = statistics.kaplan_meier(*arrival(found, threshold, budget_s))
            times = np.concatenate([[0.0], curve.time, [budget_s]]) / _KILO

            def ends(values: Any) -> Any:
                return np.concatenate([[1.0], values, values[-1:]])

            axis.step(
                times,
                ends(curve.share),
                where="post",
                color=_colour(number, len(analysis.courses)),
                label=arm,
            )
            axis.fill_between(
                times,
                ends(curve.low),
                ends(curve.high),
                step="post",
                color=_colour(number, len(analysis.courses)),
                alpha=0.08,
            )
        axis.set(
            title=f"{1000 * threshold:.0f} mm", xlabel="simulated time (1000 s)", ylim=(-0.02, 1.02)
        )
        axis.grid(alpha=0.3)
    axes[0].set_ylabel("share of runs still under way")
    _legend(axes[-1])
    return figure


def targets(analysis: Analysis) -> Figure:
    """Share of (run, target) pairs reached over simulated time."""
    figure = Figure(figsize=(9, 4.4), layout="constrained")
    axis = figure.subplots()
    for number, (arm, share) in enumerate(analysis.ecdf.items()):
        axis.plot(
            analysis.grid_s / _KILO, share, color=_colour(number, len(analysis.courses)), label=arm
        )
    axis.set(
        xlabel="simulated time (1000 s)", ylabel="share of (run, target) pairs reached", xlim=(0, None),
        ylim=(0, 1),
    )  # fmt: skip
    _legend(axis)
    return figure


def failures(analysis: Analysis, frame: polars.DataFrame) -> Figure:
    """Why evaluations failed, over the course of the budget."""
    arms = list(analysis.courses)
    columns = min(3, len(arms))
    rows = -(-len(arms) // columns)
    figure = Figure(figsize=(3.4 * columns, 2.4 * rows + 0.4), layout="constrained")
    axes = figure.subplots(rows, columns, sharex=True, sharey=True, squeeze=False).ravel()
    edges = np.linspace(0.0, analysis.config.budget_s, 11)
    for axis in axes[len(arms) :]:
        axis.set_axis_off()
    for axis, arm in zip(axes, arms, strict=False):
        mine = within_budget(frame, analysis.config, arm)
        part = np.searchsorted(edges, mine["spent"].to_numpy(), side="left") - 1
        status = mine["failure"].to_numpy()
        number = np.array([np.count_nonzero(part == k) for k in range(10)])
        bottom = np.zeros(10)
        for reason, colour in FAILURE_COLOURS.items():
            share = np.array([np.count_nonzero((part == k) & (status == reason)) for k in range(10)])
            share = share / np.maximum(number, 1)
            axis.bar(
                edges[:-1] / _KILO, share, np.diff(edges) / _KILO, bottom, align="edge", label=reason,
                color=colour,
            )  # fmt: skip
            bottom += share
        axis.set(title=arm, ylim=(0, 1))
        axis.title.set_fontsize("small")
    axes[0].legend(fontsize="x-small")
    figure.supxlabel("simulated time (1000 s)", fontsize="small")
    figure.supylabel("share of evaluations that failed", fontsize="small")
    return figure


def gene_courses(analysis: Analysis, frame: polars.DataFrame) -> Figure | None:
    """Morphology genes over the generations in arms of the genetic algorithm, and the priors' peaks."""
    config = analysis.config
    searches = {a: k.config for a, k in config.arms.items() if isinstance(k, EvolutionArm)}
    arms = [
        arm
        for arm, run in searches.items()
        if arm in analysis.courses and (run.optimizer, run.genome) == ("ga", "shared")
    ]
    if not arms:
        return None
    table = searches[arms[0]].encoding.genes[: len(NAMES)]
    informed = _peaks(searches[arms[0]])
    figure = Figure(figsize=(12, 5.4), layout="constrained")
    axes = figure.subplots(2, 4, sharex=True).ravel()
    for axis, gene, peak in zip(axes, table, informed, strict=True):
        for arm in arms:
            mine = frame.filter((polars.col("arm") == arm) & polars.col("seed").is_in(config.seeds))
            over = (
                mine.group_by("generation")
                .agg(
                    polars.col(gene.name).quantile(0.25).alias("low"),
                    polars.col(gene.name).median().alias("middle"),
                    polars.col(gene.name).quantile(0.75).alias("high"),
                )
                .sort("generation")
            )
            colour = _colour(list(analysis.courses).index(arm), len(analysis.courses))
            axis.plot(over["generation"], over["middle"], color=colour, label=arm)
            axis.fill_between(over["generation"], over["low"], over["high"], color=colour, alpha=0.1)
        if peak is not None:
            axis.axhline(peak, color="black", linestyle=":", linewidth=0.8)
        margin = 0.04 * (gene.upper - gene.lower)
        axis.set(title=gene.name, ylim=(gene.lower - margin, gene.upper + margin))
        axis.title.set_fontsize("small")
    axes[0].legend(fontsize="x-small")
    figure.supxlabel("generation (dotted: peak of the preprocessor's distribution)", fontsize="small")
    return figure


def _peaks(config: RunConfig) -> list[float | None]:
    """Where the preprocessor puts the peak of each morphology gene, SI; None where it says nothing."""
    rows = paper_priors(config.encoding)[: len(NAMES)]
    return [None if (mu := row.to_dict()["mu"]) is None else float(mu) for row in rows]


def _colour(number: int, arms: int) -> Any:
    """One for each arm: the usual ten, or twice as many where that is not enough."""
    return colormaps["tab10" if arms <= 10 else "tab20"](number % 20)


def _legend(axis: Axes) -> None:
    axis.grid(alpha=0.3)
    crowded = len(axis.get_legend_handles_labels()[1]) > 8
    beside: dict[str, Any] = {"loc": "upper left", "bbox_to_anchor": (1.0, 1.0)} if crowded else {}
    axis.legend(fontsize="small", **beside)


def write(analysis: Analysis, frame: polars.DataFrame, winners: Sequence[Winner], folder: Path) -> Path:
    """Write `figures/*.png` and `report.html` into a study's folder; the page's path."""
    drawers: dict[str, tuple[str, Callable[[], Figure | None]]] = {
        "best-so-far": (
            "Best distance so far. Thick: median; band: middle half; thin: every run; dotted: the "
            "thresholds.",
            lambda: courses(analysis),
        ),
        "survival": (
            "Runs that have not reached a threshold yet (Kaplan-Meier, 95 % intervals). "
            "Runs that never do are censored at the budget, not dropped.",
            lambda: survival(analysis),
        ),
        "targets": ("Share of 50 targets reached, over all runs.", lambda: targets(analysis)),
        "failures": ("Failures by reason, in tenths of the budget.", lambda: failures(analysis, frame)),
        "genes": (
            "Morphology genes of all genomes evaluated in a generation: median and middle half.",
            lambda: gene_courses(analysis, frame),
        ),
    }
    figures = []
    (folder / "figures").mkdir(exist_ok=True)
    for name, (caption, draw) in drawers.items():
        figure = draw() if analysis.courses else None
        if figure is not None:
            picture = io.BytesIO()
            figure.savefig(picture, format="png", dpi=110)
            (folder / "figures" / f"{name}.png").write_bytes(picture.getvalue())
            figures.append((name, caption, data_url("image/png", picture.getvalue())))
    filters: dict[str, Callable[..., str]] = {
        "mm": lambda m: f"{1000 * m:.1f}",
        "seconds": lambda e: _interval(e, lambda s: f"{s:,.0f}"),
        "ratio": lambda e: _interval(e, lambda r: f"{r:.2f}"),
        "p": lambda p: "" if p is None else ("&lt; 0.001" if p < 0.001 else f"{p:.3f}"),
    }
    page = folder / "report.html"
    page.write_text(
        render(
            "study.html", filters, name=folder.resolve().name, analysis=analysis,
            config=analysis.config, winners=winners, sentences=headline(analysis), figures=figures,
            version=version("caterpillar-sma"),
        ),
        encoding="utf-8",
    )  # fmt: skip
    return page


def _interval(estimate: Estimate | None, shown: Callable[[float], str]) -> str:
    if estimate is None:
        return ""
    if np.isnan(estimate.value):
        return "undefined"
    value, low, high = (
        shown(v) if np.isfinite(v) else "∞" for v in (estimate.value, estimate.low, estimate.high)
    )
    if np.isnan(estimate.low):
        return value
    return f"{value} ({low} to {high})"
