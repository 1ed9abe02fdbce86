"""Cost of a physics step by part and setting on one thread: `python -m benchmarks.physics_step`."""

from __future__ import annotations

import argparse
import copy
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import mujoco
import numpy as np

from benchmarks.harness import Step, report, spread, time_steps
from benchmarks.recorder import EngineCalls, record_calls
from caterpillar_env.physics import Physics
from caterpillar_env.task import Crawl
from caterpillar_env.validation.robots import evolved_robots, stack_power

STEPS = 10  #: parts of the gait period; the settings take turns after each


def record_period(**changes: Any) -> EngineCalls:
    """Record the engine calls in one gait period of eight evolved robots."""
    bodies, power = stack_power(evolved_robots(8))
    crawl = Crawl(bodies, replace(Physics(), **changes))
    parts = np.split(power, STEPS, axis=1)
    return record_calls(crawl.simulation, lambda number: crawl.run(parts[number]), STEPS)


def edit_models(calls: EngineCalls, *edits: Callable[[mujoco.MjModel], None]) -> EngineCalls:
    """Return the same calls for edited copies of the models."""
    models = [copy.copy(model) for model in calls.models]
    for model in models:
        for edit in edits:
            edit(model)
    return replace(calls, models=models)


def undo_trimming(model: mujoco.MjModel) -> None:
    """Restore MuJoCo's spring Jacobians, which have a column for every joint up to the root."""
    for tendon in range(model.ntendon):
        first = model.tendon_adr[tendon]
        last = int(model.site_bodyid[model.wrap_objid[first : first + 2]].max())
        columns = [dof for dof in range(model.nv) if model.dof_bodyid[dof] <= last]
        address = model.ten_J_rowadr[tendon]
        model.ten_J_colind[address : address + len(columns)] = columns
        model.ten_J_rownnz[tendon] = len(columns)


def switch(*flags: str, on: bool) -> Callable[[mujoco.MjModel], None]:
    """Return an edit that switches parts of the engine on or off."""
    bits = sum(getattr(mujoco.mjtDisableBit, f"mjDSBL_{flag.upper()}").value for flag in flags)

    def edit(model: mujoco.MjModel) -> None:
        disabled = model.opt.disableflags | bits
        model.opt.disableflags = disabled & ~bits if on else disabled

    return edit


def main() -> None:
    """Run the benchmark and print its table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=7)
    args = parser.parse_args()
    default, cg = record_period(), record_period(solver="cg")
    searches = switch("island", "midphase", on=True)
    cases = {
        "default": default,
        "islands and midphase on": edit_models(default, searches),
        "springs' Jacobians not trimmed": edit_models(default, undo_trimming),
        "conjugate gradients instead of Newton": cg,
        "all three": edit_models(cg, searches, undo_trimming),
        "without contacts": edit_models(default, switch("contact", on=False)),
        "without contacts and joint limits": edit_models(default, switch("constraint", on=False)),
        "without contacts, joint limits and springs": edit_models(
            default, switch("constraint", "actuation", on=False)
        ),
        "timestep 5 ms": record_period(timestep_s=0.005),
    }

    def begin(calls: EngineCalls) -> Callable[[], Step]:
        return lambda: calls.begin(threads=1)

    seconds = time_steps({name: begin(calls) for name, calls in cases.items()}, STEPS, args.repeats)
    costs = {name: seconds[name] * STEPS / calls.physics_steps for name, calls in cases.items()}
    rows = [
        {
            "setting": name,
            "us per step": spread(1e6 * cost),
            "relative to the default": spread(cost / costs["default"]),
        }
        for name, cost in costs.items()
    ]
    report("cost of a physics step", rows)


if __name__ == "__main__":
    main()
