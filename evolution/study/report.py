"""Writes the figures and the HTML page of a study."""

from __future__ import annotations

from collections.abc import Callable
from importlib.metadata import version
from math import isnan
from pathlib import Path

from caterpillar_env.files import COPY, name_of, write_bytes
from evolution.report.figures import save
from evolution.report.page import data_url, render
from evolution.study import figures
from evolution.study.analysis import (
    Analysis,
    format_acceleration,
    format_estimate,
    format_p,
    summarize,
)
from evolution.study.winners import Retest

_CAPTIONS = {
    "generations": "Best distance over generations, as in Fig. 11 of the paper. Thick lines: medians, "
    "as far as all runs of the arm go; bands: the middle half of the runs (not confidence intervals); "
    "thin lines: all runs.",
    "best-so-far": "Best distance so far. Thick lines: medians; bands: the middle half of the runs (not "
    "confidence intervals); thin lines: all runs; dotted lines: thresholds.",
    "survival": "Share of runs that have not reached a threshold (Kaplan-Meier). Bands: 95 % intervals; "
    "ticks: runs that ended below the threshold.",
    "speed-up": "Ratio of expected running times, reference to arm, by the distance to reach. Above 1, "
    "the arm is faster. Bands: 95 % intervals. The last distance is the upper quartile of the "
    "reference's runs. Triangles: no run of the reference (up) or of the arm (down) reached that "
    "distance. Values below 0.01 or above 100 are drawn there.",
    "genes": "Effects of priors by the number of genes, with 95 % intervals. Above 1, the arm with the "
    "prior is better. An arm and its reference have the same robot. Triangles: the reference (up) or "
    "the arm (down) has no distance, or no run that reached the threshold.",
    "targets": "Share of (run, target) pairs in which the run has reached the target. The 50 targets "
    "are 2 to 100 % of the best distance of any run.",
}


def write(analysis: Analysis, retest: Retest, folder: Path) -> Path:
    """Write `figures/*.png` and `report.html` into a study's folder; return the path of the page."""
    (folder / "figures").mkdir(exist_ok=True)
    shown = []
    if analysis.runs:
        drawn = {
            "generations": figures.draw_generations(analysis),
            "best-so-far": figures.draw_best(analysis),
            "survival": figures.draw_survival(analysis),
            "speed-up": figures.draw_speed_ups(analysis),
            "genes": figures.draw_genes(analysis),
            "targets": figures.draw_targets(analysis),
        }
        for name, figure in drawn.items():
            if figure is not None:
                path = folder / "figures" / f"{name}.png"
                save(figure, path)
                shown.append((name, _CAPTIONS[name], data_url("image/png", path.read_bytes())))
    filters: dict[str, Callable[..., str]] = {
        "mm": lambda metres: "unknown" if isnan(metres) else f"{1000 * metres:.1f}",
        "percent": lambda share: "unknown" if isnan(share) else f"{100 * share:.1f} %",
        "mm_interval": lambda estimate: format_estimate(estimate, "{:.1f}", 1000.0),
        "whole": lambda estimate: format_estimate(estimate, "{:,.0f}"),
        "ratio": format_estimate,
        "acceleration": format_acceleration,
        "p": format_p,
    }
    page = folder / "report.html"
    text = render(
        "study.html", filters, name=name_of(folder), analysis=analysis, config=analysis.config,
        retest=retest, fewest=min(len(analysis.runs.get(arm, [])) for arm in analysis.config.arms),
        sentences=summarize(analysis), figures=shown, few_arms=figures.FEW_ARMS,
        version=version("caterpillar-sma"),
    )  # fmt: skip
    write_bytes(page, text.encode(), COPY)
    return page
