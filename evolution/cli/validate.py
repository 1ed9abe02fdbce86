"""`caterpillar validate`."""

from __future__ import annotations

import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from rich.table import Table

from caterpillar_env.files import write_json, writing
from caterpillar_env.robot import Robot
from caterpillar_env.task import EPISODE_S
from evolution import cli

if TYPE_CHECKING:
    from caterpillar_env.validation.check import Check


@dataclass(frozen=True)
class ValidateArgs:
    """Check the physics. The exit status is 1 if a check fails."""

    quick: bool = False
    """Use fewer robots, shorter runs and coarser references: one minute instead of fifteen."""
    settings: bool = False
    """Also compare numerical settings, and write settings.json. This takes five more minutes."""
    json: bool = False
    """Print JSON instead of tables."""
    out: Path = Path("validation")
    """Folder for the plots and validation.json. It is created if missing."""


def groups(robots: Sequence[Robot], *, quick: bool) -> dict[str, Callable[[], list[Check]]]:
    """Return the groups of checks in the order of the table, without gaits and timesteps."""
    from caterpillar_env.validation import (
        conservation,
        golden,
        material,
        mechanics,
        robustness,
        worlds,
    )  # fmt: skip

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
        "failure detectors": lambda: mechanics.check_failures(robots),
        "joint stops": lambda: robustness.check_stops(robots),
        "worlds": lambda: [
            *worlds.check_creep(quick=quick),
            *worlds.check_convergence(quick=quick),
        ],
    }


def validate_command(argv: Sequence[str]) -> int:
    """Check the physics against closed forms, data sheets and finer timesteps."""
    from caterpillar_env.validation import convergence, gaits, golden, material, robustness
    from caterpillar_env.validation.robots import evolved_robots, farthest_robots

    args = cli.parse(ValidateArgs, argv, "validate")
    with writing(args.out):
        args.out.mkdir(parents=True, exist_ok=True)
    console = cli.console()
    robots = evolved_robots(5 if args.quick else None)
    results: dict[str, list[Check]] = {}
    for name, make_checks in groups(robots, quick=args.quick).items():
        console.print(f"{name} ...")
        results[name] = make_checks()
    console.print("gaits of the evolved robots ...")
    measured = [gaits.measure_gait(robot, EPISODE_S / (3 if args.quick else 1)) for robot in robots]
    results["gaits of the evolved robots"] = gaits.check_gaits(measured)
    console.print("timestep, which takes most of the time ...")
    compared = convergence.compare(quick=args.quick)
    results["timestep"] = convergence.check_timestep(compared)
    console.print("plots ...")
    material.plot(args.out / "sma.png")
    convergence.plot(compared, args.out / "timestep.png")
    if not args.quick:
        ratios = robustness.vary_parameters(farthest_robots(5))
        robustness.plot_parameters(ratios, args.out / "sensitivity.png")
    data = {group: [check._asdict() for check in checks] for group, checks in results.items()}
    write_json(args.out / "validation.json", data)
    rows = [gait._asdict() for gait in measured]
    write_json(args.out / "gaits.json", rows)
    tables = [_tabulate_checks(results), _tabulate("Gaits of the evolved robots", rows)]
    if args.settings:
        console.print("settings ...")
        rows = convergence.compare_settings()
        write_json(args.out / "settings.json", rows)
        tables.append(_tabulate("Settings against references of 0.5 ms", rows))
    if args.json:
        print(json.dumps(data, indent=2))
    else:
        for table in tables:
            cli.print_table(table)
    passed = [check.passed for checks in results.values() for check in checks]
    console.print(f"{sum(passed)} of {len(passed)} checks passed; plots are in {args.out}")
    if not all(check.passed for check in results["golden trajectories"]):
        console.print(golden.ADVICE)
    return 0 if all(passed) else 1


def _tabulate_checks(results: dict[str, list[Check]]) -> Table:
    headings = ("check", "expected", "got", "tolerance", "")
    table = Table(*headings, title="Validation", title_justify="left")
    for group, checks in results.items():
        table.add_section()
        table.add_row(group, style="bold")
        for check in checks:
            cells = [*map(str, check[:4]), "pass" if check.passed else "FAIL"]
            table.add_row(*cells, style=None if check.passed else "red")
    return table


def _tabulate(title: str, rows: Sequence[dict[str, Any]]) -> Table:
    """Return a table with a column for each key. The keys end with units."""
    table = Table(*(name.replace("_", " ") for name in rows[0]), title=title, title_justify="left")
    for row in rows:
        table.add_row(*(v if isinstance(v, str) else f"{v:.3g}" for v in row.values()))
    return table
