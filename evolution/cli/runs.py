"""`caterpillar runs`."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.console import Console
from rich.table import Table

from caterpillar_env.errors import CaterpillarError
from caterpillar_env.robot import Robot
from evolution import cli
from evolution.run.database import JournalError, is_in_use
from evolution.run.history import History
from evolution.run.journal import FILE


@dataclass(frozen=True)
class RunsArgs:
    """List the runs in a folder: what they are, how far they are, how good."""

    folder: Annotated[Path, tyro.conf.Positional] = Path("runs")
    """Folder to look in, and in the folders within it."""
    json: bool = False
    """Print JSON instead of a table."""


def runs_command(argv: Sequence[str]) -> int:
    """List the runs in a folder."""
    args = cli.parse(RunsArgs, argv, "runs")
    if not args.folder.is_dir():
        raise CaterpillarError(f"{args.folder} is no folder; give the one that holds the runs")
    found = [_summary(path.parent) for path in sorted(args.folder.glob(f"**/{FILE}"))]
    if args.json:
        print(json.dumps(found, indent=2))
        return 0
    if not found:
        print(f"no runs in {args.folder}", file=sys.stderr)
        return 0
    shown = Table()
    for heading in found[0]:
        shown.add_column(heading)
    for row in found:
        shown.add_row(*("" if value is None else str(value) for value in row.values()))
    Console(width=None if sys.stdout.isatty() else 150).print(shown)
    return 0


def _summary(folder: Path) -> dict[str, Any]:
    row: dict[str, Any] = dict.fromkeys(
        ("run", "state", "optimizer", "prior", "seed", "generation", "evaluations", "best, mm")
    )
    row["run"] = str(folder)
    try:
        history = History.read(folder)
        config, evaluations, finished = history.config, history.evaluations, history.finished
    except JournalError as error:
        row["state"] = str(error)
        return row
    done = 1 + evaluations[-1].generation if evaluations else 0
    row |= {
        "state": "running" if is_in_use(folder) else "finished" if finished else "stopped",
        "optimizer": history.own_optimizer or config.optimizer,
        "prior": config.prior,
        "seed": config.seed,
        "generation": f"{done} of {config.generations}" if config.budget_s is None else str(done),
        "evaluations": len(evaluations),
        "best, mm": _best_mm(folder),
    }
    return row


def _best_mm(folder: Path) -> float | None:
    try:
        fitness_m = Robot.load(folder).fitness_m
    except CaterpillarError:
        return None  # nobody has crawled forwards yet
    return None if fitness_m is None else round(1000 * fitness_m, 1)
