"""Checks of the mechanics: statics, friction, symmetries, rest and failure detection."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import replace

import mujoco
import numpy as np
from scipy.optimize import brentq

from caterpillar_env.arrays import Array
from caterpillar_env.model import build_model
from caterpillar_env.morphology import Morphology
from caterpillar_env.physics import GRAVITY_M_S2, SMA_STEP_S, Physics
from caterpillar_env.robot import Robot, simulate, stack
from caterpillar_env.sma import spring_force
from caterpillar_env.task import EPISODE_S, Crawl, Failure, Progress
from caterpillar_env.validation.check import (
    Check,
    check_at_least,
    check_at_most,
    check_equal,
    check_near,
)
from caterpillar_env.validation.robots import crawl_for, random_robots, stack_power
from caterpillar_env.worlds import Slope


def check_statics() -> list[Check]:
    """Check spring forces, deflections, weight and friction."""
    return [_spring_forces(), *_deflections(), *_standing(), *_slope()]


def _nominal_robot(physics: Physics) -> tuple[mujoco.MjModel, mujoco.MjData]:
    model = build_model(Morphology(), physics)
    return model, mujoco.MjData(model)


def _step(model: mujoco.MjModel, data: mujoco.MjData, duration_s: float) -> None:
    mujoco.mj_step(model, data, nstep=round(duration_s / model.opt.timestep))


def _spring_forces() -> Check:
    physics = Physics()
    model, data = _nominal_robot(physics)
    rng = np.random.default_rng(0)
    worst = 0.0
    for _ in range(50):
        data.qpos[7:] = rng.uniform(*model.jnt_range[1:].T)
        data.ctrl[:] = rng.random(model.nu)
        mujoco.mj_forward(model, data)
        expected = -physics.strengths() * spring_force(physics.spring, data.ten_length, data.ctrl)
        worst = max(worst, float(np.abs(data.actuator_force - expected).max()))
    return check_at_most("spring force against the two-state formula, 600 values", 1e-12, worst, "N")


def _deflections() -> list[Check]:
    """Check that a joint under a constant load deflects until its stiffness balances the load."""
    physics = Physics()
    neck = physics.neck_stiffness_n_m_rad
    bend = physics.bend_ratio * neck
    cubic = physics.neck_stiffening / Morphology().joint_limit_rad ** 2
    off = mujoco.mjtDisableBit
    checks = []
    for joint, load, linear, power3, unit, of in (
        ("neck1", 1e-3, neck, neck * cubic, "rad", "N m"),
        ("bend1", 2e-3, bend, bend * cubic, "rad", "N m"),
        ("axial3", 0.5, physics.axial_stiffness_n_m, 0.0, "m", "N"),
    ):
        model, data = _nominal_robot(physics)
        model.opt.disableflags |= off.mjDSBL_GRAVITY | off.mjDSBL_CONTACT | off.mjDSBL_ACTUATION
        data.qfrc_applied[model.joint(joint).dofadr[0]] = load
        excess = np.polynomial.Polynomial([-load, linear, 0.0, power3])
        expected = brentq(excess, 0.0, 1.0)
        _step(model, data, 10.0)
        got = float(data.qpos[model.joint(joint).qposadr[0]])
        name = f"deflection of {joint} under {load:g} {of}"
        checks.append(check_near(name, expected, got, unit, rel=1e-3))
    return checks


def _standing() -> list[Check]:
    """Check that the ground carries the weight of an unpowered robot, and that the robot sags little."""
    physics = Physics()
    model, data = _nominal_robot(physics)
    _step(model, data, 10.0)
    borne = float(data.qfrc_constraint[2])  # vertical force of all contacts
    weight = GRAVITY_M_S2 * float(model.body_mass.sum())
    sag = 1000 * (2 * Morphology().segment_radius_m - float(data.subtree_com[1, 2]))
    # The penetration at rest is g (1 - d) / (d k), with k = 1 / (d_max timeconst)^2 and impedance d.
    softest, stiffest = 0.9, 0.95
    k = 1 / (stiffest * physics.contact_time_constant_s) ** 2
    yielding = 1000 * GRAVITY_M_S2 * (1 - softest) / (softest * k)
    return [
        check_near("ground load at rest, equal to the weight", weight, borne, "N", rel=2e-3),
        check_at_most("static sag of the centre of mass", 1.5 * yielding, sag, "mm"),
        check_at_least("static sag of the centre of mass", 0.3 * yielding, sag, "mm"),
    ]  # fmt: skip


def _slope() -> list[Check]:
    """Check that an unpowered robot slides on a slope only beyond an angle of atan(mu).

    The body is stiff, so it slides as a block. The block chatters, so the check uses impulses over half
    a second. The friction impulse is mu times the normal impulse, which includes the change of the
    normal velocity. Later the block turns, and friction no longer points along the slope.
    """
    checks = []
    friction, duration_s = 0.4, 0.5
    stiff = replace(Physics(), friction=friction, neck_stiffness_n_m_rad=1.0, neck_damping_n_m_s_rad=0.1)
    for share in (0.98, 1.05, 1.1, 1.25):
        model, data = _nominal_robot(stiff)
        _step(model, data, 2.0)  # let the robot come to rest on level ground
        angle = math.atan(share * friction)
        slope = Slope(angle_deg=math.degrees(angle), direction="down")
        model.opt.gravity[:] = -GRAVITY_M_S2 * np.array(slope.up)
        _step(model, data, 0.5)
        start_m, before = float(data.subtree_com[1, 0]), _com_velocity(model, data)
        _step(model, data, duration_s)
        moved, gained = float(data.subtree_com[1, 0]) - start_m, _com_velocity(model, data) - before
        name = f"foot on a slope of {share:g} mu"
        if share < 1:
            checks.append(check_at_most(f"{name} sticks: sliding in 0.5 s", 0.1, 1000 * moved, "mm"))
        else:
            pull = GRAVITY_M_S2 * (math.sin(angle) - friction * math.cos(angle))
            got = float(gained[0] + friction * gained[2]) / duration_s
            checks.append(check_near(f"{name} slides: acceleration", pull, got, "m/s2", rel=0.01))
    return checks


def _com_velocity(model: mujoco.MjModel, data: mujoco.MjData) -> Array:
    """Return the centre-of-mass velocity, m/s, (3,)."""
    mujoco.mj_forward(model, data)
    mujoco.mj_subtreeVel(model, data)
    velocity: Array = data.subtree_linvel[1].copy()
    return velocity


def check_symmetries(*, quick: bool) -> list[Check]:
    """Check straight crawling without mismatch, independence of the heading, and mirror symmetry.

    Stick-slip and the limited solver tolerance amplify rounding errors. The tolerance of these checks is
    therefore the intrinsic spread: the effect of moving the start of the same robots by a micrometre.
    """
    count, duration_s = (10, 5.0) if quick else (20, EPISODE_S)
    perfect, uneven = Physics(mismatch_std=0.0), Physics()
    swapped = uneven.strengths().reshape(-1, 2)[:, ::-1].ravel()  # left for right
    mirrored = replace(uneven, spring_strengths=tuple(swapped.tolist()))
    bodies, power = stack_power(random_robots(count, 1, perfect))

    def crawl(physics: Physics, heading_rad: float = 0.0, offset_m: float = 0.0) -> Progress:
        return crawl_for(
            duration_s, bodies, power, physics, heading_rad=heading_rad, offset_m=offset_m
        ).progress()

    def distances_mm(a: Progress, b: Progress, side: float = 1.0) -> Array:
        return 1000 * np.hypot(a.distance_m - b.distance_m, a.lateral_m - side * b.lateral_m)

    def spread_mm(physics: Physics, base: Progress) -> Array:
        ends = [distances_mm(crawl(physics, offset_m=offset_m), base) for offset_m in (1e-6, -1e-6)]
        return np.asarray(np.max(ends, axis=0))

    straight, turned = crawl(perfect), crawl(perfect, heading_rad=1.0)
    left, right = crawl(uneven), crawl(mirrored)
    perfect_mm, uneven_mm = spread_mm(perfect, straight), spread_mm(uneven, left)
    checks = []
    for what, got_mm, intrinsic_mm in (
        ("lateral drift without mismatch", 1000 * np.abs(straight.lateral_m), perfect_mm),
        ("yawed start vs. straight start", distances_mm(straight, turned), perfect_mm),
        ("mirrored mismatch vs. mirrored path", distances_mm(left, right, side=-1.0), uneven_mm),
    ):
        allowed_mm = np.maximum(intrinsic_mm, 1e-3)  # ignore differences below 1 um
        median_mm, limit_mm = float(np.median(got_mm)), float(np.median(allowed_mm))
        # Robots buckle to either side by chance, so one in ten may exceed the tolerance.
        beyond = float((got_mm > allowed_mm).mean())
        checks += [
            check_at_most(f"{what}: median", limit_mm, median_mm, "mm"),
            check_at_most(f"{what}: share of robots beyond their intrinsic spread", 0.1, beyond, ""),
        ]
    return checks


def check_rest(*, quick: bool) -> list[Check]:
    """Check that robots come to rest without power and with full power, and then hardly creep.

    Some robots lean over slowly and buckle first, so the check begins after a minute.
    """
    count, settle_s, watch_s = (4, 60.0, 10.0) if quick else (60, 60.0, 30.0)
    physics = Physics()
    bodies, _ = stack(random_robots(count, 2, physics))
    checks = []
    for share, word in ((0.0, "power off"), (1.0, "all springs hot")):
        power = np.full((count, round(watch_s / SMA_STEP_S), physics.num_springs), share)
        crawl = crawl_for(settle_s, bodies, power, physics, stop_on_failure=False)
        before = crawl.simulation.state()
        crawl.run(power)
        after = crawl.simulation.state()
        creep = 1000 * np.linalg.norm(after.com_m - before.com_m, axis=1) * (30.0 / watch_s)
        speed = 1000 * np.abs(after.velocity[:, :3]).max()
        checks += [
            check_at_most(
                f"{word}: creep of the centre of mass in 30 s at rest", 1.0, creep.max(), "mm"
            ),
            check_at_most(f"{word}: speed of any element at the end", 0.2, float(speed), "mm/s"),
        ]
    return checks


def check_failures(healthy: Sequence[Robot]) -> list[Check]:
    """Check that flipped, tipped, jumped and veered robots fail, and that healthy robots do not."""
    physics = Physics()
    poses = {
        # height of the head centre (m), roll, yaw (rad)
        "flipped": (0.013, math.pi, 0.0),
        "tipped": (0.016, math.pi / 2, 0.0),
        "jumped": (0.124, 0.0, 0.0),
        "veered": (0.024, 0.0, math.radians(60)),
        "ok": (0.024, 0.0, math.radians(20)),
    }
    crawl = Crawl([Morphology()] * len(poses), physics)
    qpos = np.stack([crawl.simulation.qpos(row) for row in range(len(poses))])
    for row, (height, roll, yaw) in enumerate(poses.values()):
        qpos[row, 2] = height
        mujoco.mju_euler2Quat(qpos[row, 3:7], [roll, 0, yaw], "XYZ")
    crawl.simulation.place(qpos)
    crawl.run(np.zeros((len(poses), 10, physics.num_springs)))
    checks = []
    for name, code in zip(poses, crawl.failure, strict=True):
        words = "upright, 20 degrees off" if name == "ok" else name
        checks.append(check_equal(f"robot placed {words}", name, Failure(int(code)).label))
    found = {Failure(int(code)).label for code in simulate(*stack(healthy), physics).failure}
    evolved = check_equal(f"outcomes of {len(healthy)} evolved robots", ["ok"], sorted(found))
    return [*checks, evolved]
