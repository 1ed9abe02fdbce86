"""`caterpillar rl compare`."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro
from rich.console import Console
from rich.table import Table

from baselines import comparison
from baselines.history import Training
from caterpillar_env.errors import CaterpillarError
from evolution import cli

_HEADINGS = ("training", "seeds", "simulated", "untrained", "median best", "lowest", "highest")


@dataclass(frozen=True)
class CompareArgs:
    """Compare training runs: print a table, and plot the learning curves over simulated time."""

    folders: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Folders of training runs. Runs that differ only in the seed share a row."""
    out: Path = Path("learning.png")
    """Image file for the learning curves: .png, .svg or .pdf."""
    json: bool = False
    """Print JSON instead of a table."""

    def __post_init__(self) -> None:
        if not self.folders:
            raise CaterpillarError("give at least one folder that caterpillar rl train made")


def compare_command(argv: Sequence[str]) -> int:
    """Compare training runs in a table and a plot of their learning curves."""
    args = cli.parse(CompareArgs, argv, "rl compare")
    groups = comparison.group([Training.read(folder) for folder in args.folders])
    rows = [comparison.summarize(name, trainings) for name, trainings in groups.items()]
    comparison.draw(groups, args.out)
    if args.json:
        print(json.dumps([row._asdict() for row in rows], indent=2))
    else:
        table = Table(box=None, pad_edge=False)
        for heading in _HEADINGS:
            table.add_column(heading, justify="left" if heading == "training" else "right")
        for row in rows:
            distances = (f"{1000 * distance_m:.1f} mm" for distance_m in row[3:])
            table.add_row(row.name, str(row.runs), f"{row.simulated_s:,.0f} s", *distances)
        Console(width=140).print(table)
    cli.console().print(f"learning curves written to {args.out}")
    return 0
