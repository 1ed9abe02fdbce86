"""`caterpillar export`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, get_args

import tyro

from caterpillar_env.errors import CaterpillarError
from evolution import cli
from evolution.files import writing
from evolution.records import table

Format = Literal["csv", "parquet", "json"]


@dataclass(frozen=True)
class ExportArgs:
    """Write the evaluations of a run as a table, one row each, genes in SI units."""

    folder: Annotated[Path, tyro.conf.Positional]
    """The run folder."""
    to: Format | None = None
    """Kind of file; by default what the name of the file says, else csv."""
    out: Path | None = None
    """File to write; by default evaluations.csv, .parquet or .json in the run folder."""

    def __post_init__(self) -> None:
        if self.to and self._said and self.to != self._said:
            raise CaterpillarError(
                f"--to {self.to} and --out {self.out} contradict: leave out one of them"
            )

    @property
    def _said(self) -> Format | None:
        """The kind that the name of the file tells."""
        ending = "" if self.out is None else self.out.suffix.removeprefix(".")
        return next((kind for kind in get_args(Format) if kind == ending), None)

    @property
    def kind(self) -> Format:
        """What is written."""
        return self.to or self._said or "csv"


def export_command(argv: Sequence[str]) -> int:
    """`caterpillar export`."""
    args = cli.parse(ExportArgs, argv, "export")
    rows = table(args.folder)
    out = args.out or args.folder / f"evaluations.{args.kind}"
    with writing(out), out.open("wb") as file:
        getattr(rows, f"write_{args.kind}")(file)
    print(f"{len(rows)} evaluations in {out}", file=sys.stderr)
    return 0
