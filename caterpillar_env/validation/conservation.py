"""Conservation of momentum on frictionless ground, and of energy without power."""

from __future__ import annotations

from dataclasses import replace

import mujoco
import numpy as np

from caterpillar_env.arrays import Array
from caterpillar_env.model import build_model
from caterpillar_env.physics import Physics
from caterpillar_env.task import EPISODE_S, Crawl
from caterpillar_env.validation.check import Check, check_at_least, check_at_most
from caterpillar_env.validation.robots import crawl_for, random_robots, stack_power, wave_robots

_TIMESTEPS_S = (0.005, 0.0025, 0.001)


def drift_m(physics: Physics, count: int, duration_s: float) -> Array:
    """Return the centre-of-mass drift of `count` robots without friction, m, (count,)."""
    slippery = replace(physics, friction=0.0)
    robots = stack_power(wave_robots(count, 5, slippery))
    end = crawl_for(duration_s, *robots, slippery, stop_on_failure=False).progress()
    return np.hypot(end.distance_m, end.lateral_m)


def check_momentum(*, quick: bool) -> list[Check]:
    """Check that the drift is proportional to the timestep, and almost zero with Runge-Kutta.

    Without friction there are no horizontal forces, so the centre of mass must not move horizontally.
    The default integrator is of first order in joint coordinates and only approximately conserves
    momentum.
    """
    count, duration_s = (4, 10.0) if quick else (12, EPISODE_S)
    drifts = [
        drift_m(replace(Physics(), timestep_s=timestep_s), count, duration_s)
        for timestep_s in _TIMESTEPS_S
    ]
    middle = np.median(drifts, axis=1)
    order = np.polyfit(np.log(_TIMESTEPS_S), np.log(middle), 1)[0]
    exact = drift_m(replace(Physics(), integrator="rk4", timestep_s=0.0005), count, duration_s)
    seen = ", ".join(
        f"{1000 * d:.2g} mm at {1000 * t:g} ms" for d, t in zip(middle, _TIMESTEPS_S, strict=True)
    )
    return [
        check_at_least(f"order of the drift in the timestep ({seen})", 0.7, float(order), ""),
        check_at_most(
            "largest drift without friction, Runge-Kutta at 0.5 ms", 0.2, 1000 * exact.max(), "mm"
        ),
    ]


def check_energy(*, quick: bool) -> list[Check]:
    """Check that bent robots released without power regain hardly any of the energy that they lose.

    On the ground, soft contacts store energy and return part of it.
    """
    physics = Physics()
    count, duration_s = (6, 2.0) if quick else (20, 5.0)
    bodies = [robot.morphology for robot in random_robots(count, 8, physics)]
    rng = np.random.default_rng(8)
    no_ground = mujoco.mjtDisableBit.mjDSBL_CONTACT | mujoco.mjtDisableBit.mjDSBL_GRAVITY
    steps = round(duration_s / physics.timestep_s)
    in_space, on_ground, excess = [], [], []
    for body in bodies:
        model = build_model(body, physics, scenery=False)
        bent = 0.9 * model.jnt_range[1:, 1] * rng.uniform(-1, 1, model.njnt - 1)
        crawl = Crawl([body], physics, threads=1)
        crawl.reset(offset=bent[None])
        energy_j = _energy(model, crawl.simulation.qpos(0), physics, steps)
        on_ground.append(_regained(energy_j))
        excess.append((energy_j.max() - energy_j[0]) / (energy_j[0] - energy_j[-1]))
        model.opt.disableflags |= no_ground
        in_space.append(_regained(_energy(model, crawl.simulation.qpos(0), physics, steps)))
    name = f"largest rise of the energy of {count} unpowered robots, relative to the total loss"
    return [
        check_at_most(f"{name}: in free space", 1e-4, max(in_space), ""),
        check_at_most(f"{name}: on the soft ground", 0.1, max(on_ground), ""),
        check_at_most(f"{name}: on the ground, above the initial energy", 1e-6, max(excess), ""),
    ]


def _regained(energy_j: Array) -> float:
    """Return the largest rise of the energy, divided by its total loss."""
    return float((energy_j - np.minimum.accumulate(energy_j)).max() / (energy_j[0] - energy_j[-1]))


def _energy(model: mujoco.MjModel, qpos: Array, physics: Physics, steps: int) -> Array:
    """Return the sum of kinetic, gravitational and elastic energy before each step, J, (steps,)."""
    model.opt.enableflags |= mujoco.mjtEnableBit.mjENBL_ENERGY
    data = mujoco.MjData(model)
    data.qpos[:] = qpos
    spring, strengths = physics.spring, physics.strengths()
    full_m = spring.force_limit_n / spring.martensite_stiffness_n_m  # stretch at the force limit
    energy = np.empty(steps)
    for step in range(steps):
        mujoco.mj_step(model, data)
        stretch = np.maximum(data.ten_length - spring.martensite_rest_length_m, 0.0)
        linear = np.minimum(stretch, full_m)
        stored = spring.martensite_stiffness_n_m * linear * (stretch - linear / 2)
        energy[step] = data.energy.sum() + strengths @ stored
    return energy
