"""What a physics step costs, by part and by setting, one thread: `python -m benchmarks.physics_step`."""

from __future__ import annotations

import argparse
import copy
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import mujoco

from benchmarks.harness import report, rounds, spread, timed
from caterpillar_env.physics import SMA_STEP_S, Physics
from caterpillar_env.task import Crawl
from caterpillar_env.validation.recorder import EngineCalls, recorded
from caterpillar_env.validation.robots import evolved_robots, together

SECONDS = 5.0
SETTINGS: dict[str, dict[str, Any]] = {
    "as it is": {},
    "CG": {"solver": "cg"},
    "pyramidal cone": {"cone": "pyramidal"},
    "tolerance 1e-6": {"solver_tolerance": 1e-6},
    "tolerance 1e-10": {"solver_tolerance": 1e-10},
    "implicitfast": {"integrator": "implicitfast"},
    "timestep 5 ms": {"timestep_s": 0.005},
    "timestep 10 ms": {"timestep_s": 0.01},
}


def recording(**changes: Any) -> EngineCalls:
    """The engine's calls of one gait period."""
    physics = replace(Physics(), **changes)
    bodies, timings = together(evolved_robots(8))
    power = timings.mirrored().power(SMA_STEP_S)
    crawl = Crawl(bodies, physics)
    with recorded(crawl.simulation) as calls:
        crawl.run(power[:, : round(SECONDS / SMA_STEP_S)])
    return calls


def cost(
    calls: EngineCalls, edit: Callable[[mujoco.MjModel], None] | None = None
) -> Callable[[], float]:
    """Seconds per step, the models edited first."""
    if edit is not None:
        calls = copy.copy(calls)
        calls.models = [copy.copy(model) for model in calls.models]
        for model in calls.models:
            edit(model)

    def run() -> float:
        batch = calls.batch(threads=1)
        return timed(lambda: calls.repeat(batch)) / calls.steps

    return run


def untrimmed(model: mujoco.MjModel) -> None:
    """The springs' Jacobians as MuJoCo builds them, with a column for every joint up to the root."""
    for tendon in range(model.ntendon):
        first = model.tendon_adr[tendon]
        last = int(model.site_bodyid[model.wrap_objid[first : first + 2]].max())
        columns = [dof for dof in range(model.nv) if model.dof_bodyid[dof] <= last]
        address = model.ten_J_rowadr[tendon]
        model.ten_J_colind[address : address + len(columns)] = columns
        model.ten_J_rownnz[tendon] = len(columns)


def disable(*flags: str) -> Callable[[mujoco.MjModel], None]:
    """Switch off parts of the engine."""

    def edit(model: mujoco.MjModel) -> None:
        for flag in flags:
            model.opt.disableflags |= getattr(mujoco.mjtDisableBit, f"mjDSBL_{flag.upper()}")

    return edit


def enable(*flags: str) -> Callable[[mujoco.MjModel], None]:
    """Switch on parts of the engine that are off."""

    def edit(model: mujoco.MjModel) -> None:
        for flag in flags:
            model.opt.disableflags &= ~getattr(mujoco.mjtDisableBit, f"mjDSBL_{flag.upper()}").value

    return edit


def first_version(model: mujoco.MjModel) -> None:
    """All savings of the engine's step undone, but for the solver."""
    untrimmed(model)
    enable("island", "midphase")(model)


def main() -> None:
    """One table: settings, then parts left out."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=7)
    args = parser.parse_args()
    as_it_is = recording()
    contestants = {name: cost(recording(**changes)) for name, changes in SETTINGS.items()}
    contestants |= {
        "islands and midphase on": cost(as_it_is, enable("island", "midphase")),
        "springs' Jacobians not trimmed": cost(as_it_is, untrimmed),
        "all three: CG, none of these savings": cost(recording(solver="cg"), first_version),
        "without contacts": cost(as_it_is, disable("contact")),
        "without contacts and joint limits": cost(as_it_is, disable("constraint")),
        "and without springs": cost(as_it_is, disable("constraint", "actuation")),
    }
    costs = rounds(contestants, args.repeats)
    rows = [
        {
            "setting": name,
            "us per step": spread(1e6 * values),
            "over as it is": spread(values / costs["as it is"]),
        }
        for name, values in costs.items()
    ]
    report("cost of a physics step", rows)


if __name__ == "__main__":
    main()
