"""`caterpillar doctor`."""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from dataclasses import dataclass

from rich.console import Console
from rich.markup import escape
from rich.table import Table

from evolution import cli
from evolution.cli import diagnosis
from evolution.cli.diagnosis import Finding

_MARKS = {"ok": "[green]ok[/green]", "note": "[yellow]--[/yellow]", "fail": "[red]NO[/red]"}
_TRIAL_S = 8.0


@dataclass(frozen=True)
class DoctorArgs:
    """Say what is installed, whether drawing works, and how fast robots are simulated here.

    The exit status is 1 if something that every run needs does not work. Drawing is needed for videos
    and `render` only.
    """

    measure: bool = True
    """Measure the speed, for about eight seconds."""
    json: bool = False
    """Print JSON instead of a table."""


def doctor_command(argv: Sequence[str]) -> int:
    """`caterpillar doctor`."""
    args = cli.parse(DoctorArgs, argv, "doctor")
    console = cli.console()
    findings = [*diagnosis.installed(), *diagnosis.processor()]
    console.print("drawing a frame ...")
    findings += [diagnosis.drawing(), diagnosis.ffmpeg()]
    console.print("measuring the speed ..." if args.measure else "simulating a robot ...")
    speed = diagnosis.trial("speed", 50 if args.measure else 1, _TRIAL_S if args.measure else 0.0)
    findings += diagnosis.simulating(speed, told=args.measure)
    ok = all(f.status != "fail" for f in findings)
    if args.json:
        said = {"ok": ok, "findings": [f._asdict() for f in findings]}
        print(json.dumps(said | {"speed": speed.data if args.measure else None}, indent=2))
    else:
        Console(width=None if sys.stdout.isatty() else 150).print(_table(findings))
        some = any(f.status == "note" for f in findings)
        good = "everything that every run needs works" + ("; -- marks what only some need" * some)
        print("\n" + (good if ok else "something that every run needs does not work"))
    return 0 if ok else 1


def _table(findings: Sequence[Finding]) -> Table:
    table = Table.grid(padding=(0, 2))
    for finding in findings:
        table.add_row(_MARKS[finding.status], finding.name, escape(finding.found))
        if finding.mend:
            table.add_row("", "", f"[bold]{escape(finding.mend)}[/bold]")
    return table
