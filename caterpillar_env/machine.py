"""What this machine lets us have of its processor."""

from __future__ import annotations

import os
import platform
from collections.abc import Iterator
from pathlib import Path

_GROUPS, _OURS = Path("/sys/fs/cgroup"), Path("/proc/self/cgroup")


def processor() -> str:
    """Its name, as far as the system tells."""
    try:
        lines = Path("/proc/cpuinfo").read_text("utf-8").splitlines()
    except OSError:
        lines = []
    names = [line.split(":", 1)[1].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor() or platform.machine()


def cores() -> int:
    """How many cores this process may run on: what 0 threads stands for."""
    return len(os.sched_getaffinity(0))


def quota(groups: Path = _GROUPS, ours: Path = _OURS) -> float | None:
    """How many cores' time control groups grant us (a container's limit); None if there is no limit.

    Args:
        groups: where control groups are mounted, of version 2 or 1.
        ours: the file that tells our group in each hierarchy.
    """
    try:
        lines = ours.read_text("utf-8").splitlines()
    except OSError:
        return None
    limits = [limit for line in lines for limit in _limits(groups, *line.split(":", 2)[1:])]
    return min(limits, default=None)


def _limits(groups: Path, controllers: str, group: str) -> Iterator[float]:
    """Of a group and those above it; inside a container the mount begins at our own."""
    if controllers and "cpu" not in controllers.split(","):
        return
    root = groups / controllers if controllers and (groups / controllers).is_dir() else groups
    root = root / "cpu" if controllers and (root / "cpu").is_dir() else root
    place = root / group.lstrip("/")
    for folder in (place, *place.parents):
        if folder.is_relative_to(root):
            limit = _limit(folder)
            if limit is not None:
                yield limit


def _limit(folder: Path) -> float | None:
    try:
        if (folder / "cpu.max").exists():
            granted, period = (folder / "cpu.max").read_text("utf-8").split()
        else:
            granted = (folder / "cpu.cfs_quota_us").read_text("utf-8").strip()
            period = (folder / "cpu.cfs_period_us").read_text("utf-8").strip()
    except (OSError, ValueError):
        return None
    return None if granted in ("max", "-1") else int(granted) / int(period)
