"""Logs of runs for TensorBoard."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

from caterpillar_env.errors import CaterpillarError
from evolution.run.history import Generation

FOLDER = "tensorboard"  #: name of the log's folder in a run folder


class TensorBoard:
    """Writes the summary of each generation as TensorBoard scalars over simulated seconds.

    The first generation replaces an earlier log: a resumed run reports all its generations again.

    Args:
        run: the run folder.

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

    def generation(self, generation: Generation) -> None:
        """Write the summary of a generation."""
        if self._writer is None:
            shutil.rmtree(self._folder, ignore_errors=True)
            self._writer = self._make(str(self._folder))
        scalars = {
            "distance_m/best_so_far": generation.best_m,
            "distance_m/mean_of_generation": generation.mean_m,
            "progress/generation": generation.number,
            "progress/evaluations": generation.evaluations,
        } | {f"failures/{reason}": count for reason, count in generation.failures.items()}
        for name, value in scalars.items():
            self._writer.add_scalar(name, value, global_step=round(generation.simulated_s))
        self._writer.flush()
