"""Cost of evaluating a population relative to that of its physics steps alone.

python -m benchmarks.population            # about ten minutes on two cores
python -m benchmarks.population --memory   # 100,000 evaluations, shortened to 0.1 s each
"""

from __future__ import annotations

import argparse
import gc
import resource
from collections.abc import Callable
from pathlib import Path

import numpy as np

from benchmarks.harness import report, rounds, spread, timed
from caterpillar_env.physics import Physics
from caterpillar_env.robot import simulate
from caterpillar_env.task import EPISODE_S, Crawl
from caterpillar_env.validation.recorder import record_calls
from caterpillar_env.validation.robots import random_robots, stack_power, stack_robots
from evolution.genome import Encoding
from evolution.run.evaluators import evaluate


def evaluation(bodies: int, seconds: float, repeats: int) -> None:
    """Compare `robot.simulate` with the engine's steps alone, on one thread and on two."""
    physics = Physics()
    robots = random_robots(bodies, 0, physics)
    stacked, (_, power) = stack_robots(robots), stack_power(robots)
    crawl = Crawl(stacked[0], physics)
    with record_calls(crawl.simulation) as bare:
        for _ in range(round(seconds / stacked[1].period_s)):
            crawl.run(power)

    def race(threads: int) -> tuple[float, float]:
        """Return the times of `simulate` and of the engine, s. The engine repeats each interval."""
        batch, intervals, engine_s = bare.make_batch(threads), 0, 0.0

        def repeat(_: object) -> None:
            nonlocal intervals, engine_s
            engine_s += timed(lambda: bare.repeat(batch, intervals, intervals + 1))
            intervals += 1

        total_s = timed(
            lambda: simulate(*stacked, physics, threads=threads, duration_s=seconds, on_interval=repeat)
        )
        return total_s - engine_s, engine_s

    races = []
    for number in range(repeats):
        order = (1, 2) if number % 2 == 0 else (2, 1)
        races.append({threads: race(threads) for threads in order})
    costs = {threads: np.array([found[threads] for found in races]).T for threads in (1, 2)}
    rows = [
        {
            "threads": n,
            "ours over bare": spread(ours / engine),
            "us per body-step": spread(1e6 * ours / bare.steps),
            "1 thread over this": spread(costs[1][0] / ours),
            "the same, bare": spread(costs[1][1] / engine),
        }
        for n, (ours, engine) in costs.items()
    ]
    failed = int((crawl.failure != 0).sum())
    report(
        f"population: {bodies} random genomes, {seconds:g} s, {failed} of them end early",
        rows, bodies=bodies, seconds=seconds, physics_steps=bare.steps,
    )  # fmt: skip


def sizes(counts: list[int], repeats: int) -> None:
    """Compare the cost per body for populations of different sizes, on all cores."""
    physics = Physics()
    seconds = 2.0

    def population(count: int) -> Callable[[], float]:
        stacked = stack_robots(random_robots(count, 0, physics))
        return lambda: timed(lambda: simulate(*stacked, physics, duration_s=seconds)) / count

    costs = rounds({str(count): population(count) for count in counts}, repeats)
    report(
        f"cost per body over the size of the population, {seconds:g} s",
        [
            {"bodies": n, "ms per body": spread(1e3 * costs[str(n)]),
             "over the first": spread(costs[str(n)] / costs[str(counts[0])])}
            for n in counts
        ],
    )  # fmt: skip


def memory(evaluations: int) -> None:
    """Measure resident memory during many short evaluations, 200 at a time."""
    physics = Physics()
    rng = np.random.default_rng(0)
    size = len(Encoding(physics).genes)
    rows = []
    for done in range(0, evaluations + 1, 200):
        if done % (evaluations // 10) == 0:
            gc.collect()
            rows.append({"evaluations": done, "resident MB": _resident_mb()})
        if done < evaluations:
            genomes = rng.random((200, size))
            evaluate(genomes, Encoding(physics), duration_s=0.1)
    growth = rows[-1]["resident MB"] - rows[1]["resident MB"]
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    report("memory over evaluations", rows, growth_mb=growth, peak_mb=peak)


def _resident_mb() -> float:
    pages = int(Path("/proc/self/statm").read_text("utf-8").split()[1])
    return pages * resource.getpagesize() / 2**20


def main() -> None:
    """Run the benchmarks selected by the flags."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--bodies", type=int, default=200)
    parser.add_argument("--seconds", type=float, default=EPISODE_S)
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--sizes", default="16,64,256,1024,4096", help="population sizes; may be empty")
    parser.add_argument("--memory", action="store_true", help="run only the memory test")
    parser.add_argument("--evaluations", type=int, default=100_000, help="size of the memory test")
    args = parser.parse_args()
    if args.memory:
        memory(args.evaluations)
        return
    if args.sizes:
        sizes([int(count) for count in args.sizes.split(",")], args.repeats)
    if args.bodies:
        evaluation(args.bodies, args.seconds, args.repeats)


if __name__ == "__main__":
    main()
