"""`caterpillar rl compare`."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
import tyro
from rich.table import Table

from baselines.config import Training
from caterpillar_env.errors import CaterpillarError
from evolution import cli


@dataclass(frozen=True)
class CompareArgs:
    """Compare training runs in a table. Runs that differ only in the seed share a row."""

    folders: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Folders of training runs."""
    json: bool = False
    """Print JSON instead of a table."""

    def __post_init__(self) -> None:
        if not self.folders:
            raise CaterpillarError("give at least one folder that caterpillar rl train made")


def compare_command(argv: Sequence[str]) -> int:
    """Compare training runs in a table."""
    args = cli.parse(CompareArgs, argv, "rl compare")
    rows = summarize([Training.read(folder) for folder in args.folders])
    if args.json:
        print(json.dumps(rows, indent=2))
        return 0
    table = Table("training", "seeds", "simulated", "untrained", "median best", "lowest", "highest")
    for name, runs, simulated_s, *distances_m in map(dict.values, rows):
        distances = (f"{1000 * distance_m:.1f} mm" for distance_m in distances_m)
        table.add_row(name, str(runs), f"{simulated_s:,.0f} s", *distances)
    cli.print_table(table)
    return 0


def summarize(trainings: Sequence[Training]) -> list[dict[str, Any]]:
    """Summarize each group of training runs that differ only in the seed.

    Distances are those of deterministic policies: untrained ones, and the best one of each run. They are
    0 for a policy that failed, and for a run without a best policy.

    Raises:
        CaterpillarError: a training run has no evaluation yet.
    """
    groups: dict[str, list[Training]] = {}
    for training in trainings:
        if not training.history.evaluations:
            raise CaterpillarError(
                f"{training.history.folder} has no evaluation yet; wait for the first evaluation, or "
                "leave this folder out"
            )
        groups.setdefault(training.config.group, []).append(training)
    rows, titles = [], Counter[str]()
    for members in groups.values():
        title = members[0].config.title
        titles[title] += 1
        histories = [training.history for training in members]
        untrained_m = [history.evaluations[0].fitness_m for history in histories]
        best_m = [history.best.distance_m if history.best else 0.0 for history in histories]
        rows.append(
            {
                "name": title if titles[title] == 1 else f"{title} #{titles[title]}",
                "runs": len(members),
                "simulated_s": float(np.median([history.simulated_s for history in histories])),
                "untrained_m": float(np.median(untrained_m)),
                "median_m": float(np.median(best_m)),
                "least_m": min(best_m),
                "most_m": max(best_m),
            }
        )
    return rows
