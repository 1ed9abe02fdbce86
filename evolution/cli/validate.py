"""`caterpillar validate`."""

from __future__ import annotations

import json
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from rich.table import Table

from caterpillar_env.files import write_json, writing
from caterpillar_env.robot import Robot
from evolution import cli
from evolution.genome import Encoding

if TYPE_CHECKING:
    from caterpillar_env.validation.check import Check
    from caterpillar_env.validation.gaits import Gait


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


def groups(*, quick: bool) -> dict[str, Callable[[], list[Check]]]:
    """Return the groups of checks in the order of the table, without those of gaits and timesteps."""
    from caterpillar_env.validation import conservation, golden, material, mechanics, robustness

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
        "failure detectors": lambda: mechanics.check_failures(_load_robots(quick)),
        "joint stops": lambda: robustness.check_stops(_load_robots(quick)),
    }


def _load_robots(quick: bool) -> list[Robot]:
    from caterpillar_env.validation.robots import evolved_robots

    return evolved_robots(8) if quick else evolved_robots()


def validate_command(argv: Sequence[str]) -> int:
    """Check the physics against closed forms, data sheets and finer timesteps."""
    from caterpillar_env.validation import convergence, gaits, golden, material, robustness
    from caterpillar_env.validation.robots import farthest_robots

    args = cli.parse(ValidateArgs, argv, "validate")
    with writing(args.out):
        args.out.mkdir(parents=True, exist_ok=True)
    console = cli.console()
    results: dict[str, list[Check]] = {}

    def run(name: str, make_checks: Callable[[], list[Check]]) -> None:
        console.print(f"{name} ... ", end="")
        started = time.monotonic()
        results[name] = make_checks()
        console.print(f"{_count_passed(results[name])} ({time.monotonic() - started:.0f} s)")

    for name, make_checks in groups(quick=args.quick).items():
        run(name, make_checks)
    console.print("measuring gaits ...")
    measured = gaits.measure_gaits(_load_robots(args.quick), quick=args.quick)
    run("gaits of the evolved robots", lambda: gaits.check_gaits(measured))
    console.print("comparing timesteps, which takes most of the time ...")
    compared = convergence.compare(quick=args.quick)
    run("timestep", lambda: convergence.check_timestep(compared))
    console.print("plotting ...")
    material.plot(args.out / "sma.png")
    convergence.plot(compared, args.out / "timestep.png")
    if not args.quick:
        swept = robustness.vary_parameters(farthest_robots(5))
        robustness.plot_parameters(*swept, args.out / "sensitivity.png")
        ratios = robustness.vary_genes(farthest_robots(10))
        titles = [gene.title for gene in Encoding().genes]
        robustness.plot_genes(ratios, titles, args.out / "perturbation.png")
    data = {group: [check._asdict() for check in checks] for group, checks in results.items()}
    write_json(args.out / "validation.json", data)
    write_json(args.out / "gaits.json", [gait._asdict() for gait in measured])
    tables = [_tabulate_checks(results), _tabulate_gaits(measured)]
    if args.settings:
        console.print("comparing settings ...")
        rows = convergence.compare_settings()
        write_json(args.out / "settings.json", rows)
        tables.append(_tabulate_settings(rows))
    if args.json:
        print(json.dumps(data, indent=2))
    else:
        for table in tables:
            cli.print_table(table)
    checks = [check for group in results.values() for check in group]
    console.print(f"{_count_passed(checks)}; plots are in {args.out}")
    if not all(check.passed for check in results["golden trajectories"]):
        console.print(golden.ADVICE)
    return 0 if all(check.passed for check in checks) else 1


def _count_passed(checks: list[Check]) -> str:
    return f"{sum(check.passed for check in checks)} of {len(checks)} checks passed"


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


def _tabulate_gaits(measured: Sequence[Gait]) -> Table:
    headings = (
        "distance (mm)", "best tenth of the period", "peak speed (mm/s)", "slip over distance",
        "load on the body", "overrun of a joint", "cost of transport", "body lengths per s",
    )  # fmt: skip
    table = Table(*headings, title="Gaits of the evolved robots", title_justify="left")
    for g in sorted(measured, key=lambda g: -g.distance_m):
        table.add_row(
            f"{1000 * g.distance_m:.0f}", f"{g.best_tenth:.0%}", f"{1000 * g.peak_speed_m_s:.0f}",
            f"{g.slip:.2f}", f"{g.body_load:.1%}", f"{g.overrun:.1%}", f"{g.cost_of_transport:.0f}",
            f"{g.body_lengths_s:.3f}",
        )  # fmt: skip
    return table


def _tabulate_settings(rows: list[dict[str, float | str]]) -> Table:
    headings = [name.replace("_", " ") for name in rows[0]]
    table = Table(*headings, title="Settings against references of 0.5 ms", title_justify="left")
    for row in rows:
        table.add_row(*(v if isinstance(v, str) else f"{v:.3g}" for v in row.values()))
    return table
