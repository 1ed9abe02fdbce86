"""Racing: after a few gait periods, only the best share of a generation is simulated to the end.

The other robots are stopped early, which is not a failure. Their recorded outcomes are those at the time
of the stop. `evolution.objective.stopped` identifies these robots.
"""

from __future__ import annotations

import math

import numpy as np

from caterpillar_env.arrays import Array, Rows
from caterpillar_env.robot import Outcomes
from caterpillar_env.task import EPISODE_S, CrawlState
from evolution.config import RunConfig
from evolution.objective import Objective, score
from evolution.run.evaluators import Evaluator, Job, OnProgress, run_jobs


def race(
    genomes: Array,
    config: RunConfig,
    objective: Objective,
    evaluator: Evaluator,
    on_progress: OnProgress | None = None,
) -> Outcomes:
    """Evaluate a generation of genomes (P, n), and stop all robots except the leaders early.

    The leaders are the best robots after `config.race_periods` gait periods. They continue from their
    state, so that nothing is simulated twice.

    Args:
        genomes: array of shape (P, n) with values in [0, 1].
        config: gives the encoding, `race_share`, `race_periods` and the gait period.
        objective: ranks the robots.
        evaluator: simulates the robots.
        on_progress: called with the share that is evaluated, in [0, 1].

    Returns:
        The outcomes in the order of the genomes, arrays of shape (P,).

    Raises:
        CaterpillarError: the objective returned a wrong shape or non-finite values.
    """
    encoding, stop_s = config.encoding, config.race_periods * config.gait_period_s
    count = count_leaders(config.race_share, len(genomes))
    first_s = stop_s * len(genomes)
    first_share = first_s / (first_s + (EPISODE_S - stop_s) * count)  # share of the simulated time
    jobs = [Job(chunk, stop_s) for chunk in evaluator.split(genomes)]
    results = list(run_jobs(evaluator, encoding, jobs, on_progress, 0.0, first_share))
    outcomes = Outcomes.join(r.outcomes for r in results)
    states = CrawlState.join([r.end for r in results if r.end is not None])
    ahead = evaluator.split(leaders(score(objective, outcomes, -np.inf), count))
    jobs = [Job(genomes[rows], EPISODE_S, states.rows(rows)) for rows in ahead]
    finished = run_jobs(evaluator, encoding, jobs, on_progress, first_share)
    for rows, result in zip(ahead, finished, strict=True):
        for name, values in result.outcomes._asdict().items():
            getattr(outcomes, name)[rows] = values
    return outcomes


def count_leaders(share: float, robots: int) -> int:
    """Return the number of robots that continue: their share, rounded up."""
    return max(1, math.ceil(round(share * robots, 9)))  # 0.07 * 100 is slightly more than 7


def leaders(fitness: Array, count: int) -> Rows:
    """Return the indices of the best `count` robots, ascending. Robots with fitness -inf are left out.

    Ties go to the first robot.
    """
    best = np.argsort(-fitness, kind="stable")[:count]
    return np.sort(best[fitness[best] > -np.inf])
