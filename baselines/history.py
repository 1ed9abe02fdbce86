"""Records of training runs: journals with one evaluation per generation."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

from baselines.config import TrainConfig, hyperparameters
from caterpillar_env.errors import CaterpillarError
from caterpillar_env.morphology import Morphology
from evolution.run.history import History
from evolution.run.journal import Evaluation

KIND = "training"


def make_configuration(config: TrainConfig) -> dict[str, Any]:
    """Return the configuration that the journal of a training run stores."""
    return {"kind": KIND, **config.to_dict(), "hyperparameters": hyperparameters(config)._asdict()}


class Training(NamedTuple):
    """A training run and its record.

    Each evaluation of `history` is one episode of the deterministic policy. Its genome is the body. Its
    `simulated_s` includes the training since the previous evaluation.
    """

    config: TrainConfig
    history: History

    @classmethod
    def read(cls, folder: Path) -> Training:
        """Read the folder of a training run, even while it is running.

        Raises:
            CaterpillarError: the folder contains no training run.
        """
        history = History.read(folder)
        data = dict(history.configuration)
        if data.pop("kind", None) != KIND:
            raise CaterpillarError(
                f"{folder} contains an evolutionary run; give a folder that caterpillar rl train made"
            )
        del data["hyperparameters"]
        return cls(TrainConfig.from_dict(data), history)

    def body(self, evaluation: Evaluation) -> Morphology:
        """Return the body with which the policy was evaluated."""
        if self.config.design == "fixed":
            return self.config.morphology
        return Morphology.from_unit(evaluation.genome)
