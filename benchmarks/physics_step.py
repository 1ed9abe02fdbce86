"""Cost of a physics step by part and setting on one thread: `python -m benchmarks.physics_step`."""

from __future__ import annotations

import argparse
import copy
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import mujoco

from benchmarks.harness import report, rounds, spread, timed
from caterpillar_env.physics import Physics
from caterpillar_env.task import Crawl
from caterpillar_env.validation.convergence import SETTINGS
from caterpillar_env.validation.recorder import EngineCalls, record_calls
from caterpillar_env.validation.robots import evolved_robots, stack_power

#: Settings of `convergence.SETTINGS` to compare.
COMPARED = (
    "CG", "pyramidal cone", "tolerance 1e-6", "tolerance 1e-10", "implicitfast", "timestep 5 ms",
    "timestep 10 ms",
)  # fmt: skip


def record_period(**changes: Any) -> EngineCalls:
    """Record the engine calls in one gait period of eight evolved robots."""
    physics = replace(Physics(), **changes)
    bodies, power = stack_power(evolved_robots(8))
    crawl = Crawl(bodies, physics)
    with record_calls(crawl.simulation) as calls:
        crawl.run(power)
    return calls


def cost(
    calls: EngineCalls, edit: Callable[[mujoco.MjModel], None] | None = None
) -> Callable[[], float]:
    """Return a function that times a step of the edited models, s."""
    if edit is not None:
        calls = copy.copy(calls)
        calls.models = [copy.copy(model) for model in calls.models]
        for model in calls.models:
            edit(model)

    def run() -> float:
        batch = calls.make_batch(threads=1)
        return timed(lambda: calls.repeat(batch)) / calls.steps

    return run


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


def undo_savings(model: mujoco.MjModel) -> None:
    """Undo all optimizations of the engine step except the choice of solver."""
    undo_trimming(model)
    switch("island", "midphase", on=True)(model)


def main() -> None:
    """Run the benchmark and print its table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=7)
    args = parser.parse_args()
    settings: dict[str, dict[str, Any]] = {"as it is": {}} | {name: SETTINGS[name] for name in COMPARED}
    as_it_is = record_period()
    cases = {name: cost(record_period(**changes)) for name, changes in settings.items()}
    cases |= {
        "islands and midphase on": cost(as_it_is, switch("island", "midphase", on=True)),
        "springs' Jacobians not trimmed": cost(as_it_is, undo_trimming),
        "all three: CG, none of these savings": cost(record_period(solver="cg"), undo_savings),
        "without contacts": cost(as_it_is, switch("contact", on=False)),
        "without contacts and joint limits": cost(as_it_is, switch("constraint", on=False)),
        "and without springs": cost(as_it_is, switch("constraint", "actuation", on=False)),
    }
    costs = rounds(cases, args.repeats)
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
