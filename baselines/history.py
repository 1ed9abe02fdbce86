"""The record of a training: a journal as of an evolutionary run, with one evaluation per generation."""

from __future__ import annotations

from pathlib import Path
from typing import Any, NamedTuple

from baselines.config import TrainConfig, TrainingError, hyperparameters
from caterpillar_env.morphology import Morphology
from evolution.run.history import History
from evolution.run.records import Evaluation

KIND = "training"


def make_configuration(config: TrainConfig) -> dict[str, Any]:
    """Return what the journal of a training stores as its configuration."""
    return {"kind": KIND, **config.to_dict(), "hyperparameters": hyperparameters(config)._asdict()}


class Training(NamedTuple):
    """A training and its record.

    Each evaluation of `history` is one episode of the deterministic policy. Its genome is the body, and
    its `simulated_s` includes the training since the previous evaluation.
    """

    config: TrainConfig
    history: History

    @classmethod
    def read(cls, folder: Path) -> Training:
        """Read the folder of a training, also while it runs.

        Raises:
            CaterpillarError: the folder contains no training, or one of an older version.
        """
        if (folder / "training.json").exists():
            raise TrainingError(
                f"{folder} was written by an older version (training.json), which this version cannot "
                "read; repeat the training in another folder"
            )
        history = History.read(folder)
        data = dict(history.configuration)
        if data.pop("kind", None) != KIND:
            raise TrainingError(
                f"{folder} contains an evolutionary run; give a folder that caterpillar rl train made"
            )
        del data["hyperparameters"]
        return cls(TrainConfig.from_dict(data), history)

    def body(self, evaluation: Evaluation) -> Morphology:
        """Return the body in which the policy was evaluated."""
        if self.config.design == "fixed":
            return self.config.morphology
        return Morphology.from_unit(evaluation.genome)
