"""Runs followed in TensorBoard."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

from caterpillar_env.errors import CaterpillarError
from evolution.run.history import Generation

FOLDER = "tensorboard"  #: within a run's folder


class TensorBoard:
    """Writes what is told of each generation as TensorBoard's scalars, over simulated seconds.

    Whatever the folder held is replaced: a resumed run tells all its generations once more.

    Args:
        run: the run's folder.

    Raises:
        CaterpillarError: tensorboardX is not installed.
    """

    def __init__(self, run: Path) -> None:
        try:
            from tensorboardX import SummaryWriter
        except ImportError:
            raise CaterpillarError(
                "--track tensorboard needs tensorboardX: pip install 'caterpillar-sma[tensorboard]'"
            ) from None
        self._make = SummaryWriter
        self._folder = run / FOLDER

    def __enter__(self) -> TensorBoard:
        self._writer: Any = None
        return self

    def __exit__(self, *_: object) -> None:
        if self._writer is not None:
            self._writer.close()

    def generation(self, told: Generation) -> None:
        """Write one generation."""
        if self._writer is None:
            shutil.rmtree(self._folder, ignore_errors=True)
            self._writer = self._make(str(self._folder))
        scalars = {
            "distance_m/best_so_far": told.best_m,
            "distance_m/mean_of_generation": told.mean_m,
            "progress/generation": told.number,
            "progress/evaluations": told.evaluations,
        } | {f"failures/{reason}": count for reason, count in told.failures.items()}
        for name, value in scalars.items():
            self._writer.add_scalar(name, value, global_step=round(told.simulated_s))
        self._writer.flush()
