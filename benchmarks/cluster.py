"""Utilization of a Ray cluster of several nodes on this machine, with a stand-in for the simulation.

    pip install 'caterpillar-sma[ray]'
    python -m benchmarks.cluster --cores 2 16
    python -m benchmarks.cluster --cores 64 190 --runs 1 3  # alone, and three runs side by side
    python -m benchmarks.cluster --cost                     # cost of the real simulation

The nodes are real: each has its own raylet and worker processes. `RayEvaluator` splits the generations
and collects the results. Only the simulation is replaced: a task sleeps for as long as the simulation
would take. Sleeping needs no core, so a cluster can declare more cores than this machine has.
"""

from __future__ import annotations

import argparse
import os
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from itertools import pairwise
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from benchmarks.harness import report, spread
from caterpillar_env.arrays import Array
from evolution.config import RunConfig
from evolution.run.cluster import RayEvaluator, chunk_sizes
from evolution.run.evaluators import evaluate

GENOMES = 190  #: evaluations of a generation in the paper
GENOME_S = 0.3  #: time to simulate 30 s of a robot on one core
JOB_S = 0.05  #: additional time of a task (see docs/results/ray.md)
FAILED = 0.06  #: share of robots that fail, each at a random time of the episode
NODES = 4


class Task(NamedTuple):
    """When and where a task ran."""

    began: float  #: time of the system's clock, s
    ended: float
    worker: str


class StandIn(RayEvaluator):
    """Sleeps for `scale` times as long as the simulation would take.

    Workers get plain lists of seconds, so that they need not import this project.
    """

    scale = 1.0

    @staticmethod
    def _work(job: Any, encoding: Any) -> tuple[Any, float]:
        from ray import get_runtime_context

        began = time.time()
        time.sleep(sum(job.genomes))
        return (began, time.time(), get_runtime_context().get_worker_id()), sum(job.genomes)

    def generation(self, costs_s: Array) -> list[Task]:
        """Evaluate a generation of P genomes that take `costs_s` seconds to simulate, (P,)."""
        parts = [self.scale * np.array([JOB_S, *part]) for part in self.split(costs_s)]
        jobs: Any = [SimpleNamespace(genomes=part.tolist()) for part in parts]
        encoding: Any = None
        results: Any = self.map(encoding, jobs)
        return [Task(*result) for result in results]


@contextmanager
def start_cluster(cores: int) -> Iterator[str]:
    """Start a cluster with up to `NODES` nodes, and wait for all workers. Yields its address."""
    import ray
    from ray.cluster_utils import Cluster

    cluster = Cluster()
    for part in np.array_split(np.arange(cores), min(NODES, cores)):
        cluster.add_node(num_cpus=len(part), include_dashboard=False, object_store_memory=80 * 2**20)
    ray.init(cluster.address, log_to_driver=False, logging_level="ERROR")
    try:
        with StandIn() as evaluator:
            workers: set[str] = set()
            for _ in range(60):
                workers |= {
                    task.worker for task in evaluator.generation(np.full(2 * cores, 1.0 / StandIn.scale))
                }
                print(f"{len(workers)} of {cores} workers", file=sys.stderr)
                if len(workers) >= cores:
                    break
            else:
                raise RuntimeError(f"only {len(workers)} of {cores} workers have started")
        yield cluster.address
    finally:
        ray.shutdown()
        cluster.shutdown()


def draw_costs_s(rng: np.random.Generator) -> Array:
    """Draw the time that each genome of a generation takes, s, (P,)."""
    return GENOME_S * np.where(rng.random(GENOMES) < FAILED, rng.random(GENOMES), 1.0)


def run(seed: int, share: float, seconds: float) -> list[list[Task]]:
    """Evaluate at least two generations, one after the other, until the time has passed."""
    rng, ends = np.random.default_rng(seed), time.time() + seconds
    generations: list[list[Task]] = []
    with StandIn(share=share) as evaluator:
        while len(generations) < 2 or time.time() < ends:
            generations.append(evaluator.generation(draw_costs_s(rng)))
    return generations


def schedule(cores: int) -> float:
    """Return the utilization that the generations would allow if Ray needed no time.

    A worker that is free takes the next chunk, and no generation begins before the last chunk has ended.
    """
    rng, busy_s, wall_s = np.random.default_rng(0), 0.0, 0.0
    for _ in range(50):  # generations
        costs_s, ends = draw_costs_s(rng), np.zeros(cores)
        for part in np.split(costs_s, np.cumsum(chunk_sizes(GENOMES, cores))[:-1]):
            ends[ends.argmin()] += JOB_S + part.sum()
        busy_s, wall_s = busy_s + ends.sum(), wall_s + ends.max()
    return busy_s / (cores * wall_s)


def measure(cores: int, runs: int, seconds: float) -> dict[str, Any]:
    """Measure a number of runs side by side on a running cluster. Return a row of the table."""
    with ThreadPoolExecutor(runs) as pool:
        began = time.time()
        made = list(pool.map(lambda seed: run(seed, 1 / runs, seconds), range(runs)))
    # Count only until the first run ends: after that, fewer runs are side by side.
    ended = min(generations[-1][-1].ended for generations in made)
    tasks = [task for generations in made for tasks in generations for task in tasks]
    busy_s = sum(max(min(task.ended, ended) - task.began, 0.0) for task in tasks)
    alone = [tail_s(generation, cores) for generation in made[0]] if runs == 1 else []
    gaps = [gap for generation in made[0] for gap in gaps_s(generation)]
    return {
        "cores": cores,
        "runs": runs,
        "generations": sum(map(len, made)),
        "tasks": len(made[0][0]),
        "utilization without overhead": schedule(cores) if runs == 1 else "",
        "utilization": busy_s / (cores * (ended - began)),
        "gap, ms": 1000 * float(np.median(gaps)) if gaps and runs == 1 else "",
        "tail, ms": 1000 * float(np.median(alone)) if alone else "",
        "generation, s": (ended - began) / len(made[0]) if runs == 1 else "",
    }


def by_worker(tasks: list[Task]) -> list[list[Task]]:
    """Group tasks by their worker, in order of time."""
    groups: dict[str, list[Task]] = {}
    for task in sorted(tasks):
        groups.setdefault(task.worker, []).append(task)
    return list(groups.values())


def gaps_s(tasks: list[Task]) -> list[float]:
    """Return the times between a task and the next one of the same worker, s."""
    return [b.began - a.ended for group in by_worker(tasks) for a, b in pairwise(group)]


def tail_s(tasks: list[Task], cores: int) -> float:
    """Return the mean time for which a worker waits at the end of a generation for the last task, s."""
    began, ended = min(task.began for task in tasks), max(task.ended for task in tasks)
    last = [group[-1].ended for group in by_worker(tasks)]
    return (cores * ended - sum(last) - (cores - len(last)) * began) / cores


def measure_cost(repeats: int) -> list[dict[str, Any]]:
    """Measure the time per genome of the real simulation on one thread, for several chunk sizes."""
    encoding, rng = RunConfig().encoding, np.random.default_rng(0)
    sizes, count = (1, 4, 32), 32
    spent: dict[int, list[float]] = {size: [] for size in sizes}
    for _ in range(repeats):
        genomes = rng.random((count, len(encoding.genes)))
        evaluate(genomes, encoding, threads=1)  # so that Numba has compiled all loops
        for size in sizes:
            began = time.process_time()
            for part in np.split(genomes, range(size, count, size)):
                evaluate(part, encoding, threads=1)
            spent[size].append((time.process_time() - began) / count)
    return [{"chunk": size, "ms per genome": spread(1000 * np.array(spent[size]))} for size in sizes]


def main() -> None:
    """Run the benchmark and print its tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cores", type=int, nargs="+", default=[2, 16, 64, 190])
    parser.add_argument("--runs", type=int, nargs="+", default=[1], help="runs side by side")
    parser.add_argument("--seconds", type=float, default=20.0, help="minimum time of a measurement, s")
    parser.add_argument("--scale", type=float, default=1.0, help="factor on the time per genome")
    parser.add_argument("--cost", action="store_true", help="measure the real simulation instead")
    args = parser.parse_args()
    if args.cost:
        report(f"cost of a chunk, load {os.getloadavg()[0]:.0f}", measure_cost(repeats=2))
        return
    rows, StandIn.scale = [], args.scale
    for cores in args.cores:
        with start_cluster(cores):
            rows += [measure(cores, runs, args.seconds) for runs in args.runs]
    load = os.getloadavg()[0]
    report(f"cluster: generations of {GENOMES}, times {args.scale:g}, load {load:.0f}", rows)


if __name__ == "__main__":
    main()
