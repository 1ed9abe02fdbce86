"""Population evaluation against the bare engine: `python benchmarks/population.py`.

Ours is `evolution.fitness.evaluate` of uniformly random genomes for 30 s each, models built, springs
heated, failures judged and stopped. The limit is `mujoco.batch.Batch.rollout` of the same ready-made
models with the same ready-made controls, for as many steps as each robot really made.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import tyro
from common import Rounds, report, timed
from mujoco.batch import Batch
from numpy.typing import NDArray

from caterpillar_env.gait import GAIT_PERIOD_S
from caterpillar_env.model import SMA_STEP_S, Physics, build_model
from caterpillar_env.sma import SmaState, advance
from caterpillar_env.task import EPISODE_S
from evolution.fitness import evaluate
from evolution.genome import decode, genes

CHUNK_STEPS = 200  #: of the bare rollout, so that its controls stay in the cache


@dataclass(frozen=True)
class Args:
    """Time the evaluation of a population against the bare engine."""

    genomes: int = 200
    """Random genomes."""
    threads: int = 0
    """Worker threads of both; 0 means all cores."""
    repeats: int = 5
    """Times that both are run, in turn."""


def bare(
    genomes: NDArray[np.float64], simulated_s: NDArray[np.float64], physics: Physics, threads: int
) -> float:
    """Seconds that the physics steps alone take."""
    bodies, timings = decode(genomes, physics.num_segments, GAIT_PERIOD_S)
    power = timings.mirrored().power(SMA_STEP_S)
    periods = round(EPISODE_S / GAIT_PERIOD_S)
    cold = SmaState.cold(physics.spring, (len(bodies), physics.num_springs))
    heated = advance(
        physics.spring, cold, np.tile(np.swapaxes(power, 0, 1), (periods, 1, 1)), SMA_STEP_S
    ).fraction
    substeps = round(SMA_STEP_S / physics.timestep_s)
    models = [build_model(body, physics, physics.strengths()) for body in bodies]
    batch = Batch(models[0], len(bodies), threads)
    batch.set_models(models)
    batch.reset()
    steps = np.rint(simulated_s / physics.timestep_s).astype(int)
    wall_s, first = 0.0, 0
    while (ids := np.flatnonzero(steps > first)).size:
        count = min(CHUNK_STEPS, int(steps[ids].min()) - first)
        nodes = np.arange(first, first + count) // substeps
        control = np.ascontiguousarray(np.swapaxes(heated[nodes][:, ids], 0, 1))
        wall_s += timed(lambda: batch.rollout(nstep=count, control=control, ids=ids))  # noqa: B023
        first += count
    return wall_s


def main() -> None:
    """Run it."""
    args = tyro.cli(Args)
    physics = Physics()
    count = len(genes(physics.num_segments, GAIT_PERIOD_S))
    genomes = np.random.default_rng(0).random((args.genomes, count))
    simulated_s = evaluate(genomes, physics, GAIT_PERIOD_S, threads=args.threads).simulated_s
    rounds = Rounds()
    for _ in range(args.repeats):
        rounds.add("bare", bare(genomes, simulated_s, physics, args.threads))
        rounds.add(
            "evaluate",
            timed(lambda: evaluate(genomes, physics, GAIT_PERIOD_S, threads=args.threads)),
        )
    steps = float(simulated_s.sum()) / physics.timestep_s
    report("population", rounds, limit="bare", per_step=steps, **vars(args))


if __name__ == "__main__":
    main()
