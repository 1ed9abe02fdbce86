"""`caterpillar export`."""

from __future__ import annotations

import io
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from caterpillar_env.errors import CaterpillarError
from caterpillar_env.files import write_bytes, writing
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
    """Format; by default, from the suffix of --out, or csv."""
    out: Path | None = None
    """File to write; by default, evaluations.csv, .parquet or .json, or best.xml, in the run folder, or
    ROBOT.xml beside ROBOT.json."""


def export_command(argv: Sequence[str]) -> int:
    """Export the evaluations of a run as a table, or a robot as a MuJoCo model."""
    args = cli.parse(ExportArgs, argv, "export")
    suffix = args.out.suffix.lower() if args.out else ""
    kind = args.to or _SUFFIXES.get(suffix, "csv")
    if args.to is None and suffix and suffix not in _SUFFIXES:
        raise CaterpillarError(
            f"the suffix of --out must be {', '.join(_SUFFIXES)}; got {args.out}; to choose a format "
            "for any name, add --to"
        )
    if kind != "mjcf" and args.source.is_file():
        raise CaterpillarError(
            f"a table needs a run folder; got {args.source}; to export the robot in a JSON file, add "
            "--to mjcf"
        )
    if kind == "mjcf":
        robot = Robot.load(args.source)
        file = args.source / "best.json" if args.source.is_dir() else args.source
        out = args.out or file.with_suffix(".xml")
        data = model_xml(robot.morphology, robot.physics).encode()
        written = f"model of a robot with {robot.physics.num_segments} segments"
    else:
        table = History.read(args.source).table()
        out = args.out or args.source / f"evaluations.{kind}"
        content = io.BytesIO()  # because polars ignores or hides the error of a full disk
        getattr(table, f"write_{kind}")(content)
        data = content.getvalue()
        written = f"{len(table)} evaluations"
    if out.exists() and not out.is_file():  # such as /dev/stdout, which must not be replaced
        with writing(out):
            out.write_bytes(data)
    else:
        write_bytes(out, data)
    print(f"{written} written to {out}", file=sys.stderr)
    return 0
