"""`caterpillar export`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from evolution import cli
from evolution.files import writing
from evolution.records import table

Format = Literal["csv", "parquet", "json"]


@dataclass(frozen=True)
class ExportArgs:
    """Write the evaluations of a run as a table, one row each, genes in SI units."""

    folder: Annotated[Path, tyro.conf.Positional]
    """The run folder."""
    to: Format = "csv"
    """Kind of file."""
    out: Path | None = None
    """File to write; by default evaluations.csv, .parquet or .json in the run folder."""


def export_command(argv: Sequence[str]) -> int:
    """`caterpillar export`."""
    args = cli.parse(ExportArgs, argv, "export")
    rows = table(args.folder)
    out = args.out or args.folder / f"evaluations.{args.to}"
    with writing(out), out.open("wb") as file:
        getattr(rows, f"write_{args.to}")(file)
    print(f"{len(rows)} evaluations in {out}", file=sys.stderr)
    return 0
