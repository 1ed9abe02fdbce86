"""Objectives, which a run maximizes, and the definition of the best robot."""

from __future__ import annotations

import copy
from collections.abc import Callable
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from caterpillar_env.arrays import Array
from caterpillar_env.errors import CaterpillarError, show
from caterpillar_env.physics import CONTROL_INTERVAL_S
from caterpillar_env.robot import Outcomes
from caterpillar_env.task import EPISODE_S, Failure

#: Minimum energy in `distance_per_energy`, J. In 30 s, a single pair of springs needs about 11 J to
#: contract fully once per gait period.
LEAST_ENERGY_J = 10.0
ObjectiveName = Literal["distance", "distance-per-energy"]
#: Takes the outcomes of P robots and returns P numbers, shape (P,). Higher is better.
Objective = Callable[[Outcomes], Array]


def distance(outcomes: Outcomes) -> Array:
    """Return the distance crawled forwards in m, (P,). A robot that ends behind its start scores 0."""
    return np.maximum(outcomes.distance_m, 0.0)


def distance_per_energy(outcomes: Outcomes) -> Array:
    """Return the distance crawled forwards per electrical energy in m/J, (P,).

    The energy counts as at least `LEAST_ENERGY_J`. Otherwise, a robot that only settles by a few
    millimetres with almost no power would score higher than a robot that crawls.
    """
    return distance(outcomes) / np.maximum(outcomes.energy_j, LEAST_ENERGY_J)


OBJECTIVES: dict[ObjectiveName, Objective] = {
    "distance": distance,
    "distance-per-energy": distance_per_energy,
}


def score(objective: Objective, outcomes: Outcomes, failed_fitness: float) -> Array:
    """Return the fitness that the optimizer receives for P robots, (P,).

    Args:
        objective: function that scores the robots that did not fail.
        outcomes: outcomes of P robots.
        failed_fitness: fitness of every robot that failed.

    Raises:
        CaterpillarError: the objective returned an array of the wrong shape, or NaN or infinity for a
            robot that did not fail.
    """
    healthy = outcomes.failure == Failure.NONE
    # Copies, because an objective may change its argument.
    values = np.array(objective(copy.deepcopy(outcomes)), dtype=np.float64)
    if values.shape != healthy.shape or not np.isfinite(values[healthy]).all():
        raise CaterpillarError(
            f"an objective must return shape {healthy.shape}, with a finite number for every robot that "
            f"did not fail; got shape {values.shape}, {show(values)}"
        )
    return np.where(healthy, values, failed_fitness)


def stopped(outcomes: Outcomes) -> NDArray[np.bool_]:
    """Return whether each of P robots was stopped early by racing, without a failure, (P,)."""
    early = outcomes.simulated_s < EPISODE_S - CONTROL_INTERVAL_S / 2
    return np.asarray(early & (outcomes.failure == Failure.NONE))


def find_best(objective: Objective, outcomes: Outcomes) -> tuple[int, float] | None:
    """Return the index and the objective of the best of P robots, or None if no robot qualifies.

    This function defines the best robot of a run. Robots that failed or were stopped early do not
    qualify. With a built-in objective, robots that did not crawl forwards do not qualify either. Ties
    go to the first robot.
    """
    values = score(objective, outcomes, -np.inf)
    values[stopped(outcomes)] = -np.inf
    if objective in OBJECTIVES.values():
        values[values <= 0] = -np.inf
    top = int(np.argmax(values))
    return (top, float(values[top])) if values[top] > -np.inf else None
