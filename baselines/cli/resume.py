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
from evolution import cli
from evolution.cli.running import ThreadArgs


@dataclass(frozen=True)
class ResumeArgs(ThreadArgs):
    """Continue a training run from its last evaluation, as if it had not been stopped."""

    folder: Annotated[Path, tyro.conf.Positional]
    """Folder of the training run."""


def resume_command(argv: Sequence[str]) -> int:
    """Continue a training run from its last evaluation."""
    args = cli.parse(ResumeArgs, argv, "rl resume")
    config, history = Training.read(args.folder)
    console = cli.console()
    if history.finished:
        console.print("already finished: the budget is spent")
    run = partial(
        resume, args.folder, threads=args.threads,
        on_warning=lambda text: console.print(f"warning: {text}"),
    )  # fmt: skip
    return follow(run, config, args.video)
