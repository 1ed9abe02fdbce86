"""Golden trajectories: stored results that detect any change of the physics.

To record them again after an intended change, run `python -m caterpillar_env.validation.golden`.
"""

from __future__ import annotations

import json
import platform
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from caterpillar_env.arrays import Array
from caterpillar_env.physics import Physics
from caterpillar_env.robot import Robot, repeat
from caterpillar_env.task import EPISODE_S, Crawl, Failure
from caterpillar_env.validation.check import Check
from caterpillar_env.validation.robots import evolved_robots, random_robots

FILE = Path(__file__).with_name("golden.json")
SAMPLE_S = 3.0  #: time between recorded points, s
PLATFORM = f"MuJoCo {mujoco.__version__} on {platform.machine()}"  #: trajectories depend on both
TOLERANCE_M = 1e-6  #: maximum deviation of a coordinate, m
_STEADY_M = 1e-8  #: limit on the effect of adding 1e-9 to all initial joint positions of a robot
_KINDS = {"evolved": 4, "random": 2}

ADVICE = (
    "Golden trajectories are valid for one version of the physics and of MuJoCo. If you changed either "
    "intentionally and all other checks of `caterpillar validate` pass, record the trajectories again "
    "with `python -m caterpillar_env.validation.golden` and note the change in CHANGELOG.md. Otherwise "
    "find the cause of the difference first."
)


def compute_trajectory(robot: Robot, offset_m: float = 0.0) -> tuple[Array, str]:
    """Return the centre of mass at intervals of `SAMPLE_S`, m, (10, 3), and the failure.

    `offset_m` is added to the initial position of every internal joint (in rad for hinges).
    """
    crawl = Crawl([robot.morphology], robot.physics)
    if offset_m:
        crawl.reset(offset=np.full_like(crawl.simulation.state().joint_position, offset_m))
    points = []
    power = robot.power()[None]
    for end in range(1, round(EPISODE_S / SAMPLE_S) + 1):
        repeat(crawl, power, end * SAMPLE_S)
        points.append(crawl.simulation.state().com_m[0])
    return np.array(points), Failure(crawl.failure[0]).label


def record(path: Path = FILE) -> None:
    """Write the trajectories of the first robots of each kind that are insensitive to rounding."""
    entries: list[dict[str, Any]] = []
    for kind, robots in (("evolved", evolved_robots()), ("random", random_robots(50, 11, Physics()))):
        count = 0
        for index, robot in enumerate(robots):
            points, failure = compute_trajectory(robot)
            if np.abs(compute_trajectory(robot, 1e-9)[0] - points).max() < _STEADY_M:
                entry = {"name": f"{kind} {index}", "verdict": failure, "com_m": points.tolist()}
                entries.append({**entry, "robot": robot.to_dict()})
                count += 1
            if count == _KINDS[kind]:
                break
    data = {"recorded_with": PLATFORM, "sample_s": SAMPLE_S, "trajectories": entries}
    path.write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")


def check_trajectories(path: Path = FILE) -> list[Check]:
    """Check that the recorded robots still have the recorded trajectories."""
    data = json.loads(path.read_text("utf-8"))
    found = []
    for entry in data["trajectories"]:
        points, failure = compute_trajectory(Robot.from_dict(entry["robot"]))
        off_m = float(np.abs(points - np.array(entry["com_m"])).max())
        found.append(
            Check(
                f"trajectory of robot {entry['name']}",
                f"{entry['verdict']}, recorded with {data['recorded_with']}",
                f"{failure}, off by {1000 * off_m:.3g} mm with {PLATFORM}",
                f"{1000 * TOLERANCE_M:g} mm",
                failure == entry["verdict"] and off_m <= TOLERANCE_M,
            )
        )
    return found


if __name__ == "__main__":
    record()
