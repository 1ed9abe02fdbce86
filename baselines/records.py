"""What is kept of a training beside its policies."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

from baselines.config import TrainConfig, TrainingError
from caterpillar_env.files import read, write_json
from caterpillar_env.morphology import NAMES, Morphology

RECORD = "training.json"
EVALUATIONS = "evaluations.csv"
TENSORBOARD = "tensorboard"


class Point(NamedTuple):
    """One evaluation of the deterministic policy."""

    simulated_s: float  #: spent so far, training and evaluation
    distance_m: float
    energy_j: float
    time_s: float  #: how long the robot went on
    failure: str
    morphology: Morphology  #: of the robot


def append(folder: Path, point: Point) -> None:
    """Add an evaluation to a training's table."""
    row = point._asdict() | point.morphology.to_dict()
    del row["morphology"]
    path = folder / EVALUATIONS
    new = not path.exists()
    with path.open("a", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, row)
        if new:
            writer.writeheader()
        writer.writerow(row)


def evaluations(folder: Path) -> list[Point]:
    """The evaluations of a training so far."""
    try:
        with (folder / EVALUATIONS).open(encoding="utf-8") as file:
            rows = list(csv.DictReader(file))
    except OSError:
        return []
    points = []
    for row in rows:
        if None in row.values():
            break  # it is being written
        points.append(
            Point(
                simulated_s=float(row["simulated_s"]),
                distance_m=float(row["distance_m"]),
                energy_j=float(row["energy_j"]),
                time_s=float(row["time_s"]),
                failure=row["failure"],
                morphology=Morphology.of({name: float(row[name]) for name in NAMES}),
            )
        )
    return points


def best_of(points: Sequence[Point]) -> Point | None:
    """The evaluation whose robot got farthest without failing, if there is one."""
    able = [point for point in points if point.failure == "ok"]
    return max(able, key=lambda point: point.distance_m, default=None)


class Record(NamedTuple):
    """What is kept of a training beside its evaluations and policies."""

    config: TrainConfig
    hyperparameters: dict[str, Any]  #: as plain data
    versions: dict[str, str]
    finished: bool
    wall_s: float | None  #: None while it runs, and if it was killed
    simulated_s: float

    def save(self, folder: Path) -> None:
        """Write it into a training's folder."""
        write_json(folder / RECORD, self._asdict() | {"config": self.config.to_dict()})

    @classmethod
    def load(cls, folder: Path) -> Record:
        """Read it.

        Raises:
            TrainingError: the folder holds no training, or one that cannot be read.
        """

        def made(data: dict[str, Any]) -> Record:
            try:
                return cls(**{**data, "config": TrainConfig.from_dict(data["config"])})
            except (TypeError, KeyError) as error:
                raise TrainingError(
                    f"no record of a training: it lacks or has too much of {error}"
                ) from None

        return read(folder / RECORD, made, TrainingError, "give a folder that caterpillar rl train made")
