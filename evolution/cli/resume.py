"""`caterpillar resume`."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Annotated

import tyro

from evolution import cli
from evolution.cli.running import Reporter, WorkerArgs, finish
from evolution.run.history import History
from evolution.run.journal import Journal
from evolution.run.loop import resume


@dataclass(frozen=True)
class ResumeArgs:
    """Go on with a run where it ended; what is in its journal is not computed again."""

    folder: Annotated[Path, tyro.conf.Positional]
    """The run folder."""
    generations: int | None = None
    """Generations in all, more than so far; by default the run's own number."""
    repair: bool = False
    """Mend a damaged journal first: keep the evaluations before the damage."""
    workers: WorkerArgs = field(default_factory=WorkerArgs)


def resume_command(argv: Sequence[str]) -> int:
    """Continue a run that was stopped, or make a finished one longer."""
    args = cli.parse(ResumeArgs, argv, "resume")
    console = cli.console()
    if args.repair:
        kept = Journal.repair(args.folder)
        console.print(f"kept {kept} evaluations; the old file is journal.sqlite.damaged")
    config = History.read(args.folder).config
    config = replace(config, generations=args.generations or config.generations)
    workers = args.workers
    with Reporter(config, console) as reporter, workers.following(reporter, args.folder) as told:
        result = resume(
            args.folder, generations=args.generations, evaluator=workers.make(),
            on_generation=told, on_progress=reporter.progress,
            on_warning=lambda text: console.print(f"warning: {text}"),
        )  # fmt: skip
    return finish(result, config, args.folder, console, video=args.workers.video)
