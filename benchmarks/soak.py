"""Endurance of the vector environment with extreme bodies, and of the renderer.

    python -m benchmarks.soak                             # seconds
    python -m benchmarks.soak --steps 62500 --rows 16     # a million robot steps, minutes
    python -m benchmarks.soak --steps 1000000             # hours

Every robot has a body from a corner of the bounds, and gets another one when its episode ends. Its
springs are on for a tenth, half or all of the time. The exit status is 1 if an observation is not in its
space, a reward is not finite, a file stays open, or memory keeps growing.
"""

from __future__ import annotations

import argparse
import itertools
import os
import sys
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np
from gymnasium.vector import AutoresetMode

from benchmarks.harness import report
from caterpillar_env import CaterpillarEnv, CaterpillarVectorEnv
from caterpillar_env.morphology import LOWER, UPPER
from caterpillar_env.task import Failure

DUTIES = (0.1, 0.5, 1.0)
ALLOWED_GROWTH_MB = 60.0  #: in the second half, while the cache of models may still fill


def memory_mb() -> float:
    """Return the resident memory of this process, MB."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


def open_files() -> int:
    """Return the number of open file descriptors of this process."""
    return len(os.listdir("/proc/self/fd"))


def step(steps: int, rows: int, physics: dict[str, Any]) -> dict[str, Any]:
    """Step robots with extreme bodies, and return what went wrong and how memory developed."""
    corners = np.array(list(itertools.product(*zip(LOWER, UPPER, strict=True))))
    env = CaterpillarVectorEnv(
        rows, physics=physics, action_mode="switch", randomization={"friction": (0.1, 2.0)},
        reset_noise_scale=0.02, autoreset_mode=AutoresetMode.DISABLED, threads=1,
    )  # fmt: skip
    rng = np.random.default_rng(0)
    bodies = itertools.cycle(rng.permutation(corners))
    ended, ends, outside, infinite = np.ones(rows, dtype=bool), Counter[str](), 0, 0
    duties, usage, given = np.zeros(rows), [], [corners[0]] * rows
    for number in range(steps):
        if number % max(1, steps // 10) == 0:
            usage.append((memory_mb(), open_files()))
            print(f"{number} steps, {usage[-1][0]:.0f} MB", file=sys.stderr)
        if ended.any():
            given = [next(bodies) if done else body for done, body in zip(ended, given, strict=True)]
            duties[ended] = rng.choice(DUTIES, ended.sum())
            options = {"reset_mask": ended, "morphology": given}
            env.reset(seed=None if number else 0, options=options)
        shape = env.action_space.shape
        observations, rewards, terminated, truncated, info = env.step(
            (rng.random(shape) < duties[:, None]).astype(np.int8)
        )
        outside += not env.observation_space.contains(observations)
        infinite += not (np.isfinite(observations).all() and np.isfinite(rewards).all())
        ended = terminated | truncated
        ends.update(Failure(failure).label for failure in info["failure"][ended])
    env.close()
    usage.append((memory_mb(), open_files()))
    return _summarize("steps", steps, usage) | {
        "robots": rows, "episodes": ends.total(),
        "ends": ", ".join(f"{end} {count}" for end, count in sorted(ends.items())),
        "outside": outside, "not finite": infinite,
    }  # fmt: skip


def render(cycles: int) -> dict[str, Any]:
    """Make, render and close an environment repeatedly, and return how memory developed."""
    usage, frames = [], 0
    for number in range(cycles):
        env = CaterpillarEnv(render_mode="rgb_array", width=64, height=48)
        env.reset(seed=number)
        frames += env.render() is not None
        env.close()
        usage.append((memory_mb(), open_files()))
    return _summarize("cycles", cycles, usage) | {"frames": frames}


def _summarize(unit: str, count: int, usage: list[tuple[float, int]]) -> dict[str, Any]:
    middle, end = usage[len(usage) // 2], usage[-1]
    return {
        unit: count,
        "MB at the start": usage[0][0], "MB halfway": middle[0], "MB at the end": end[0],
        "files halfway": middle[1], "files at the end": end[1],
    }  # fmt: skip


def _failed(row: dict[str, Any]) -> bool:
    grown = row["MB at the end"] - row["MB halfway"] > ALLOWED_GROWTH_MB
    opened = row["files at the end"] > row["files halfway"]
    return bool(grown or opened or row.get("outside") or row.get("not finite"))


def main() -> int:
    """Run the robots and the renderer, and print both tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--steps", type=int, default=1000, help="steps of the vector environment")
    parser.add_argument("--rows", type=int, default=4, help="robots of the vector environment")
    parser.add_argument("--segments", type=int, default=2)
    parser.add_argument("--timestep-s", type=float, default=0.01)
    parser.add_argument("--cycles", type=int, default=200, help="cycles of make, render and close")
    args = parser.parse_args()
    rows = [
        step(args.steps, args.rows, {"num_segments": args.segments, "timestep_s": args.timestep_s}),
        render(args.cycles),
    ]
    report("steps with extreme bodies", rows[:1])
    report("drawing", rows[1:])
    return int(any(map(_failed, rows)))


if __name__ == "__main__":
    sys.exit(main())
