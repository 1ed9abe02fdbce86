"""Shared functions of the benchmarks: alternating timings, statistics, tables and JSON."""

from __future__ import annotations

import json
import platform
import sys
import time
from collections.abc import Callable, Iterable, Mapping
from importlib.metadata import version
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from caterpillar_env.arrays import Array
from caterpillar_env.machine import cores, processor


def timed(work: Callable[[], Any]) -> float:
    """Return the wall time of `work()`, s."""
    started = time.perf_counter()
    work()
    return time.perf_counter() - started


def rounds(cases: Mapping[str, Callable[[], float]], repeats: int) -> dict[str, Array]:
    """Return the cost of each benchmark case in each round, shape (repeats,).

    The order alternates between rounds, so slow phases of the machine affect all cases equally.
    """
    return _repeat(lambda number: {name: cases[name]() for name in _order(cases, number)}, repeats)


def turns(
    cases: Mapping[str, Callable[[], Callable[[int], Any]]], steps: int, repeats: int
) -> dict[str, Array]:
    """Return the time per step of each benchmark case, s, shape (repeats,).

    All cases make step i before any case makes step i + 1. Slow phases of the machine and expensive
    steps therefore affect all cases equally.

    Args:
        cases: functions that start a case and return a function that makes step i.
        steps: number of steps.
        repeats: number of repetitions.
    """

    def race(_: int) -> dict[str, float]:
        makers = {name: begin() for name, begin in cases.items()}
        spent = dict.fromkeys(makers, 0.0)
        for number in range(steps):
            for name in _order(makers, number):
                spent[name] += timed(lambda make=makers[name], i=number: make(i))  # type: ignore[misc]
        return {name: seconds / steps for name, seconds in spent.items()}

    return _repeat(race, repeats)


def _order(names: Iterable[str], number: int) -> list[str]:
    """Return the names, reversed for odd numbers."""
    return list(names)[:: -1 if number % 2 else 1]


def _repeat(measure: Callable[[int], dict[str, float]], repeats: int) -> dict[str, Array]:
    """Call `measure` with 0, 1, ... and return the values of each case, shape (repeats,)."""
    results = []
    for number in range(repeats):
        results.append(measure(number))
        print(".", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    return {name: np.array([costs[name] for costs in results]) for name in results[0]}


def spread(values: Array) -> dict[str, float]:
    """Return median, minimum and maximum."""
    return {"median": float(np.median(values)), "min": float(values.min()), "max": float(values.max())}


def machine() -> dict[str, Any]:
    """Return the processor, the number of cores and the package versions."""
    packages = ("mujoco", "gymnasium", "numpy")
    return {
        "processor": processor(),
        "cores": cores(),
        "python": platform.python_version(),
        **{name: version(name) for name in packages},
    }


def report(name: str, rows: list[dict[str, Any]], **more: Any) -> None:
    """Print a table to standard error, and its data as a line of JSON to standard output."""
    columns = list(dict.fromkeys(key for row in rows for key in row))
    table = Table(title=name, title_justify="left")
    for column in columns:
        table.add_column(column)
    for row in rows:
        table.add_row(*(_cell(row.get(column, "")) for column in columns))
    Console(stderr=True, width=None if sys.stderr.isatty() else 150).print(table)
    print(json.dumps({"benchmark": name, "machine": machine(), "rows": rows, **more}), flush=True)


def _cell(value: Any) -> str:
    if isinstance(value, dict):
        return f"{value['median']:.3g} ({value['min']:.3g} to {value['max']:.3g})"
    return f"{value:.4g}" if isinstance(value, float) else str(value)
