"""What is maximised: a number for each robot, from what became of it."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from caterpillar_env.arrays import Array
from caterpillar_env.errors import CaterpillarError
from caterpillar_env.robot import Outcomes
from caterpillar_env.task import Failure
from evolution.config import RunConfig

#: A fitness of one's own: of P outcomes, (P,), the greater the better; failures are scored elsewhere.
Score = Callable[[Outcomes], Array]


class ObjectiveError(CaterpillarError):
    """An objective returned an array of the wrong shape, or non-finite values."""


def scores(outcomes: Outcomes, config: RunConfig, objective: Score | None = None) -> Array:
    """The fitness that an optimizer is told, not negative, (P,).

    Args:
        outcomes: of P robots.
        config: of the run.
        objective: one of the user's own, see `evolve`.

    Raises:
        ObjectiveError: the user's own objective returns an array of the wrong shape, or a negative,
            infinite or undefined number.
    """
    ok = outcomes.failure == Failure.NONE
    value = outcomes.fitness(0.0)
    if objective is not None:
        value = np.asarray(objective(outcomes), dtype=np.float64)
        if value.shape != ok.shape or not ((value[ok] >= 0) & (value[ok] < np.inf)).all():
            raise ObjectiveError(
                f"an objective must give {len(ok)} finite numbers, not negative, one a robot, shape "
                f"{ok.shape}; got {value.tolist()}, shape {value.shape}"
            )
    elif config.objective == "distance-per-energy":
        drawn_j = outcomes.energy_j
        value = np.divide(value, drawn_j, out=np.zeros_like(value), where=drawn_j > 0)
    return np.where(ok, value, config.failed_fitness)
