"""Cost of environment steps relative to the bare engine and to alternatives.

    python -m benchmarks.environments           # about fifteen minutes on two cores
    python -m benchmarks.environments --single  # only the single environments

All cases make the same physics steps: the bare engine repeats the recorded engine calls of our
environment.
"""

from __future__ import annotations

import argparse
import itertools
import sys
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import gymnasium
import mujoco
import numpy as np
from gymnasium.vector import AsyncVectorEnv, SyncVectorEnv

import caterpillar_env  # noqa: F401  registers the environments
from benchmarks.harness import report, spread, turns
from caterpillar_env.arrays import Array
from caterpillar_env.physics import SMA_STEP_S, Physics
from caterpillar_env.sma import SmaState, advance
from caterpillar_env.validation.recorder import record_calls

IDS = {"switch": "CaterpillarSMASwitch-v0", "timing": "CaterpillarSMA-v0"}
SEED = 0


def sample_actions(space: gymnasium.Space[Any], count: int) -> list[Any]:
    """Return `count` random actions. They are the same in every call."""
    space.seed(SEED)
    return [space.sample() for _ in range(count)]


def run(env: Any, actions: list[Any]) -> Callable[[], Callable[[int], Any]]:
    """Return a benchmark case for `harness.turns` that resets an environment and steps it."""

    def begin() -> Callable[[int], Any]:
        env.reset(seed=SEED)
        return lambda number: env.step(actions[number])

    return begin


class EngineSteps:
    """Engine calls of an environment, grouped by step."""

    def __init__(self, env: Any, actions: list[Any]) -> None:
        env.reset(seed=SEED)
        ends = [0]
        with record_calls(env.unwrapped.crawl.simulation) as self.calls:
            for action in actions:
                env.step(action)
                ends.append(len(self.calls.calls))
        self.spans = list(itertools.pairwise(ends))

    def repeat(self, threads: int) -> Callable[[], Callable[[int], Any]]:
        """Return a benchmark case that makes only the engine calls."""

        def begin() -> Callable[[int], Any]:
            batch = self.calls.make_batch(threads)
            return lambda number: self.calls.repeat(batch, *self.spans[number])

        return begin


def vector(mode: str, count: int, steps: int, repeats: int) -> dict[str, Any]:
    """Compare `make_vec` with the bare Batch, SyncVectorEnv and AsyncVectorEnv."""
    native: Any = gymnasium.make_vec(IDS[mode], num_envs=count, threads=0)
    single = gymnasium.make_vec(IDS[mode], num_envs=count, threads=1)
    actions = sample_actions(native.action_space, steps)
    cases = {
        "native": run(native, actions),
        "bare": EngineSteps(native, actions).repeat(0),
        "1 thread": run(single, actions),
    }
    peers: list[Any] = []
    makers = [lambda: gymnasium.make(IDS[mode])] * count
    if count <= 256:
        peers.append(SyncVectorEnv(makers))
        cases["sync"] = run(peers[-1], actions)
    if count <= 64:
        peers.append(AsyncVectorEnv(makers))
        cases["async"] = run(peers[-1], actions)
    costs = turns(cases, steps, repeats)
    for env in (native, single, *peers):
        env.close()
    row: dict[str, Any] = {
        "mode": mode,
        "envs": count,
        "share of bare": spread(costs["bare"] / costs["native"]),
        "2 threads over 1": spread(costs["1 thread"] / costs["native"]),
    }
    for peer in ("sync", "async"):
        row[f"over {peer}"] = spread(costs[peer] / costs["native"]) if peer in costs else "not run"
    row["ms per step"] = spread(1e3 * costs["native"])
    return row


def single(mode: str, steps: int, repeats: int) -> dict[str, Any]:
    """Compare `gymnasium.make` with loops over `mj_step`, without and with the spring model."""
    env: Any = gymnasium.make(IDS[mode])
    actions = sample_actions(env.action_space, steps)
    repeated = EngineSteps(env, actions)
    model = repeated.calls.models[0]
    controls = [
        np.concatenate([call["control"][0] for _, call in repeated.calls.calls[first:last]])
        for first, last in repeated.spans
    ]
    costs = turns(
        {
            "ours": run(env, actions),
            "bare": lambda: _steps(model, controls),
            "batch": repeated.repeat(1),
            "plain": lambda: _plain(env.unwrapped.crawl.physics, model, controls),
        },
        steps,
        repeats,
    )
    return {
        "environment": IDS[mode],
        "share of bare mj_step": spread(costs["bare"] / costs["ours"]),
        "share of bare Batch": spread(costs["batch"] / costs["ours"]),
        "a plain loop over mj_step and SMA, over ours": spread(costs["plain"] / costs["ours"]),
        "us per step": spread(1e6 * costs["ours"]),
    }


def _steps(
    model: mujoco.MjModel, controls: Sequence[Iterable[Array]], substeps: int = 1
) -> Callable[[int], None]:
    """Return the steps of a bare loop over `mj_step`, with `substeps` physics steps per control."""
    data = mujoco.MjData(model)

    def step(number: int) -> None:
        for control in controls[number]:
            data.ctrl[:] = control
            mujoco.mj_step(model, data, nstep=substeps)

    return step


def _plain(physics: Physics, model: mujoco.MjModel, controls: list[Array]) -> Callable[[int], None]:
    """Return the steps of a simple loop that heats the springs and sets the controls."""
    data = mujoco.MjData(model)
    state = SmaState.cold(physics.spring, (physics.num_springs,))
    power = np.random.default_rng(SEED).integers(0, 2, (1, physics.num_springs)).astype(float)
    substeps = round(SMA_STEP_S / physics.timestep_s)

    def step(number: int) -> None:
        nonlocal state
        for count in range(len(controls[number])):
            if count % substeps == 0:
                state = advance(physics.spring, state, power, SMA_STEP_S).state
            data.ctrl[:] = state.fraction
            mujoco.mj_step(model, data)

    return step


def ant(steps: int, repeats: int) -> dict[str, Any]:
    """Compare Gymnasium's Ant-v5 with the same steps in a bare loop."""
    env: Any = gymnasium.make("Ant-v5")
    actions = sample_actions(env.action_space, steps)

    def bare() -> Callable[[int], None]:
        return _steps(env.unwrapped.model, [[action] for action in actions], env.unwrapped.frame_skip)

    def ours() -> Callable[[int], None]:
        env.reset(seed=SEED)

        def step(number: int) -> None:
            if env.step(actions[number])[2]:
                env.reset()

        return step

    costs = turns({"ant": ours, "bare": bare}, steps, repeats)
    return {
        "environment": "Ant-v5 (Gymnasium)",
        "share of bare mj_step": spread(costs["bare"] / costs["ant"]),
        "us per step": spread(1e6 * costs["ant"]),
    }


def main() -> None:
    """Run the benchmarks and print both tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--envs", default="1,8,64,256,1024", help="sizes of the vector environments")
    parser.add_argument("--single", action="store_true", help="run only the single environments")
    args = parser.parse_args()
    rows = [single("switch", 280, args.repeats), single("timing", 5, args.repeats)]
    rows.append(ant(2000, args.repeats))
    report("single environments", rows)
    if args.single:
        return
    counts = [int(count) for count in args.envs.split(",")]
    rows = []
    # Stay within one episode, and limit the time for many robots.
    for mode, longest, total, most in (("switch", 280, 4000, 1024), ("timing", 6, 100, 64)):
        for count in (count for count in counts if count <= most):
            steps = max(2, min(longest, round(total / count)))
            rows.append(vector(mode, count, steps, args.repeats))
            print(rows[-1], file=sys.stderr)
    report("vector environments", rows)


if __name__ == "__main__":
    main()
