"""Cost of evaluating a population relative to that of its physics steps alone.

python -m benchmarks.population  # about five minutes on two cores
"""

from __future__ import annotations

import argparse

from benchmarks.harness import Step, report, spread, time_steps
from benchmarks.recorder import record_calls
from caterpillar_env.physics import Physics
from caterpillar_env.task import Crawl
from caterpillar_env.validation.robots import random_robots, stack_power


def compare(count: int, periods: int, repeats: int) -> None:
    """Compare crawling robots with the engine's steps alone, on one thread and on two."""
    physics = Physics()
    bodies, power = stack_power(random_robots(count, 0, physics))
    crawl = Crawl(bodies, physics)
    calls = record_calls(crawl.simulation, lambda _: crawl.run(power), periods)
    failed = int((crawl.failure != 0).sum())

    def begin(threads: int) -> Step:
        crawl = Crawl(bodies, physics, threads)
        return lambda _: crawl.run(power)

    cases = {
        "1": lambda: begin(1),
        "2": lambda: begin(2),
        "bare 1": lambda: calls.begin(1),
        "bare 2": lambda: calls.begin(2),
    }
    costs = time_steps(cases, periods, repeats)
    rows = [
        {
            "threads": threads,
            "share of bare": spread(costs[f"bare {threads}"] / costs[threads]),
            "us per body-step": spread(1e6 * costs[threads] * periods / calls.physics_steps),
            "1 thread over this": spread(costs["1"] / costs[threads]),
            "the same, bare": spread(costs["bare 1"] / costs[f"bare {threads}"]),
        }
        for threads in ("1", "2")
    ]
    report(f"population: {count} random genomes, {periods} gait periods, {failed} end early", rows)


def main() -> None:
    """Run the benchmark and print its table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--bodies", type=int, default=100)
    parser.add_argument("--periods", type=int, default=2)
    parser.add_argument("--repeats", type=int, default=3)
    args = parser.parse_args()
    compare(args.bodies, args.periods, args.repeats)


if __name__ == "__main__":
    main()
