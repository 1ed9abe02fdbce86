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
_SUFFIXES: dict[str, Format] = {".csv": "csv", ".parquet": "parquet", ".json": "json", ".xml": "mjcf"}


@dataclass(frozen=True)
class ExportArgs:
    """Export the evaluations of a run as a table, or a robot as a MuJoCo model.

    A table (csv, parquet, json) has one row per evaluation, with all genes in SI units. A model (mjcf)
    is the XML of one robot: the best robot of a run, or the robot in a JSON file.
    """

    source: Annotated[Path, tyro.conf.Positional]
    """Run folder. For mjcf, it can also be the JSON file of a robot (best.json)."""
    to: Format | None = None
    """Format; by default, the format that the suffix of --out names, or csv."""
    out: Path | None = None
    """File to write; by default, evaluations.csv, .parquet or .json, or best.xml, in the run folder."""

    def __post_init__(self) -> None:
        named = _SUFFIXES.get(self.out.suffix) if self.out else None
        if self.to and named and self.to != named:
            raise CaterpillarError(f"--to {self.to} contradicts --out {self.out}: remove one of them")
        object.__setattr__(self, "to", self.to or named or "csv")
        if self.to != "mjcf" and self.source.is_file():
            raise CaterpillarError(
                f"a table needs a run folder, but {self.source} is a file: give the folder, or use --to "
                "mjcf to export the robot in the file"
            )


def export_command(argv: Sequence[str]) -> int:
    """Export the evaluations of a run as a table, or a robot as a MuJoCo model."""
    args = cli.parse(ExportArgs, argv, "export")
    message = _write_model(args) if args.to == "mjcf" else _write_table(args)
    print(message, file=sys.stderr)
    return 0


def _write_table(args: ExportArgs) -> str:
    table = History.read(args.source).table()
    out = args.out or args.source / f"evaluations.{args.to}"
    with writing(out), out.open("wb") as file:
        getattr(table, f"write_{args.to}")(file)
    return f"{len(table)} evaluations written to {out}"


def _write_model(args: ExportArgs) -> str:
    robot = Robot.load(args.source)
    file = args.source / "best.json" if args.source.is_dir() else args.source
    out = args.out or file.with_suffix(".xml")
    with writing(out):
        out.write_text(model_xml(robot.morphology, robot.physics), encoding="utf-8")
    return f"model of a robot with {robot.physics.num_segments} segments written to {out}"
