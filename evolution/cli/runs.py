"""`caterpillar runs`."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro
from rich.table import Table

from caterpillar_env.errors import CaterpillarError
from evolution import cli
from evolution.run.database import is_in_use
from evolution.run.history import History
from evolution.run.journal import FILE


@dataclass(frozen=True)
class RunsArgs:
    """List evolution and training runs with their settings, progress and best distance."""

    folder: Annotated[Path, tyro.conf.Positional] = Path("runs")
    """Folder to search, including its subfolders."""
    json: bool = False
    """Print JSON instead of a table."""


def runs_command(argv: Sequence[str]) -> int:
    """List the runs in a folder."""
    args = cli.parse(RunsArgs, argv, "runs")
    if not args.folder.is_dir():
        raise CaterpillarError(f"{args.folder} is not a folder; give the folder that contains the runs")
    rows = [_describe(path.parent) for path in sorted(args.folder.glob(f"**/{FILE}"))]
    if args.json:
        print(json.dumps(rows, indent=2))
    elif not rows:
        print(f"no runs in {args.folder}", file=sys.stderr)
    else:
        table = Table()
        for name in rows[0]:
            table.add_column(name, no_wrap=name == "run")  # people copy the names of runs
        for row in rows:
            table.add_row(*(_to_text(value) for value in row.values()))
        cli.print_table(table)
    return 0


def _describe(folder: Path) -> dict[str, Any]:
    names = ("run", "state", "optimizer", "prior", "seed", "generation", "evaluations", "best, mm")
    row: dict[str, Any] = dict.fromkeys(names) | {"run": str(folder)}
    try:
        history = History.read(folder)
        row |= _summarize(history)
    except CaterpillarError as error:
        row["state"] = str(error)
    return row


def _summarize(history: History) -> dict[str, Any]:
    row: dict[str, Any] = {}
    if history.kind == "training":
        training = history.configuration
        row["optimizer"] = f"{training.get('algorithm')} {training.get('mode')}"
        row["prior"], row["seed"] = training.get("prior", "uniform"), training.get("seed")
        total, budget_s = None, training.get("budget_s")
    else:
        config = history.config
        row["optimizer"] = history.own_optimizer or config.optimizer
        row["prior"], row["seed"] = config.prior, config.seed
        total, budget_s = config.generations, config.budget_s
    done = len(history.generations)
    ended = "finished" if history.finished else "stopped"
    row["state"] = "running" if is_in_use(history.folder) else ended
    if budget_s is None:
        row["generation"] = f"{done} of {total}"
    else:
        row["generation"] = f"{done} ({100 * min(history.simulated_s / budget_s, 1.0):.0f} %)"
    row["evaluations"] = len(history.evaluations)
    row["best, mm"] = history.best and round(1000 * history.best.distance_m, 1)
    return row


def _to_text(value: Any) -> str:
    """Return a cell of the table. Characters that could control the terminal are replaced."""
    text = "" if value is None else str(value)
    return "".join(c if c.isprintable() else "?" for c in text)
