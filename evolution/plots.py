"""Figures: convergence, gait, and the preprocessor's densities."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from caterpillar_env.model import SMA_STEP_S
from caterpillar_env.sma import SmaState, advance
from evolution.individual import Individual
from evolution.preprocessor import GenePrior
from evolution.run import Generation

_FAILURES = ("diverged", "flipped", "tipped", "jumped", "veered")


def convergence(history: Sequence[Generation], path: Path, title: str) -> None:
    """Best and mean fitness, and failures by reason, over the generations."""
    figure = Figure(figsize=(7, 6), layout="constrained")
    upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=[2, 1])
    numbers = [g.number for g in history]
    upper.plot(numbers, [1000 * g.best_m for g in history], marker=".", label="best so far")
    upper.plot(numbers, [1000 * g.mean_m for g in history], marker=".", label="mean of the generation")
    upper.set(ylabel="distance in 30 s (mm)", title=title, ylim=(0, None))
    upper.legend()
    upper.grid(alpha=0.3)
    bottom = np.zeros(len(history))
    for reason in _FAILURES:
        counts = np.array([g.failures[reason] for g in history])
        if counts.any():
            lower.bar(numbers, counts, bottom=bottom, label=reason)
            bottom += counts
    lower.set(xlabel="generation", ylabel="failures")
    for axis in (lower.xaxis, lower.yaxis):
        axis.set_major_locator(MaxNLocator(integer=True))
    if bottom.any():
        lower.legend(fontsize="small")
    figure.savefig(path, dpi=120)


def gait(individual: Individual, path: Path) -> None:
    """Power and austenite fraction of each pair or spring over one period, once they repeat."""
    spring, timings = individual.physics.spring, individual.timings
    power = timings.power(SMA_STEP_S)  # (steps, pairs or springs)
    state = SmaState.cold(spring, power.shape[1:])
    for _ in range(10):
        before, state = state, advance(spring, state, power, SMA_STEP_S).state
    step = advance(spring, before, power, SMA_STEP_S)
    names = individual.timed
    seconds = np.arange(1, len(power) + 1) * SMA_STEP_S
    figure = Figure(figsize=(8, 1.1 * len(names) + 1), layout="constrained")
    axes = np.atleast_1d(figure.subplots(len(names), 1, sharex=True, sharey=True))
    for index, (axis, name) in enumerate(zip(axes, names, strict=True)):
        axis.fill_between(
            seconds, power[:, index], step="pre", alpha=0.25, color="tab:orange", label="power"
        )
        axis.plot(seconds, step.fraction[:, index], color="tab:red", label="austenite fraction")
        axis.set_ylabel(name.replace("_", "\n"), rotation=0, ha="right", va="center", fontsize="small")
        axis.set(ylim=(-0.05, 1.05), xlim=(0, timings.period_s), yticks=[0, 1])
    axes[0].legend(loc="lower right", bbox_to_anchor=(1, 1), ncols=2, fontsize="small", frameon=False)
    alike = len(names) < individual.physics.num_springs
    title = "One gait period" + (" (left and right spring of a pair alike)" if alike else "")
    axes[0].set_title(title, loc="left", fontsize="medium")
    axes[-1].set_xlabel("time in the period (s)")
    figure.savefig(path, dpi=120)


def densities(priors: Sequence[GenePrior], path: Path) -> None:
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
        factor, shown = (1000.0, f"m{gene.unit}") if gene.unit == "m" else (1.0, gene.unit)
        if gene.unit == "kg":
            factor, shown = 1000.0, "g"
        density = prior.distribution.density(unit)
        values = factor * (gene.lower + unit * (gene.upper - gene.lower))
        axis.fill_between(values, density, alpha=0.3)
        axis.plot(values, density)
        name = gene.name.removesuffix(f"_{gene.unit}").replace("_", " ")
        axis.set(title=name, xlabel=shown, ylim=(0, None))
        axis.title.set_fontsize("small")
    figure.supylabel("density over the uniform's")
    figure.savefig(path, dpi=110)
