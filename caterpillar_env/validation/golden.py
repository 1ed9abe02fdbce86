"""Trajectories kept as data, to see at once when a change touches the physics.

`python -m caterpillar_env.validation.golden` records them anew, after a change that was meant.
"""

from __future__ import annotations

import json
import platform
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from caterpillar_env.arrays import Array
from caterpillar_env.gait import count_steps
from caterpillar_env.physics import SMA_STEP_S, Physics
from caterpillar_env.robot import Robot
from caterpillar_env.task import EPISODE_S, Crawl, label
from caterpillar_env.validation.check import Check
from caterpillar_env.validation.robots import evolved_robots, random_individuals

FILE = Path(__file__).with_name("golden.json")
SAMPLE_S = 3.0  #: time between two recorded points
TOLERANCE_M = 1e-6
_STEADY_M = 1e-8  #: what a nanometre's change of the start may do to a robot that is kept
_KINDS = {"evolved": 4, "random": 2}

ADVICE = (
    "Golden trajectories belong to one version of the physics and of MuJoCo. If you changed the physics "
    "on purpose, let the rest of `caterpillar validate` pass, record them anew with "
    "`python -m caterpillar_env.validation.golden` and say so in CHANGELOG.md. If MuJoCo changed, do so "
    "too; if neither did, find out what moved the robots before anything else."
)


def here() -> str:
    """What trajectories depend on besides this package: MuJoCo's version and the machine's kind."""
    return f"MuJoCo {mujoco.__version__} on {platform.machine()}"


def trajectory(robot: Robot, offset_m: float = 0.0) -> tuple[Array, str]:
    """Centre of mass every `SAMPLE_S` of an episode, (10, 3), and the verdict.

    `offset_m` displaces every internal joint at the start.
    """
    crawl = Crawl([robot.morphology], robot.physics)
    if offset_m:
        crawl.reset(offset=np.full_like(crawl.simulation.state().joint_position, offset_m))
    period = robot.timings.mirrored().power(SMA_STEP_S)
    power = np.tile(period, (count_steps(EPISODE_S, robot.timings.period_s, "an episode"), 1))
    sample = count_steps(SAMPLE_S, SMA_STEP_S, "the time between two points")
    points = []
    for first in range(0, len(power), sample):
        crawl.run(power[None, first : first + sample])
        points.append(crawl.simulation.state().com_m[0])
    return np.array(points), label(crawl.failure[0])


def record(path: Path = FILE) -> None:
    """Write `path`: the first few robots of each kind that are not sensitive to rounding."""
    kept: list[dict[str, Any]] = []
    drawn = random_individuals(50, 11, Physics())
    for kind, robots in (("evolved", evolved_robots()), ("random", drawn)):
        for index, robot in enumerate(robots):
            points, verdict = trajectory(robot)
            if np.abs(trajectory(robot, 1e-9)[0] - points).max() < _STEADY_M:
                kept.append(
                    {
                        "name": f"{kind} {index}",
                        "verdict": verdict,
                        "com_m": points.tolist(),
                        "robot": robot.to_dict(),
                    }
                )
            if sum(entry["name"].startswith(kind) for entry in kept) == _KINDS[kind]:
                break
    data = {"recorded_with": here(), "sample_s": SAMPLE_S, "trajectories": kept}
    path.write_text(json.dumps(data, indent=1) + "\n", encoding="utf-8")


def checks(path: Path = FILE) -> list[Check]:
    """Every recorded trajectory, simulated once more."""
    data = json.loads(path.read_text("utf-8"))
    found = []
    for entry in data["trajectories"]:
        points, verdict = trajectory(Robot.from_dict(entry["robot"]))
        off_m = float(np.abs(points - np.array(entry["com_m"])).max())
        found.append(
            Check(
                f"trajectory of robot {entry['name']}",
                f"{entry['verdict']}, as with {data['recorded_with']}",
                f"{verdict}, off by {1000 * off_m:.3g} mm with {here()}",
                f"{1000 * TOLERANCE_M:g} mm",
                verdict == entry["verdict"] and off_m <= TOLERANCE_M,
            )
        )
    return found


if __name__ == "__main__":
    record()
