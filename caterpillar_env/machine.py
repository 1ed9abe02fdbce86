"""The processor of this machine, and the number of cores that this process may use."""

from __future__ import annotations

import math
import os
import platform
from pathlib import Path

MAX_THREADS = 1024  #: largest number of threads that a simulation accepts


def processor() -> str:
    """Return the name of the processor, as reported by the system."""
    try:
        lines = Path("/proc/cpuinfo").read_text("utf-8").splitlines()
    except OSError:
        lines = []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def cores() -> int:
    """Return the number of usable cores, as limited by CPU affinity and `quota`."""
    allowed = len(os.sched_getaffinity(0))
    return max(1, min(allowed, math.ceil(quota() or allowed)))


def quota(groups: Path = Path("/sys/fs/cgroup")) -> float | None:
    """Return the CPU limit of this container in cores, or None without a limit.

    Args:
        groups: mount point of the control groups, version 2 or 1.
    """
    for names in (("cpu.max",), ("cpu/cpu.cfs_quota_us", "cpu/cpu.cfs_period_us")):
        try:
            limit, period = " ".join((groups / name).read_text("utf-8") for name in names).split()
            return int(limit) / int(period) if int(limit) > 0 else None
        except (OSError, ValueError):  # no such file, or "max"
            continue
    return None
