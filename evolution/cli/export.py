"""`caterpillar export`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from caterpillar_env.errors import CaterpillarError
from caterpillar_env.files import writing
from caterpillar_env.model import model_xml
from caterpillar_env.robot import Robot
from evolution import cli
from evolution.run.history import History

Format = Literal["csv", "parquet", "json", "mjcf"]
_ENDINGS: dict[str, Format] = {".csv": "csv", ".parquet": "parquet", ".json": "json", ".xml": "mjcf"}


@dataclass(frozen=True)
class ExportArgs:
    """Write the evaluations of a run as a table, or a robot as a MuJoCo model.

    A table (csv, parquet, json) has one row each, genes in SI units. A model (mjcf) is the XML of the
    best robot of a run, or of the robot in a JSON file, for programs that have nothing but MuJoCo.
    """

    source: Annotated[Path, tyro.conf.Positional]
    """The run folder; for mjcf also the JSON file of one robot (best.json)."""
    to: Format | None = None
    """Kind of file; by default what the name of the file says, else csv."""
    out: Path | None = None
    """File to write; by default evaluations.csv (.parquet, .json) or, for mjcf, best.xml there."""

    def __post_init__(self) -> None:
        if self.to and self._said and self.to != self._said:
            raise CaterpillarError(
                f"--to {self.to} and --out {self.out} contradict: leave out one of them"
            )
        if self.kind != "mjcf" and self.source.is_file():
            raise CaterpillarError(
                f"{self.source} is a file, and a table is made from a run folder; give the folder, or "
                "--to mjcf for the model of the robot in the file"
            )

    @property
    def _said(self) -> Format | None:
        """The kind that the name of the file tells."""
        return None if self.out is None else _ENDINGS.get(self.out.suffix)

    @property
    def kind(self) -> Format:
        """What is written."""
        return self.to or self._said or "csv"


def export_command(argv: Sequence[str]) -> int:
    """Export the evaluations of a run as a table, or a robot as a MuJoCo model."""
    args = cli.parse(ExportArgs, argv, "export")
    message = _write_model(args) if args.kind == "mjcf" else _write_table(args)
    print(message, file=sys.stderr)
    return 0


def _write_table(args: ExportArgs) -> str:
    rows = History.read(args.source).table()
    out = args.out or args.source / f"evaluations.{args.kind}"
    with writing(out), out.open("wb") as file:
        getattr(rows, f"write_{args.kind}")(file)
    return f"{len(rows)} evaluations in {out}"


def _write_model(args: ExportArgs) -> str:
    robot = Robot.load(args.source)
    file = args.source / "best.json" if args.source.is_dir() else args.source
    out = args.out or file.with_suffix(".xml")
    xml = model_xml(robot.morphology, robot.physics)
    with writing(out):
        out.write_text(xml, encoding="utf-8")
    return f"robot of {robot.physics.num_segments} segments in {out}"
