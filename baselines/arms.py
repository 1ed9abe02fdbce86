"""Reinforcement learning as an arm of a study."""

from __future__ import annotations

import shutil
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import polars

from baselines.comparison import title
from baselines.config import TrainConfig, TrainingError, hyperparameters
from baselines.policy import TrainedRobot
from baselines.records import RECORD, Record, best_of, evaluations
from baselines.training import train
from caterpillar_env.gait import GAIT_PERIOD_S
from evolution.study.arms import ArmError


@dataclass(frozen=True)
class TrainArm:
    """An arm that trains a policy; an evaluation is one of the deterministic policy.

    Such an evaluation carries all simulated seconds since the one before, of training too. A training
    that was stopped is done anew, to the same bits.
    """

    config: TrainConfig

    @property
    def role(self) -> str | None:
        """See `evolution.study.arms.Arm`."""
        return f"Reinforcement learning, {title(self.config)}"

    @classmethod
    def from_dict(cls, data: Mapping[str, Any]) -> TrainArm:
        """See `evolution.study.arms.Arm`."""
        return cls(TrainConfig.from_dict(data))

    @classmethod
    def shared(cls, base: Mapping[str, Any]) -> Mapping[str, Any]:
        """See `evolution.study.arms.Arm`: the physics.

        Raises:
            ArmError: evolution has another gait period.
        """
        if base.get("gait_period_s", GAIT_PERIOD_S) != GAIT_PERIOD_S:
            raise ArmError(
                f"base.gait_period_s = {base['gait_period_s']!r} is not for policies, whose gait period "
                f"is {GAIT_PERIOD_S:g} s; set it in each arm that evolves instead"
            )
        return {name: base[name] for name in ("physics",) if name in base}

    def train_config(self, seed: int, budget_s: float) -> TrainConfig:
        """What a training computes."""
        return replace(self.config, seed=seed, budget_s=budget_s)

    def run(self, folder: Path, seed: int, budget_s: float) -> None:
        """See `evolution.study.arms.Arm`."""
        if self.is_finished(folder, seed, budget_s):
            return
        shutil.rmtree(folder, ignore_errors=True)
        if not train(self.train_config(seed, budget_s), folder, threads=1).finished:
            raise ArmError(f"{folder} was interrupted; it starts anew when the study is started again")

    def is_finished(self, folder: Path, seed: int, budget_s: float) -> bool:
        """See `evolution.study.arms.Arm`."""
        if not (folder / RECORD).exists():
            return False
        try:
            record = Record.load(folder)
        except TrainingError as error:
            raise ArmError(f"{error}; choose another folder for the study, or remove this one") from None
        if not record.finished:
            return False
        config = self.train_config(seed, budget_s)
        if (record.config, record.hyperparameters) != (config, hyperparameters(config).plain()):
            raise ArmError(
                f"{folder} was run with other settings; choose another folder for the study, or "
                "remove it"
            )
        return True

    def evaluations(self, folder: Path) -> polars.DataFrame:
        """See `evolution.study.arms.Arm`; genes are those of the body alone."""
        points = evaluations(folder)
        rows, before_s = [], 0.0
        for number, point in enumerate(points):
            rows.append(
                {
                    "evaluation": number,
                    "generation": number,
                    "failure": point.failure,
                    "distance_m": point.distance_m,
                    "energy_j": point.energy_j,
                    "simulated_s": point.simulated_s - before_s,
                    **point.morphology.to_dict(),
                }
            )
            before_s = point.simulated_s
        return polars.DataFrame(rows)

    def wall_s(self, folder: Path) -> float | None:
        """See `evolution.study.arms.Arm`."""
        return Record.load(folder).wall_s

    def versions(self, folder: Path) -> list[dict[str, str]]:
        """See `evolution.study.arms.Arm`."""
        return [Record.load(folder).versions]

    def best(self, folder: Path, budget_s: float) -> TrainedRobot | None:
        """See `evolution.study.arms.Arm`."""
        top = best_of(evaluations(folder))
        return None if top is None or top.distance_m <= 0 else TrainedRobot.load(folder)
