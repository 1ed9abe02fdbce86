"""Objectives: the number that a run maximises, and the definition of the best robot."""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np

from caterpillar_env.arrays import Array
from caterpillar_env.errors import CaterpillarError
from caterpillar_env.robot import Outcomes
from caterpillar_env.task import Failure

ObjectiveName = Literal["distance", "distance-per-energy"]
#: Takes the outcomes of P robots and returns P numbers, shape (P,); greater is better.
Objective = Callable[[Outcomes], Array]


class ObjectiveError(CaterpillarError):
    """An objective returned an array of the wrong shape, or non-finite values."""


def distance(outcomes: Outcomes) -> Array:
    """Distance crawled forwards, m; 0 for a robot that ends behind its start, (P,)."""
    return np.maximum(outcomes.distance_m, 0.0)


def distance_per_energy(outcomes: Outcomes) -> Array:
    """Distance crawled forwards per electrical energy, m/J, (P,)."""
    energy_j = outcomes.energy_j
    return np.divide(distance(outcomes), energy_j, out=np.zeros_like(energy_j), where=energy_j > 0)


OBJECTIVES: dict[ObjectiveName, Objective] = {
    "distance": distance,
    "distance-per-energy": distance_per_energy,
}


def score(objective: Objective, outcomes: Outcomes, failed_fitness: float) -> Array:
    """The fitness of P robots, as the optimizer receives it, (P,).

    Args:
        objective: scores the robots that did not fail.
        outcomes: of P robots.
        failed_fitness: of a robot that failed.

    Raises:
        ObjectiveError: the objective returned another shape, or NaN or infinity for a healthy robot.
    """
    healthy = outcomes.failure == Failure.NONE
    values = np.asarray(objective(outcomes), dtype=np.float64)
    if values.shape != healthy.shape or not np.isfinite(values[healthy]).all():
        raise ObjectiveError(
            f"an objective must return {len(healthy)} finite numbers, one per robot, shape "
            f"{healthy.shape}; got {values.tolist()}, shape {values.shape}"
        )
    return np.where(healthy, values, failed_fitness)


def find_best(objective: Objective, outcomes: Outcomes) -> tuple[int, float] | None:
    """The best of P robots: its index and its objective; None if there is no candidate.

    This is the only definition of "best". A robot that failed is never the best. With a built-in
    objective a robot must also have crawled forwards. Of equal robots, the first is the best.
    """
    values = score(objective, outcomes, -np.inf)
    if objective in OBJECTIVES.values():
        values[values <= 0] = -np.inf
    top = int(np.argmax(values))
    return (top, float(values[top])) if values[top] > -np.inf else None
