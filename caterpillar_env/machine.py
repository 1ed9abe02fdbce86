"""The processor of this machine, and the number of cores that this process may use."""

from __future__ import annotations

import math
import os
import platform
from pathlib import Path

_ROOT, _OWN = Path("/sys/fs/cgroup"), Path("/proc/self/cgroup")


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


def quota(root: Path = _ROOT, own: Path = _OWN) -> float | None:
    """Return the CPU limit of the process's control group in cores, or None without a limit.

    Args:
        root: mount point of the control groups (version 2, or version 1 with a folder per controller).
        own: file with the group of this process in each hierarchy.
    """
    try:
        entries = [line.split(":", 2) for line in own.read_text("utf-8").splitlines()]
        controllers, group = next(e[1:] for e in entries if not e[1] or "cpu" in e[1].split(","))
        top = root / "cpu" if controllers else root
        folder = top / group.lstrip("/")
        folder = folder if folder.is_dir() else top  # a container mounts only its own group
        names = ("cpu.cfs_quota_us", "cpu.cfs_period_us") if controllers else ("cpu.max",)
        limit, period = " ".join((folder / name).read_text("utf-8") for name in names).split()
        return int(limit) / int(period) if int(limit) > 0 else None
    except (OSError, ValueError, StopIteration):  # "max", or no control groups
        return None
