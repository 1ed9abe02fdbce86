"""Shared functions of the benchmarks: alternating timings, statistics, tables and JSON."""

from __future__ import annotations

import json
import math
import platform
import sys
import time
from collections.abc import Callable, Mapping
from importlib.metadata import version
from typing import Any

import numpy as np
from rich.console import Console
from rich.table import Table

from caterpillar_env.arrays import Array
from caterpillar_env.machine import cores, processor
from evolution.study.statistics import median

Step = Callable[[int], Any]  #: a function that makes step i


def time_steps(cases: Mapping[str, Callable[[], Step]], steps: int, repeats: int) -> dict[str, Array]:
    """Return the time per step of each benchmark case, s, shape (repeats,).

    All cases make step i before any case makes step i + 1, in alternating order. Slow phases of the
    machine and expensive steps therefore affect all cases equally.

    Args:
        cases: functions that start a case and return a function that makes step i.
        steps: number of steps.
        repeats: number of repetitions.
    """
    spent = {name: np.zeros(repeats) for name in cases}
    for repeat in range(repeats):
        makers = {name: begin() for name, begin in cases.items()}
        for number in range(steps):
            for name in list(cases)[:: -1 if (number + repeat) % 2 else 1]:
                started = time.perf_counter()
                makers[name](number)
                spent[name][repeat] += time.perf_counter() - started
        print(".", end="", file=sys.stderr, flush=True)
    print(file=sys.stderr)
    return {name: seconds / steps for name, seconds in spent.items()}


def spread(values: Array) -> dict[str, float]:
    """Return median, minimum and maximum."""
    return {"median": float(np.median(values)), "min": float(values.min()), "max": float(values.max())}


def interval(values: Array) -> dict[str, float]:
    """Return the median and its bootstrap interval, which is NaN for fewer than five values."""
    value, low, high = median(values)
    return {"median": value, "low": low, "high": high}


def report(name: str, rows: list[dict[str, Any]]) -> None:
    """Print a table to standard error, and its data as a line of JSON to standard output."""
    table = Table(*rows[0], title=name, title_justify="left")
    for row in rows:
        table.add_row(*map(_cell, row.values()))
    Console(stderr=True, width=None if sys.stderr.isatty() else 150).print(table)
    machine = {
        "processor": processor(),
        "cores": cores(),
        "python": platform.python_version(),
        **{package: version(package) for package in ("mujoco", "gymnasium", "numpy")},
    }
    print(json.dumps({"benchmark": name, "machine": machine, "rows": rows}), flush=True)


def _cell(value: Any) -> str:
    if isinstance(value, dict):
        middle, low, high = value.values()
        return f"{middle:.3g}" + ("" if math.isnan(low) else f" ({low:.3g} to {high:.3g})")
    return f"{value:.4g}" if isinstance(value, float) else str(value)
