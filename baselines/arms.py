"""Reinforcement learning as an arm of a study."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, ClassVar

import polars

from baselines.config import TrainConfig, is_same
from baselines.policy import TrainedRobot
from baselines.training import resume, train
from caterpillar_env.errors import CaterpillarError
from caterpillar_env.gait import GAIT_PERIOD_S
from evolution.run.evaluators import Evaluator
from evolution.run.history import History
from evolution.run.journal import FILE
from evolution.study.arms import merge


@dataclass(frozen=True)
class TrainArm:
    """An arm that trains a policy. It implements `evolution.study.arms.Arm`.

    An interrupted training run is resumed.
    """

    config: TrainConfig
    restorable: ClassVar[bool] = False

    @classmethod
    def from_dict(cls, data: Mapping[str, Any], base: Mapping[str, Any]) -> TrainArm:
        """Make an arm from its settings and the `physics` in the table `base` of the study.

        Raises:
            CaterpillarError: the base sets a gait period that differs from that of the environments.
        """
        if base.get("gait_period_s", GAIT_PERIOD_S) != GAIT_PERIOD_S:
            raise CaterpillarError(
                f"base.gait_period_s = {base['gait_period_s']!r} does not apply to policies, whose gait "
                f"period is {GAIT_PERIOD_S:g} s; set it in each arm of the kind evolution instead"
            )
        shared = {name: base[name] for name in ("physics",) if name in base}
        return cls(TrainConfig.from_dict(merge(shared, data)))

    def run(self, folder: Path, seed: int, budget_s: float, evaluator: Evaluator) -> bool:
        """Train on one thread, without the evaluator; return whether the training finished."""
        config = self._configure(seed, budget_s)
        if (folder / FILE).exists():
            history = History.read(folder)
            if self.matches(history, seed, budget_s) and history.generations:
                return resume(folder, threads=1).history.finished
        shutil.rmtree(folder, ignore_errors=True)
        return train(config, folder, threads=1).history.finished

    def matches(self, history: History, seed: int, budget_s: float) -> bool:
        """Return whether a recorded run has the settings and hyperparameters of this arm."""
        return is_same(history.configuration, self._configure(seed, budget_s))

    def restore(self, rows: polars.DataFrame, folder: Path, seed: int, budget_s: float) -> None:
        """Raise an error: the evaluations of a training run do not contain its policies."""
        raise NotImplementedError

    def robot(self, folder: Path, evaluation: int) -> TrainedRobot:
        """Return the robot of the best evaluation. Other evaluations have no stored policy."""
        return TrainedRobot.load(folder)

    def load(self, path: Path) -> TrainedRobot:
        """Read a robot from its JSON file, and its policy from the .npz file beside it."""
        return TrainedRobot.load(path)

    def _configure(self, seed: int, budget_s: float) -> TrainConfig:
        return replace(self.config, seed=seed, budget_s=budget_s)
