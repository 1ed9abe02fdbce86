"""Figures: convergence, gait, and the preprocessor's densities; into a file, or into a page."""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from caterpillar_env.physics import SMA_STEP_S
from caterpillar_env.robot import Robot
from caterpillar_env.sma import SmaState, advance
from caterpillar_env.task import Failure
from evolution.priors.preprocessor import GenePrior
from evolution.run.history import Generation

_DPI = 120
_WIDTH_IN = 6.0  # narrow, so that its text can be read on a telephone
_COLOURS = ("gray", "red", "purple", "green", "brown", "olive", "pink", "cyan")
#: Of each failure by its name, in all figures.
FAILURE_COLOURS = {
    failure.label: f"tab:{colour}"
    for failure, colour in zip([f for f in Failure if f is not Failure.NONE], _COLOURS, strict=False)
}


def save(figure: Figure, path: Path) -> None:
    """Write a figure; the ending of the file's name says as what."""
    figure.savefig(path, dpi=_DPI)


def inline_svg(figure: Figure, name: str) -> str:
    """A figure as an SVG element of an HTML page, the same for the same figure.

    What is black or white takes the classes' colours of the page (`page.css`), and text its font,
    so that it can be read on any background.

    Args:
        figure: to be drawn.
        name: of the figure, another one for each on a page: their parts' ids must differ.
    """
    drawn = io.StringIO()
    with rc_context({"svg.fonttype": "none", "svg.hashsalt": name}):
        nothing = dict.fromkeys(("Creator", "Date", "Format", "Type"))
        figure.savefig(drawn, format="svg", metadata=nothing, transparent=True)
    text = drawn.getvalue()
    return re.sub(r'<g id="[^"]*">', "<g>", text[text.index("<svg") :])


def convergence(history: Sequence[Generation], title: str) -> Figure:
    """Best and mean fitness, and failures by reason, over the generations."""
    figure = Figure(figsize=(_WIDTH_IN, 5.6), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=[2, 1])
    numbers = [g.number for g in history]
    upper.plot(numbers, [1000 * g.best_m for g in history], marker=".", label="best so far")
    upper.plot(numbers, [1000 * g.mean_m for g in history], marker=".", label="mean of the generation")
    upper.set(ylabel="distance in 30 s (mm)", ylim=(0, None))
    upper.set_title(title, loc="left", fontsize="medium")
    upper.legend()
    upper.grid(alpha=0.3)
    bottom = np.zeros(len(history))
    for reason, colour in FAILURE_COLOURS.items():
        counts = np.array([g.failures[reason] for g in history])
        if counts.any():
            lower.bar(numbers, counts, bottom=bottom, label=reason, color=colour)
            bottom += counts
    lower.set(xlabel="generation", ylabel="failures")
    for axis in (lower.xaxis, lower.yaxis):
        axis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    if bottom.any():
        lower.legend(fontsize="small")
    return figure


def gait(individual: Robot) -> Figure:
    """Power and austenite fraction of each pair or spring over one period, once they repeat."""
    spring, timings = individual.physics.spring, individual.timings
    power = timings.power(SMA_STEP_S)  # (steps, pairs or springs)
    state = SmaState.cold(spring, power.shape[1:])
    for _ in range(10):
        before, state = state, advance(spring, state, power, SMA_STEP_S).state
    step = advance(spring, before, power, SMA_STEP_S)
    names = individual.timed
    seconds = np.arange(1, len(power) + 1) * SMA_STEP_S
    figure = Figure(figsize=(_WIDTH_IN, 0.8 * len(names) + 1), layout="constrained")
    axes = np.atleast_1d(figure.subplots(len(names), 1, sharex=True, sharey=True))
    for index, (axis, name) in enumerate(zip(axes, names, strict=True)):
        drive = power[:, index]
        corners = np.flatnonzero(np.diff(drive, append=np.nan, prepend=np.nan)[1:])
        axis.fill_between(
            np.append(0.0, seconds[corners]), np.append(drive[0], drive[corners]), step="pre",
            alpha=0.25, color="tab:orange", linewidth=0, label="power",
        )  # fmt: skip
        axis.plot(seconds, step.fraction[:, index], color="tab:red", label="austenite fraction")
        axis.set_ylabel(name.replace("_", "\n"), rotation=0, ha="right", va="center", fontsize="small")
        axis.set(ylim=(-0.05, 1.05), xlim=(0, timings.period_s), yticks=[0, 1])
    axes[0].legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=2, fontsize="small", frameon=False)
    alike = len(names) < individual.physics.num_springs
    title = "One gait period" + (" (left and right alike)" if alike else "")
    axes[0].set_title(title, loc="left", fontsize="medium")
    axes[-1].set_xlabel("time in the period (s)")
    return figure


def densities(priors: Sequence[GenePrior]) -> Figure:
    """Each gene's mutation density over its range, in units of the uniform density."""
    columns = 4
    rows = -(-len(priors) // columns)
    figure = Figure(figsize=(3.2 * columns, 1.9 * rows), layout="constrained")
    axes = figure.subplots(rows, columns, sharey=True, squeeze=False).ravel()
    unit = np.linspace(0.0, 1.0, 201)
    for axis in axes[len(priors) :]:
        axis.set_axis_off()
    for axis, prior in zip(axes, priors, strict=False):
        gene = prior.gene
        factor, unit_shown = gene.shown
        density = prior.distribution.density(unit)
        values = factor * (gene.lower + unit * (gene.upper - gene.lower))
        axis.fill_between(values, density, alpha=0.3)
        axis.plot(values, density)
        axis.set(title=gene.title, xlabel=unit_shown, ylim=(0, None))
        axis.title.set_fontsize("small")
    figure.supylabel("density over the uniform's")
    return figure
