"""Comparison of training runs: groups, summaries and learning curves."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from baselines.history import Training
from caterpillar_env.errors import CaterpillarError
from caterpillar_env.files import writing
from caterpillar_env.task import Failure
from evolution.run.records import Evaluation


class Summary(NamedTuple):
    """Summary of training runs that differ only in the seed. Policies are deterministic."""

    name: str
    runs: int
    simulated_s: float  #: median
    untrained_m: float  #: median distance before training
    median_m: float  #: median distance of each run's best policy, or 0 if there is none
    least_m: float  #: minimum of these distances
    most_m: float  #: maximum of these distances


def group(trainings: Sequence[Training]) -> dict[str, list[Training]]:
    """Group training runs that differ only in the seed. The keys are unique names."""
    groups: dict[str, list[Training]] = {}
    for training in trainings:
        groups.setdefault(repr(replace(training.config, seed=0)), []).append(training)
    named: dict[str, list[Training]] = {}
    for members in groups.values():
        name = members[0].config.title
        number = 1 + sum(known.split(" #")[0] == name for known in named)
        named[name if number == 1 else f"{name} #{number}"] = members
    return named


def summarize(name: str, trainings: Sequence[Training]) -> Summary:
    """Summarize a group of training runs.

    Raises:
        CaterpillarError: a training run has no evaluation yet.
    """
    best_m, untrained_m, spent_s = [], [], []
    for _, history in trainings:
        if not history.evaluations:
            raise CaterpillarError(
                f"{history.folder} has no evaluation yet; wait for the first one, or remove the folder"
            )
        best_m.append(0.0 if history.best is None else history.best.distance_m)
        untrained_m.append(_distance_m(history.evaluations[0]))
        spent_s.append(history.simulated_s)
    return Summary(
        name, len(trainings), float(np.median(spent_s)), float(np.median(untrained_m)),
        float(np.median(best_m)), min(best_m), max(best_m),
    )  # fmt: skip


def draw(groups: Mapping[str, Sequence[Training]], path: Path) -> None:
    """Plot the distance of each deterministic policy over simulated time.

    Raises:
        CaterpillarError: the file cannot be written.
    """
    figure = Figure(figsize=(8, 4.6), layout="constrained")
    axis = figure.subplots()
    for number, (name, trainings) in enumerate(groups.items()):
        for index, (_, history) in enumerate(trainings):
            axis.plot(
                np.cumsum([e.simulated_s for e in history.evaluations]) / 1000,
                [1000 * _distance_m(e) for e in history.evaluations],
                color=f"C{number}", linewidth=1.2, alpha=0.8, label=name if index == 0 else None,
            )  # fmt: skip
    axis.set(
        xlabel="simulated time, training and evaluation (1000 s)",
        ylabel="distance of the deterministic policy (mm)",
    )
    axis.grid(alpha=0.3)
    if groups:
        axis.legend(fontsize="small")
    with writing(path):
        figure.savefig(path, dpi=110)


def _distance_m(evaluation: Evaluation) -> float:
    return evaluation.distance_m if evaluation.failure is Failure.NONE else 0.0
