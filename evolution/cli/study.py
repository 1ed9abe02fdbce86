"""`caterpillar study`."""

from __future__ import annotations

import shlex
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal, get_args

import tyro

from caterpillar_env import machine
from caterpillar_env.errors import CaterpillarError
from evolution import cli
from evolution.cli.report import write_report
from evolution.cli.running import check_address
from evolution.study.cells import Processes, RayTasks, run_study
from evolution.study.config import begin, preset, read_toml
from evolution.study.results import collect

Preset = Literal["paper", "ablation", "search", "conjecture", "rl", "rl-ablation", "worlds", "pilot"]


@dataclass(frozen=True)
class StudyArgs:
    """Run every arm (configuration) of a study with every seed, and write the report.

    Finished runs are not repeated.
    """

    file: Annotated[Path | None, tyro.conf.Positional] = None
    """TOML file with the settings of the study (see docs/study.md)."""
    preset: Preset | None = None
    """Use a predefined study instead of a file."""
    out: Path | None = None
    """Study folder to create or continue; by default, studies/NAME, named after the file or preset."""
    processes: int = 0
    """Number of simultaneous runs, one thread each; 0 uses all cores."""
    evaluator: Literal["local", "ray"] = "local"
    """local: processes of this machine; ray: a Ray cluster whose machines share the study folder."""
    ray_address: str | None = None
    """Address of a running Ray cluster; by default $RAY_ADDRESS, or a new local cluster."""

    def __post_init__(self) -> None:
        if (self.file is None) == (self.preset is None):
            raise CaterpillarError(
                f"give a TOML file or --preset NAME (one of {', '.join(get_args(Preset))}); got "
                f"{'neither' if self.file is None else 'both'}"
            )
        if self.processes < 0:
            raise CaterpillarError(f"processes = {self.processes} must not be negative")
        if self.evaluator == "ray" and self.processes:
            raise CaterpillarError("--processes requires --evaluator local")
        check_address(self.ray_address, self.evaluator)


def study_command(argv: Sequence[str]) -> int:
    """Run several configurations (arms) with several seeds, and compare the arms."""
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
        with cli.bar(console) as bar:
            task, cells, shown = bar.add_task("study", total=1.0), len(config.cells()), -1

            def show(ended: int, share: float) -> None:
                nonlocal shown
                bar.update(task, completed=share, description=f"{ended} of {cells} runs")
                percent = int(100 * share)
                if percent > shown and not console.is_terminal:
                    shown = percent
                    left = cli.time_left(bar, console)
                    console.print(f"{ended} of {cells} runs, {percent} %{left}")

            failed = run_study(config, folder, workers, show)
    except KeyboardInterrupt:
        collect(config, folder)
        console.print(f"stopped; continue with: caterpillar study {shlex.join(argv)}")
        return 130
    for cell, error in failed:
        console.print(f"{cell} failed: {error}")
    write_report(folder)
    return 1 if failed else 0
