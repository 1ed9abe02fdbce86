"""`caterpillar study`."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, nullcontext
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro
from rich.console import Console, Group
from rich.live import Live
from rich.text import Text

from caterpillar_env import machine
from caterpillar_env.errors import CaterpillarError
from evolution import cli
from evolution.cli.report import write_report
from evolution.cli.running import check_address
from evolution.study.cells import Processes, Progress, RayTasks, run_study
from evolution.study.config import begin, preset, read_toml


@dataclass(frozen=True)
class StudyArgs:
    """Run the arms and seeds of a study, and write its report. Finished runs are not repeated."""

    file: Annotated[Path | None, tyro.conf.Positional] = None
    """TOML file with the settings of the study (see docs/study.md)."""
    preset: Literal["paper", "ablation", "pilot", "rl-pilot"] | None = None
    """Use a study of this package instead of a file."""
    out: Path | None = None
    """Study folder to create or continue; by default, studies/NAME for a file or preset of that name."""
    processes: int = 0
    """Number of simultaneous runs, one thread each; 0 uses all cores."""
    evaluator: Literal["local", "ray"] = "local"
    """local: processes of this machine; ray: a Ray cluster whose machines share the study folder."""
    ray_address: str | None = None
    """Address of a running Ray cluster; by default, a local one is started for the study."""
    winners: bool = True
    """Simulate the best robot of each arm under other conditions. This takes minutes."""

    def __post_init__(self) -> None:
        if (self.file is None) == (self.preset is None):
            raise CaterpillarError(
                "give either a TOML file or --preset paper, ablation, pilot or rl-pilot; got "
                + ("neither" if self.file is None else "both")
            )
        if self.processes < 0:
            raise CaterpillarError(f"processes = {self.processes} must not be negative")
        if self.evaluator == "ray" and self.processes:
            raise CaterpillarError("--processes requires --evaluator local")
        check_address(self.ray_address, self.evaluator)


def study_command(argv: Sequence[str]) -> int:
    """Run several arms with several seeds, and compare them."""
    args = cli.parse(StudyArgs, argv, "study")
    config = read_toml(args.file) if args.file else preset(str(args.preset))
    folder = args.out or Path("studies") / (args.file.stem if args.file else str(args.preset))
    begin(config, folder)
    console = cli.console()
    for warning in config.warnings():
        console.print(f"warning: {warning}")
    workers: Processes | RayTasks = Processes(args.processes or machine.cores())
    if args.evaluator == "ray":
        workers = RayTasks(args.ray_address)
    try:
        with _show_progress(console) as show:
            failed = run_study(config, folder, workers, show)
    except KeyboardInterrupt:
        console.print(f"stopped; continue with: caterpillar study {' '.join(argv)}")
        return 130
    for cell, error in failed:
        console.print(f"{cell} failed: {error}")
    write_report(folder, console, test_winners=args.winners)
    return 1 if failed else 0


@contextmanager
def _show_progress(console: Console) -> Iterator[Callable[[Progress], None]]:
    """Show the progress of all runs: live on a terminal, otherwise in a line per minute."""
    bar = cli.bar(console)
    task = bar.add_task("study", total=1.0)
    live = Live(console=console, refresh_per_second=2)
    last_minute = -1

    def show(progress: Progress) -> None:
        nonlocal last_minute
        finished = f"{progress.finished} of {progress.cells} runs"
        bar.update(task, completed=progress.share, description=finished)
        lines = [
            f"  {cell}: {simulated_s:,.0f} s simulated, best {1000 * best_m:.1f} mm"
            for cell, (simulated_s, best_m) in progress.running.items()
        ]
        if console.is_terminal:
            live.update(Group(bar, Text("\n".join(lines))))
            return
        minute, left_s = int(bar.tasks[0].elapsed or 0) // 60, bar.tasks[0].time_remaining
        if minute > last_minute or progress.finished == progress.cells:
            last_minute = minute
            left = "" if left_s is None else f", left {left_s / 60:.0f} min"
            console.print(f"{finished}, {100 * progress.share:.0f} %{left};" + ";".join(lines))

    with live if console.is_terminal else nullcontext():
        yield show
