"""Figures of a run: convergence, gait, and the densities of the priors."""

from __future__ import annotations

import io
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from caterpillar_env.files import COPY, write_bytes, writing
from caterpillar_env.physics import SMA_STEP_S
from caterpillar_env.robot import Robot
from caterpillar_env.sma import settle
from evolution.priors.preprocessor import GenePrior, Search
from evolution.run.history import Generation

_DPI = 120
_WIDTH_IN = 6.0  # readable on a phone


def save(figure: Figure, path: Path, advice: str = COPY) -> None:
    """Write a figure in the format of the file's suffix.

    Raises:
        CaterpillarError: the format is unknown, or the file cannot be written; the message ends with
            `advice`.
    """
    content = io.BytesIO()
    with writing(path, advice):
        figure.savefig(content, format=path.suffix.removeprefix(".") or None, dpi=_DPI)
    write_bytes(path, content.getvalue(), advice)


def inline_svg(figure: Figure, name: str) -> str:
    """Return a figure as an SVG element for an HTML page.

    The output is deterministic. The style sheet of the page replaces black, white and the font, so that
    the figure is readable on a dark background too.

    Args:
        figure: the figure.
        name: name of the figure, unique on its page. Element ids are derived from it.
    """
    svg = io.StringIO()
    with rc_context({"svg.fonttype": "none", "svg.hashsalt": name}):
        no_metadata = dict.fromkeys(("Creator", "Date", "Format", "Type"))
        figure.savefig(svg, format="svg", metadata=no_metadata, transparent=True)
    text = svg.getvalue()
    return re.sub(r'<g id="[^"]*">', "<g>", text[text.index("<svg") :])


def convergence(generations: Sequence[Generation], title: str) -> Figure:
    """Plot best and mean fitness, and failures by reason, over the generations."""
    figure = Figure(figsize=(_WIDTH_IN, 5.6), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=[2, 1])
    numbers = [g.number for g in generations]
    upper.plot(numbers, [1000 * g.best_m for g in generations], marker=".", label="best so far")
    mean = "mean of the generation"
    if any(g.stopped for g in generations):
        mean += ", without stopped robots"
    upper.plot(numbers, [1000 * g.mean_m for g in generations], marker=".", label=mean)
    upper.set(ylabel="distance in 30 s (mm)", ylim=(0, None))
    upper.set_title(title, loc="left", fontsize="medium", parse_math=False)
    upper.legend(loc="upper left")
    upper.grid(alpha=0.3)
    bottom = np.zeros(len(generations))
    for index, reason in enumerate(generations[0].failures):
        counts = np.array([g.failures[reason] for g in generations])
        if counts.any():
            lower.bar(numbers, counts, bottom=bottom, label=reason, color=f"C{index}")
            bottom += counts
    lower.set(xlabel="generation", ylabel="failures")
    for axis in (lower.xaxis, lower.yaxis):
        axis.set_major_locator(MaxNLocator(integer=True, min_n_ticks=1))
    if bottom.any():
        lower.legend(fontsize="small", loc="upper right")
    return figure


def gait(robot: Robot) -> Figure:
    """Plot power and austenite fraction of each pair or spring over a period of the limit cycle."""
    spring, timings = robot.physics.spring, robot.timings
    power = timings.power(SMA_STEP_S)  # (steps, pairs or springs)
    fraction = settle(spring, power, SMA_STEP_S).path.fraction
    names = robot.timed
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
        axis.plot(seconds, fraction[:, index], color="tab:red", label="austenite fraction")
        axis.set_ylabel(name.replace("_", "\n"), rotation=0, ha="right", va="center", fontsize="small")
        axis.set(ylim=(-0.05, 1.05), xlim=(0, timings.period_s), yticks=[0, 1])
    axes[0].legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=2, fontsize="small", frameon=False)
    mirrored = len(names) < robot.physics.num_springs
    title = "One gait period" + (" (left = right)" if mirrored else "")
    axes[0].set_title(title, loc="left", fontsize="medium")
    axes[-1].set_xlabel("time in the period (s)")
    return figure


def gait_search(found: Sequence[Search]) -> Figure:
    """Plot stroke over duty, and advance over lag and offset at the best duty. Dots: best nodes."""
    stroke, advance = (s for s in found if s.parameter.name in ("stroke", "advance"))
    figure = Figure(figsize=(2 * _WIDTH_IN, 4.2), layout="constrained")
    left, right = figure.subplots(1, 2)
    (duty,) = stroke.nodes
    left.plot(100 * duty, stroke.values, marker=".")
    left.plot(100 * duty[stroke.best], stroke.values[stroke.best], "o", color="tab:red")
    left.set(xlabel="duty (% of the period)", ylabel="stroke (swing of the austenite fraction)")
    left.set_title("K_4, stroke", loc="left", fontsize="medium")
    left.grid(alpha=0.3)
    lag, offset, duty = advance.nodes
    best_lag, best_offset, best_duty = advance.best
    values = 1000 * advance.values[:, :, best_duty].T
    top = np.abs(values).max()
    image = right.pcolormesh(100 * lag, 100 * offset, values, cmap="RdBu", vmin=-top, vmax=top)
    right.plot(100 * lag[best_lag], 100 * offset[best_offset], "o", color="black")
    right.set(
        xlabel="lag of a gap after the gap ahead (% of the period)",
        ylabel="offset of ventral after dorsal pairs (%)",
    )
    title = f"K_5, advance at a duty of {100 * duty[best_duty]:.0f} %"
    right.set_title(title, loc="left", fontsize="medium")
    figure.colorbar(image, ax=right, label="mm per period")
    return figure


def densities(priors: Sequence[GenePrior]) -> Figure:
    """Plot the mutation density of each gene over its range, relative to the uniform density."""
    columns = 4
    rows = -(-len(priors) // columns)
    figure = Figure(figsize=(3.2 * columns, 1.9 * rows), layout="constrained")
    axes = figure.subplots(rows, columns, sharey=True, squeeze=False).ravel()
    shares = np.linspace(0.0, 1.0, 201)
    for axis in axes[len(priors) :]:
        axis.set_axis_off()
    for axis, prior in zip(axes, priors, strict=False):
        gene = prior.gene
        factor, unit = gene.shown
        density = prior.distribution.density(shares)
        values = factor * gene.value(shares)
        axis.fill_between(values, density, alpha=0.3)
        axis.plot(values, density)
        axis.set(title=gene.title, xlabel=unit, ylim=(0, None))
        axis.title.set_fontsize("small")
    figure.supylabel("density relative to uniform")
    return figure
