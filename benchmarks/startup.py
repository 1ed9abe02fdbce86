"""Time of imports, `--help` and reset with a new body: `python -m benchmarks.startup`."""

from __future__ import annotations

import argparse
import subprocess
import sys
from collections.abc import Callable

import numpy as np

from benchmarks.harness import report, rounds, spread, timed
from caterpillar_env.physics import Physics
from caterpillar_env.task import Crawl
from caterpillar_env.validation.robots import random_robots


def process(*argv: str) -> Callable[[], float]:
    """Return a function that times a new Python process, s."""
    command = [sys.executable, *argv]
    return lambda: timed(lambda: subprocess.run(command, check=True, stdout=subprocess.DEVNULL))


def resets(repeats: int, *, new_body: bool) -> Callable[[], float]:
    """Return a function that times a reset of one robot, s, with a new body or the same body."""
    physics = Physics()
    bodies = [robot.morphology for robot in random_robots(50 * repeats, 0, physics)]
    crawl = Crawl(bodies[:1], physics)
    waiting = iter(bodies)

    def work() -> None:
        for _ in range(50):
            crawl.reset([next(waiting)] if new_body else bodies[:1])

    return lambda: timed(work) / 50


def main() -> None:
    """Run the benchmark and print its table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=11)
    args = parser.parse_args()
    costs = rounds(
        {
            "import gymnasium, mujoco": process("-c", "import gymnasium, mujoco"),
            "and caterpillar_env": process("-c", "import gymnasium, mujoco, caterpillar_env"),
            "caterpillar --help": process("-c", "from evolution.cli import main; main()", "--help"),
            "reset, new body": resets(args.repeats, new_body=True),
            "reset, same body": resets(args.repeats, new_body=False),
        },
        args.repeats,
    )
    added = costs["and caterpillar_env"] - costs["import gymnasium, mujoco"]
    rows = [{"what": name, "ms": spread(1e3 * np.asarray(cost))} for name, cost in costs.items()]
    rows.insert(2, {"what": "added by caterpillar_env", "ms": spread(1e3 * added)})
    report("start-up and reset", rows)


if __name__ == "__main__":
    main()
