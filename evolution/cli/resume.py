"""`caterpillar resume`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

import tyro

from evolution import cli
from evolution.cli.running import Reporter, WorkerArgs, finish, print_commands
from evolution.run.history import History
from evolution.run.loop import resume


@dataclass(frozen=True)
class ResumeArgs:
    """Continue a run from its last recorded evaluation. Recorded evaluations are not repeated."""

    folder: Annotated[Path, tyro.conf.Positional]
    """Run folder."""
    generations: int | None = None
    """New total number of generations, to make the run longer."""
    workers: WorkerArgs = field(default_factory=WorkerArgs)


def resume_command(argv: Sequence[str]) -> int:
    """Continue a run that was stopped, or make a finished one longer."""
    args = cli.parse(ResumeArgs, argv, "resume")
    workers, console = args.workers, cli.console()
    history = History.read(args.folder)
    generations = max(args.generations or 0, history.config.generations)
    ending = history.stop_reason(generations)
    shorter = args.generations is not None and args.generations < generations  # `resume` refuses it
    if history.finished and not shorter and ending and (args.folder / "best.json").exists():
        console.print(f"already finished: {ending}")
        print_commands(history)
        return 0
    with Reporter(replace(history.config, generations=generations), console) as reporter:
        history = resume(
            args.folder, generations=args.generations, evaluator=workers.make_evaluator(),
            on_generation=reporter.generation, on_progress=reporter.progress,
            on_warning=lambda text: console.print(f"warning: {text}"),
        )  # fmt: skip
    return finish(history, console, video=workers.video)
