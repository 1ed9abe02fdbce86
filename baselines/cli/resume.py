"""`caterpillar rl resume`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Annotated

import tyro

from baselines.cli.train import follow
from baselines.config import Training
from baselines.training import resume
from caterpillar_env.errors import check_number
from caterpillar_env.machine import MAX_THREADS
from evolution import cli


@dataclass(frozen=True)
class ResumeArgs:
    """Continue a training run from its last evaluation, with the result of one that was not stopped."""

    folder: Annotated[Path, tyro.conf.Positional]
    """Folder of the training run."""
    video: bool = True
    """Write best.mp4, a video of the best robot."""
    threads: int = 0
    """Number of simulation threads; 0 uses all cores."""

    def __post_init__(self) -> None:
        check_number("threads", self.threads, 0, MAX_THREADS, whole=True)


def resume_command(argv: Sequence[str]) -> int:
    """Continue a training run from its last evaluation."""
    args = cli.parse(ResumeArgs, argv, "rl resume")
    config = Training.read(args.folder).config
    return follow(partial(resume, args.folder, threads=args.threads), config, args.video)
