"""Trainings side by side."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.figure import Figure

from baselines.config import TrainConfig, TrainingError
from baselines.records import Record, best_of, evaluations
from caterpillar_env.files import writing
from caterpillar_env.morphology import Morphology


class Summary(NamedTuple):
    """What trainings that differ in the seed alone came to; distances of deterministic policies."""

    name: str
    runs: int
    simulated_s: float  #: median
    untrained_m: float  #: of the first evaluation, before any learning; median
    median_m: float  #: of each training's best policy; 0 where all failed
    least_m: float
    most_m: float


def title(config: TrainConfig) -> str:
    """What a training is, in words."""
    words: list[str] = [config.algorithm, config.mode]
    if config.open_loop:
        words.append("bandit")
    if config.design != "fixed":
        words.append(f"{config.design} co-design")
    elif config.morphology != Morphology():
        words.append("given body")
    if config.randomize:
        words.append("randomised")
    return " ".join(words)


def grouped(records: Mapping[Path, Record]) -> dict[str, list[Path]]:
    """Folders of trainings that differ in the seed alone, by name."""
    groups: list[tuple[TrainConfig, list[Path]]] = []
    for folder, record in records.items():
        for config, folders in groups:
            if config == replace(record.config, seed=config.seed):
                folders.append(folder)
                break
        else:
            groups.append((record.config, [folder]))
    names: dict[str, list[Path]] = {}
    for config, folders in groups:
        name = title(config)
        number = sum(known.split(" #")[0] == name for known in names)
        names[name if not number else f"{name} #{number + 1}"] = folders
    return names


def summary(name: str, folders: Sequence[Path]) -> Summary:
    """The row of a group.

    Raises:
        TrainingError: a training was not evaluated yet.
    """
    best, first, spent = [], [], []
    for folder in folders:
        points = evaluations(folder)
        if not points:
            raise TrainingError(
                f"{folder} holds no evaluation yet: wait for its training, or leave it out"
            )
        top = best_of(points)
        best.append(0.0 if top is None else top.distance_m)
        first.append(points[0].distance_m if points[0].failure == "ok" else 0.0)
        spent.append(points[-1].simulated_s)
    return Summary(
        name, len(folders), float(np.median(spent)), float(np.median(first)),
        float(np.median(best)), float(min(best)), float(max(best)),
    )  # fmt: skip


def draw(groups: Mapping[str, Sequence[Path]], path: Path) -> None:
    """Distance of the deterministic policy over simulated time: every training, failures at 0.

    Raises:
        FileError: the file cannot be written.
    """
    figure = Figure(figsize=(8, 4.6), layout="constrained")
    axis = figure.subplots()
    for number, (name, folders) in enumerate(groups.items()):
        for place, folder in enumerate(folders):
            points = evaluations(folder)
            axis.plot(
                [p.simulated_s / 1000 for p in points],
                [1000 * p.distance_m if p.failure == "ok" else 0.0 for p in points],
                color=f"C{number}", linewidth=1.2, alpha=0.8, label=name if place == 0 else None,
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
