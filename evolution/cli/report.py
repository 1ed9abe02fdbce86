"""`caterpillar report`."""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from caterpillar_env.errors import CaterpillarError
from evolution import cli
from evolution.cli.running import write_results
from evolution.run.history import History
from evolution.run.journal import FILE as JOURNAL
from evolution.study.config import SETTINGS, load
from evolution.study.results import collect


@dataclass(frozen=True)
class ReportArgs:
    """Write the figures and report.html of a run, or of the finished runs of a study."""

    folder: Annotated[Path, tyro.conf.Positional]
    """Folder of the run or study."""
    video: bool = True
    """For a run: write best.mp4, unless it already shows the best robot."""
    landscape: tuple[str, str] | None = None
    """For a run: names of two genes to vary in the best robot. The distances are plotted in
    landscape.png. This takes about as long as 625 evaluations."""
    all_winners: bool = False
    """For a study: simulate the best robot of every run again with a finer timestep, other friction and
    other spring parameters, and measure the gaits. This takes a minute per robot on one core."""


def report_command(argv: Sequence[str]) -> int:
    """Write the figures and report.html of a run or a study."""
    args = cli.parse(ReportArgs, argv, "report")
    if (args.folder / SETTINGS).is_file():
        if args.landscape is not None:
            raise CaterpillarError(f"--landscape needs the folder of a run; {args.folder} is a study")
        write_report(args.folder, all_winners=args.all_winners)
    elif args.all_winners:
        raise CaterpillarError(
            f"--all-winners needs the folder of a study; {args.folder} is not a study"
        )
    elif (args.folder / JOURNAL).is_file():
        history = History.read(args.folder)
        if args.landscape is not None:
            write_landscape(history, args.landscape)
        write_results(history, cli.console(), video=args.video)
    else:
        raise CaterpillarError(
            f"{args.folder} contains neither a run ({JOURNAL}) nor a study ({SETTINGS}); give a "
            "folder that caterpillar evolve or caterpillar study made"
        )
    return 0


def write_landscape(history: History, names: tuple[str, str]) -> None:
    """Sweep two genes around the best robot of a run, and write the figure into its folder."""
    from evolution.report import figures, landscape

    with cli.bar(cli.console()) as bar:
        task = bar.add_task("landscape", total=1.0)
        found = landscape.sweep(
            history, names, on_progress=lambda share: bar.update(task, completed=share)
        )
    path = history.folder / "landscape.png"
    figures.save(landscape.draw(found), path)
    print(f"landscape: {path}")


def write_report(folder: Path, *, all_winners: bool = False) -> None:
    """Write the report of a study, and print its results."""
    from evolution.study import report
    from evolution.study.analysis import analyse, summarize
    from evolution.study.winners import retest_winners

    config = load(folder)
    results = collect(config, folder)
    if results.table.is_empty():
        raise CaterpillarError(
            f"no run of {folder} is finished yet; continue with caterpillar study, or see caterpillar "
            f"runs {folder}"
        )
    analysis = analyse(config, results)
    retest = retest_winners(analysis, folder, every_run=all_winners)
    page = report.write(analysis, retest, folder)
    print("\n".join(summarize(analysis)))
    for row in retest.comparisons:
        line = f"{row.arm}, {row.condition}: {row.failed} of {row.robots} winners fail"
        if row.failed < row.robots:
            line += (
                f"; the others crawl {100 * row.median_share:.0f} % of their recorded distance (median; "
                f"{100 * row.smallest_share:.0f} to {100 * row.largest_share:.0f} %)"
            )
        print(f"{line}; median distance {1000 * row.median_m:.0f} mm, where a failure counts as 0")
    print(f"written: {page}", file=sys.stderr)
