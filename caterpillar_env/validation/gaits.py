"""Gait metrics: speed, flight, slip, body load, joint limits and cost of transport.

They are measured by replaying the simulation in a plain MuJoCo loop that reads every contact.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import mujoco
import numpy as np
from numpy.typing import NDArray

from caterpillar_env.arrays import Array
from caterpillar_env.ground import SKIN
from caterpillar_env.morphology import length_m
from caterpillar_env.physics import GRAVITY_M_S2, SMA_STEP_S
from caterpillar_env.robot import Robot
from caterpillar_env.task import EPISODE_S, Crawl
from caterpillar_env.validation.check import Check, check_at_most


class Gait(NamedTuple):
    """Gait metrics of one robot in an episode."""

    distance_m: float  #: distance along the initial heading
    best_tenth: float  #: share of the distance covered in the best tenth of the gait period
    #: Mean speed after the first third of the gait periods, relative to the mean speed of the episode.
    #: Small values mean that the robot hardly moves after the start.
    settled: float
    peak_speed_m_s: float  #: largest speed of the centre of mass, averaged over 10 ms
    airborne: float  #: share of the distance covered while nothing supports the robot
    slip: float  #: load-weighted sliding distance of the feet, relative to the distance
    body_load: float  #: share of the ground load carried by the elements instead of the feet
    overrun: float  #: largest excess of a joint over its limit, relative to the limit
    cost_of_transport: float  #: electrical energy / (weight * distance)
    body_lengths_s: float  #: speed in body lengths per second


def measure_gait(robot: Robot, duration_s: float = EPISODE_S) -> Gait:
    """Simulate a robot and measure its gait.

    Args:
        robot: robot to simulate.
        duration_s: maximum duration, s, rounded down to whole gait periods, with a minimum of one.
    """
    physics, period_s = robot.physics, robot.timings.period_s
    periods = max(1, int(duration_s / period_s + 1e-9))
    crawl = Crawl([robot.morphology], physics, threads=1, stop_on_failure=False)
    power = np.tile(robot.power(), (1, periods, 1))
    model = crawl.simulation.models[0]
    control = crawl.simulation.heat(power).control[0]
    replay = _replay(model, crawl.simulation.qpos(0), control)
    crawl.run(power)
    end = crawl.progress()
    if not np.array_equal(replay.qpos, crawl.simulation.qpos(0)):
        raise AssertionError("the plain loop does not reproduce the simulation; please report this")

    steps = np.diff(replay.com_m[:: round(SMA_STEP_S / physics.timestep_s)], axis=0)  # thermal steps
    forward_m = steps[:, 0].reshape(periods, -1)
    distance_m = float(end.distance_m[0])
    airborne_m = np.diff(replay.com_m[:, 0]) @ replay.airborne
    settled_m = forward_m[periods // 3 :].sum(axis=1).mean() * periods
    weight_n = GRAVITY_M_S2 * float(model.body_mass.sum())
    body_m = length_m(robot.morphology, physics.num_segments)
    return Gait(
        distance_m=distance_m,
        best_tenth=_cover_best_tenth(forward_m.sum(axis=0)) / distance_m,
        settled=float(settled_m) / distance_m,
        peak_speed_m_s=float(np.linalg.norm(steps, axis=1).max()) / SMA_STEP_S,
        airborne=float(airborne_m) / distance_m,
        slip=replay.slip_m / distance_m,
        body_load=replay.body_load,
        overrun=replay.overrun,
        cost_of_transport=float(end.energy_j[0]) / (weight_n * distance_m),
        body_lengths_s=distance_m / body_m / (periods * period_s),
    )


def _cover_best_tenth(folded: Array) -> float:
    """Return the largest sum over a tenth of a period, which may cross the end of the period."""
    window = len(folded) // 10
    circular = np.concatenate([folded, folded[: window - 1]])
    return float(np.convolve(circular, np.ones(window), mode="valid").max())


class _Replay(NamedTuple):
    """A simulation of K steps; see `Gait` for the load share of the body and the overrun."""

    qpos: Array  #: final positions, (nq,)
    com_m: Array  #: centre of mass before each step and after the last, m, (K + 1, 3)
    airborne: NDArray[np.bool_]  #: whether no contact bears load at the start of a step, (K,)
    slip_m: float  #: load-weighted sliding distance of the feet, m
    body_load: float
    overrun: float


def _replay(model: mujoco.MjModel, start: Array, control: Array) -> _Replay:
    """Step `model` from the positions `start` (nq,), at rest, with `control` (K, springs)."""
    data = mujoco.MjData(model)
    data.qpos[:] = start
    is_skin = model.geom_conaffinity == SKIN
    limits = model.jnt_range[1:, 1]
    com_m = np.empty((len(control) + 1, 3))
    airborne = np.empty(len(control), dtype=bool)
    slip_m, skin_n, all_n, overrun = 0.0, 0.0, 0.0, 0.0
    for step, springs in enumerate(control):
        data.ctrl[:] = springs
        mujoco.mj_step(model, data)  # afterwards, contacts and velocities are those before the step
        com_m[step] = data.subtree_com[1]
        overrun = max(overrun, float(((np.abs(data.qpos[7:]) - limits) / limits).max()))
        contact = data.contact
        active = contact.efc_address >= 0
        part = np.where(model.geom_conaffinity[contact.geom], contact.geom, 0).max(axis=1)[active]
        load_n = data.efc_force[contact.efc_address[active]]
        airborne[step] = not load_n.any()
        skin = is_skin[part]
        skin_n, all_n = skin_n + load_n[skin].sum(), all_n + load_n.sum()
        feet_n = load_n[~skin]
        if (total_n := feet_n.sum()) > 0:
            twist = data.cvel[model.geom_bodyid[part[~skin]]]  # about the robot's centre of mass
            arm = contact.pos[active][~skin] - com_m[step]
            speed = np.hypot(*(twist[:, 3:] + np.cross(twist[:, :3], arm))[:, :2].T)
            slip_m += float(feet_n @ speed / total_n) * model.opt.timestep
    mujoco.mj_forward(model, data)
    com_m[-1] = data.subtree_com[1]
    return _Replay(data.qpos.copy(), com_m, airborne, slip_m, float(skin_n / all_n), max(overrun, 0.0))


def check_gaits(gaits: Sequence[Gait]) -> list[Check]:
    """Check that joints hardly exceed their limits, and that the feet carry the robot."""
    overruns, loads = [g.overrun for g in gaits], [g.body_load for g in gaits]
    name = "largest relative excess of a joint over its limit"
    return [
        check_at_most(f"{name}: median", 0.05, float(np.median(overruns)), ""),
        check_at_most(f"{name}: maximum", 0.15, max(overruns), ""),
        check_at_most("mean body load", 0.05, float(np.mean(loads)), ""),
    ]
