"""What the benchmarks share: rounds of timings taken in turn, and their report."""

from __future__ import annotations

import json
import os
import platform
import time
from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np


def timed(run: Callable[[], Any]) -> float:
    """Seconds that `run` takes."""
    started = time.perf_counter()
    run()
    return time.perf_counter() - started


class Rounds:
    """Seconds by name, one a round. Ratios are taken within a round, for machines whose speed drifts."""

    def __init__(self) -> None:
        self.seconds: dict[str, list[float]] = {}

    def add(self, name: str, seconds: float) -> None:
        """Note a timing of this round."""
        self.seconds.setdefault(name, []).append(seconds)

    def ratio(self, name: str, limit: str) -> tuple[float, float, float]:
        """Median, least and largest ratio to the limit."""
        ratios = np.array(self.seconds[name]) / np.array(self.seconds[limit])
        return float(np.median(ratios)), float(ratios.min()), float(ratios.max())


def report(title: str, rounds: Rounds, *, limit: str, per_step: float, **settings: Any) -> None:
    """Print the rounds as a table, and as one line of JSON for machines.

    Args:
        title: what was measured.
        rounds: the timings.
        limit: the name that the others are divided by.
        per_step: physics steps in each timing.
        settings: of the run.
    """
    data: dict[str, Any] = {
        "benchmark": title,
        "settings": settings,
        "machine": f"{platform.machine()}, {os.cpu_count()} cores",
        "versions": {"mujoco": mujoco.__version__, "numpy": np.__version__},
        "seconds": rounds.seconds,
        "ratio_to_limit": {name: rounds.ratio(name, limit) for name in rounds.seconds},
    }
    print(f"{title}, {data['machine']}, {settings}")
    for name, seconds in rounds.seconds.items():
        middle, least, most = data["ratio_to_limit"][name]
        print(
            f"  {name:<20}{np.median(seconds):8.3f} s {1e6 * np.median(seconds) / per_step:8.1f} us/step"
            f"   {middle:.3f} of the limit ({least:.3f} to {most:.3f})"
        )
    print(json.dumps(data))
