"""The subcommand `validate`."""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

from rich.console import Console
from rich.table import Table

from caterpillar_env.files import write_json, writing
from caterpillar_env.robot import Robot
from caterpillar_env.validation import (
    conservation,
    convergence,
    gaits,
    golden,
    material,
    mechanics,
    robustness,
)  # fmt: skip
from caterpillar_env.validation.check import Check
from caterpillar_env.validation.gaits import Gait
from caterpillar_env.validation.robots import evolved_robots, farthest_robots
from evolution import cli
from evolution.genome import Encoding


@dataclass(frozen=True)
class ValidateArgs:
    """Check the physics; the exit status is 1 when a check fails."""

    quick: bool = False
    """Fewer robots, shorter runs, coarser references: a minute instead of a quarter of an hour."""
    settings: bool = False
    """Also weigh numerical settings against one another (five minutes more); writes settings.json."""
    json: bool = False
    """Print JSON instead of a table."""
    out: Path = Path("validation")
    """Folder to make for the plots and validation.json, unless it is there."""


def groups(*, quick: bool) -> dict[str, Callable[[], list[Check]]]:
    """The checks by group, in the order of the table, but for those on the timestep."""
    return {
        "SMA against closed forms": material.check_closed_forms,
        "SMA against Dynalloy's table": material.check_dynalloy,
        "mechanics": mechanics.check_statics,
        "symmetries": lambda: mechanics.check_symmetries(quick=quick),
        "rest": lambda: mechanics.check_rest(quick=quick),
        "momentum and energy": lambda: [
            *conservation.check_momentum(quick=quick),
            *conservation.check_energy(quick=quick),
        ],
        "golden trajectories": golden.check_trajectories,
        "failure detectors": lambda: mechanics.check_failures(_robots(quick)),
        "joint stops": lambda: robustness.check_stops(_robots(quick)),
    }


def _robots(quick: bool) -> list[Robot]:
    return evolved_robots(8) if quick else evolved_robots()


def validate_command(argv: Sequence[str]) -> int:
    """Check the physics against closed forms, data sheets and finer timesteps."""
    args = cli.parse(ValidateArgs, argv, "validate")
    with writing(args.out):
        args.out.mkdir(parents=True, exist_ok=True)
    console = cli.console()
    results: dict[str, list[Check]] = {}
    for name, run in groups(quick=args.quick).items():
        console.print(f"{name} ... ", end="")
        started = time.monotonic()
        results[name] = run()
        console.print(f"{_passed(results[name])} ({time.monotonic() - started:.0f} s)")
    console.print("gaits of the evolved robots ... ", end="")
    measured = gaits.measure_gaits(_robots(args.quick), quick=args.quick)
    results["gaits of the evolved robots"] = gaits.check_gaits(measured)
    console.print(_passed(results["gaits of the evolved robots"]))
    console.print("timestep, most of the work ... ", end="")
    started = time.monotonic()
    compared = convergence.compare(quick=args.quick)
    results["timestep"] = convergence.check_timestep(compared)
    console.print(f"{_passed(results['timestep'])} ({time.monotonic() - started:.0f} s)")
    console.print("plots ...")
    material.plot(args.out / "sma.png")
    convergence.plot(compared, args.out / "timestep.png")
    if not args.quick:
        robustness.plot_parameters(
            *robustness.vary_parameters(farthest_robots(5)), args.out / "sensitivity.png"
        )
        ratios = robustness.vary_genes(farthest_robots(10))
        titles = [gene.title for gene in Encoding().genes]
        robustness.plot_genes(ratios, titles, args.out / "perturbation.png")
    data = {group: [check._asdict() for check in found] for group, found in results.items()}
    write_json(args.out / "validation.json", data)
    write_json(args.out / "gaits.json", [gait._asdict() for gait in measured])
    tables = [_table(results), _gaits(measured)]
    if args.settings:
        console.print("settings ...")
        rows = convergence.compare_settings()
        write_json(args.out / "settings.json", rows)
        tables.append(_settings(rows))
    if args.json:
        print(json.dumps(data, indent=2))
    else:
        for table in tables:
            Console(width=None if sys.stdout.isatty() else 150).print(table)
    every = [check for found in results.values() for check in found]
    console.print(f"{_passed(every)}; plots are in {args.out}")
    if not all(check.passed for check in results["golden trajectories"]):
        console.print(golden.ADVICE)
    return 0 if all(check.passed for check in every) else 1


def _passed(checks: list[Check]) -> str:
    return f"{sum(check.passed for check in checks)} of {len(checks)} checks passed"


def _table(results: dict[str, list[Check]]) -> Table:
    table = Table(title="Validation", title_justify="left")
    for heading in ("check", "expected", "got", "tolerance", ""):
        table.add_column(heading)
    for group, found in results.items():
        table.add_section()
        table.add_row(group, style="bold")
        for check in found:
            verdict = "pass" if check.passed else "FAIL"
            table.add_row(
                *(str(part) for part in check[:4]), verdict, style=None if check.passed else "red"
            )
    return table


def _gaits(measured: Sequence[Gait]) -> Table:
    """How the evolved robots move, the farthest first."""
    table = Table(title="Gaits of the evolved robots", title_justify="left")
    for heading in (
        "distance (mm)", "best tenth of the period", "peak speed (mm/s)", "slip over distance",
        "load on the body", "overrun of a joint", "cost of transport", "body lengths per s",
    ):  # fmt: skip
        table.add_column(heading, justify="right")
    for g in sorted(measured, key=lambda g: -g.distance_m):
        table.add_row(
            f"{1000 * g.distance_m:.0f}", f"{g.best_tenth:.0%}", f"{1000 * g.peak_speed_m_s:.0f}",
            f"{g.slip:.2f}", f"{g.body_load:.1%}", f"{g.overrun:.1%}", f"{g.cost_of_transport:.0f}",
            f"{g.body_lengths_s:.3f}",
        )  # fmt: skip
    return table


def _settings(rows: list[dict[str, float | str]]) -> Table:
    table = Table(title="Settings against references of 0.5 ms", title_justify="left")
    for heading in rows[0]:
        table.add_column(heading.replace("_", " "))
    for row in rows:
        table.add_row(*(v if isinstance(v, str) else f"{v:.3g}" for v in row.values()))
    return table
