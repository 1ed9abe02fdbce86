"""`caterpillar study`."""

from __future__ import annotations

from collections.abc import Sequence
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
    """TOML file with the settings of the study, see docs/study.md."""
    preset: Literal["paper", "ablation", "pilot", "rl-pilot"] | None = None
    """A study of the package, instead of a file."""
    out: Path | None = None
    """Study folder to create or continue; by default studies/NAME, with the name of file or preset."""
    processes: int = 0
    """Number of runs side by side, one thread each; 0 uses all cores."""
    evaluator: Literal["local", "ray"] = "local"
    """local: processes of this machine; ray: tasks of a Ray cluster that shares the study folder."""
    ray_address: str | None = None
    """Address of a running Ray cluster; by default, a local one is started for the study."""
    winners: bool = True
    """Simulate the best robot of each arm under other conditions; takes minutes."""

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
    workers: Processes | RayTasks
    if args.evaluator == "ray":
        workers = RayTasks(args.ray_address)
    else:
        workers = Processes(args.processes or machine.cores())
    try:
        with _Display(console) as display:
            failed = run_study(config, folder, workers, display.show)
    except KeyboardInterrupt:
        console.print(f"stopped; continue with: caterpillar study {' '.join(argv)}")
        return 130
    for cell, error in failed:
        console.print(f"{cell} failed: {error}")
    write_report(folder, console, look_again=args.winners)
    return 1 if failed else 0


class _Display:
    """The progress of all runs: a live display on a terminal, otherwise a line per minute."""

    def __init__(self, console: Console) -> None:
        self._console = console
        self._bar = cli.bar(console)
        self._task = self._bar.add_task("study", total=1.0)
        self._live = Live(console=console, refresh_per_second=2)
        self._minute = -1

    def __enter__(self) -> _Display:
        if self._console.is_terminal:
            self._live.start()
        return self

    def __exit__(self, *_: object) -> None:
        if self._console.is_terminal:
            self._live.stop()

    def show(self, progress: Progress) -> None:
        """Update the display."""
        self._bar.update(
            self._task, completed=progress.share,
            description=f"{progress.finished} of {progress.cells} runs",
        )  # fmt: skip
        lines = [
            f"  {cell}: {simulated_s:,.0f} s simulated, best {1000 * best_m:.1f} mm"
            for cell, (simulated_s, best_m) in progress.running.items()
        ]
        if self._console.is_terminal:
            self._live.update(Group(self._bar, Text("\n".join(lines))))
            return
        task = self._bar.tasks[0]
        minute = int(task.elapsed or 0) // 60
        if minute > self._minute or progress.finished == progress.cells:
            self._minute = minute
            left = task.time_remaining
            eta = "" if left is None else f", left {left / 60:.0f} min"
            self._console.print(
                f"{progress.finished} of {progress.cells} runs, {100 * progress.share:.0f} %{eta};"
                + ";".join(lines),
            )
