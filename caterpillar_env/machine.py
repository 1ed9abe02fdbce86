"""The processor of this machine, and how much of it this process may use."""

from __future__ import annotations

import math
import os
import platform
from pathlib import Path

_ROOT, _OWN = Path("/sys/fs/cgroup"), Path("/proc/self/cgroup")


def processor() -> str:
    """Name of the processor, as reported by the system."""
    try:
        lines = Path("/proc/cpuinfo").read_text("utf-8").splitlines()
    except OSError:
        lines = []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def cores() -> int:
    """Number of usable cores: those this process may run on, within its quota (see `quota`)."""
    allowed = len(os.sched_getaffinity(0))
    return max(1, min(allowed, math.ceil(quota() or allowed)))


def quota(root: Path = _ROOT, own: Path = _OWN) -> float | None:
    """Cores' worth of time that the process's control group may use; None if it is not limited.

    Args:
        root: where control groups of version 2, or those of version 1 by controller, are mounted.
        own: file that names the group of this process in each hierarchy.
    """
    try:
        entries = [line.split(":", 2) for line in own.read_text("utf-8").splitlines()]
        controllers, group = next(e[1:] for e in entries if not e[1] or "cpu" in e[1].split(","))
        top = root / "cpu" if controllers else root
        folder = top / group.lstrip("/")
        folder = folder if folder.is_dir() else top  # in a container, where only its own is mounted
        names = ("cpu.cfs_quota_us", "cpu.cfs_period_us") if controllers else ("cpu.max",)
        limit, period = " ".join((folder / name).read_text("utf-8") for name in names).split()
        return int(limit) / int(period) if int(limit) > 0 else None
    except (OSError, ValueError, StopIteration):  # "max", or no control groups
        return None
