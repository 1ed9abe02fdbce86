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

from baselines.records import Record
from caterpillar_env.errors import CaterpillarError
from evolution import cli


@dataclass(frozen=True)
class CompareArgs:
    """Put trainings side by side: a table, and their learning curves over simulated time."""

    folders: Annotated[tuple[Path, ...], tyro.conf.Positional]
    """Folders of trainings; those that differ in the seed alone are one row."""
    out: Path = Path("learning.png")
    """File to draw the learning curves in: .png, .svg, .pdf."""
    json: bool = False
    """Print JSON instead of a table."""

    def __post_init__(self) -> None:
        if not self.folders:
            raise CaterpillarError(
                "give the folders of trainings to compare, as caterpillar rl train made them"
            )


def compare_command(argv: Sequence[str]) -> int:
    """`caterpillar rl compare`."""
    from baselines import comparison

    args = cli.parse(CompareArgs, argv, "rl compare")
    groups = comparison.grouped({folder: Record.load(folder) for folder in args.folders})
    rows = [comparison.summary(name, folders) for name, folders in groups.items()]
    comparison.draw(groups, args.out)
    if args.json:
        print(json.dumps([row._asdict() for row in rows], indent=2))
    else:
        table = Table(box=None, pad_edge=False)
        for heading in ("training", "seeds", "simulated", "untrained", "best: median", "least", "most"):
            table.add_column(heading, justify="left" if heading == "training" else "right")
        for row in rows:
            table.add_row(
                row.name, str(row.runs), f"{row.simulated_s:,.0f} s",
                *(f"{1000 * m:.1f} mm" for m in row[3:]),
            )  # fmt: skip
        Console(width=140).print(table)
    cli.console().print(f"learning curves drawn in {args.out}")
    return 0
