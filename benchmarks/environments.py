"""Cost of environment steps relative to the bare engine and to Gymnasium's vector environments.

    python -m benchmarks.environments           # about fifteen minutes on two cores
    python -m benchmarks.environments --single  # only the single environments

All cases make the same physics steps: the bare engine repeats the recorded engine calls of our
environment. Ant-v5, one of Gymnasium's own environments, is compared with `mj_step` alone.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable
from typing import Any

import gymnasium
import mujoco
from gymnasium.vector import AsyncVectorEnv, SyncVectorEnv

import caterpillar_env  # noqa: F401  registers the environments
from benchmarks.harness import Step, report, spread, time_steps
from benchmarks.recorder import EngineCalls, record_calls
from caterpillar_env.arrays import Array

IDS = {"switch": "CaterpillarSMASwitch-v0", "timing": "CaterpillarSMA-v0"}
SEED = 0


def sample_actions(space: gymnasium.Space[Any], count: int) -> list[Any]:
    """Return `count` random actions. They are the same in every call."""
    space.seed(SEED)
    return [space.sample() for _ in range(count)]


def run(env: Any, actions: list[Any]) -> Callable[[], Step]:
    """Return a benchmark case that resets an environment and steps it."""

    def begin() -> Step:
        env.reset(seed=SEED)
        return lambda number: env.step(actions[number])

    return begin


def record_env(env: Any, actions: list[Any]) -> EngineCalls:
    """Record the engine calls of an environment in each of its steps."""
    return record_calls(env.unwrapped.crawl.simulation, run(env, actions)(), len(actions))


def vector(mode: str, count: int, steps: int, repeats: int) -> dict[str, Any]:
    """Compare `make_vec` with the bare Batch, SyncVectorEnv and AsyncVectorEnv."""
    makers = [lambda: gymnasium.make(IDS[mode])] * count
    envs: dict[str, Any] = {
        "native": gymnasium.make_vec(IDS[mode], num_envs=count, threads=0),
        "1 thread": gymnasium.make_vec(IDS[mode], num_envs=count, threads=1),
    }
    if count <= 256:
        envs["sync"] = SyncVectorEnv(makers)
    if count <= 64:
        envs["async"] = AsyncVectorEnv(makers)
    actions = sample_actions(envs["native"].action_space, steps)
    calls = record_env(envs["native"], actions)
    cases = {name: run(env, actions) for name, env in envs.items()}
    costs = time_steps({**cases, "bare": lambda: calls.begin(0)}, steps, repeats)
    for env in envs.values():
        env.close()
    row: dict[str, Any] = {
        "mode": mode,
        "envs": count,
        "share of bare": spread(costs["bare"] / costs["native"]),
        "all cores over 1": spread(costs["1 thread"] / costs["native"]),
    }
    for peer in ("sync", "async"):
        row[f"over {peer}"] = spread(costs[peer] / costs["native"]) if peer in costs else "not run"
    row["ms per step"] = spread(1e3 * costs["native"])
    return row


def single(mode: str, steps: int, repeats: int) -> dict[str, Any]:
    """Compare `gymnasium.make` with the bare Batch."""
    env: Any = gymnasium.make(IDS[mode])
    actions = sample_actions(env.action_space, steps)
    calls = record_env(env, actions)
    costs = time_steps({"ours": run(env, actions), "bare": lambda: calls.begin(1)}, steps, repeats)
    return _compare(IDS[mode], costs)


def ant(steps: int, repeats: int) -> dict[str, Any]:
    """Compare Gymnasium's Ant-v5 with `mj_step` alone, from the same states with the same controls."""
    env: Any = gymnasium.make("Ant-v5", terminate_when_unhealthy=False)
    actions = sample_actions(env.action_space, steps)
    model, count = env.unwrapped.model, env.unwrapped.frame_skip
    data = mujoco.MjData(model)

    def begin() -> Step:
        env.reset(seed=SEED)
        mujoco.mj_resetData(model, data)
        data.qpos[:], data.qvel[:] = env.unwrapped.data.qpos, env.unwrapped.data.qvel

        def step(number: int) -> None:
            data.ctrl[:] = actions[number]
            mujoco.mj_step(model, data, count)

        return step

    costs = time_steps({"ours": run(env, actions), "bare": begin}, steps, repeats)
    env.close()
    return _compare("Ant-v5", costs)


def _compare(name: str, costs: dict[str, Array]) -> dict[str, Any]:
    return {
        "environment": name,
        "share of bare": spread(costs["bare"] / costs["ours"]),
        "us per step": spread(1e6 * costs["ours"]),
    }


def main() -> None:
    """Run the benchmarks and print both tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=5)
    parser.add_argument("--envs", default="1,8,64,256,1024", help="sizes of the vector environments")
    parser.add_argument("--single", action="store_true", help="run only the single environments")
    args = parser.parse_args()
    rows = [single("switch", 280, args.repeats), single("timing", 5, args.repeats)]
    rows.append(ant(280, args.repeats))
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
