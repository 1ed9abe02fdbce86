"""Shared flags, progress output and final messages of the commands that start or continue a run."""

from __future__ import annotations

import shlex
from dataclasses import dataclass
from typing import Literal

from rich.console import Console

from caterpillar_env.errors import CaterpillarError, check_number
from caterpillar_env.machine import MAX_THREADS
from evolution import cli
from evolution.config import RunConfig
from evolution.run.cluster import RayEvaluator
from evolution.run.evaluators import Evaluator, LocalEvaluator
from evolution.run.history import Generation, History


def check_address(address: str | None, evaluator: str) -> None:
    """Raise a `CaterpillarError` if the address of a Ray cluster is given for a different evaluator."""
    if address is not None and evaluator != "ray":
        raise CaterpillarError("--ray-address requires --evaluator ray")


@dataclass(frozen=True, kw_only=True)
class ThreadArgs:
    """Settings of a run on this machine that do not change its result."""

    threads: int = 0
    """Number of simulation threads on this machine; 0 uses all cores."""
    video: bool = True
    """Write best.mp4, a video of the best robot."""

    def __post_init__(self) -> None:
        check_number("threads", self.threads, 0, MAX_THREADS, whole=True)


@dataclass(frozen=True)
class WorkerArgs(ThreadArgs):
    """Where a run is computed, and which extra files it writes. Neither changes the result."""

    evaluator: Literal["local", "ray"] = "local"
    """local: threads of this machine; ray: a Ray cluster."""
    ray_address: str | None = None
    """Address of a running Ray cluster; by default $RAY_ADDRESS, or a new local cluster."""

    def __post_init__(self) -> None:
        super().__post_init__()
        check_address(self.ray_address, self.evaluator)
        if self.threads and self.evaluator == "ray":
            raise CaterpillarError(
                "--threads requires --evaluator local; Ray uses all cores of its cluster"
            )

    def make_evaluator(self) -> Evaluator:
        """Make the evaluator."""
        if self.evaluator == "ray":
            return RayEvaluator(self.ray_address)
        return LocalEvaluator(self.threads)


class Reporter:
    """Shows the progress of a run: a line per generation and, on a terminal, a progress bar."""

    def __init__(self, config: RunConfig, console: Console) -> None:
        self._config, self._console = config, console
        self._bar = cli.bar(console)
        self._task = self._bar.add_task("generation 0", total=1.0)
        self._done, self._step = 0.0, 1.0 / config.generations

    def __enter__(self) -> Reporter:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    @property
    def share_done(self) -> float:
        """Completed share of the run, in [0, 1]."""
        return self._bar.tasks[0].completed

    def generation(self, generation: Generation) -> None:
        """Report a completed generation."""
        done = self._config.share_done(generation.number + 1, generation.simulated_s)
        self._step, self._done = done - self._done, done  # estimate for the next generation
        following = f"generation {generation.number + 1}"
        if generation.replayed:  # exclude replayed generations from the estimate of the time left
            self._bar.reset(self._task)
        self._bar.update(self._task, completed=done, description=following)
        failures = ", ".join(f"{n} {name}" for name, n in generation.failures.items() if n) or "none"
        line = (
            f"generation {generation.number:3d}  best {1000 * generation.best_m:6.1f} mm  "
            f"mean {1000 * generation.mean_m:5.1f} mm  failed: {failures}  "
            f"simulated {generation.simulated_s:,.0f} s  {100 * done:.0f} % done"
        )
        self._console.print(line + cli.time_left(self._bar, self._console))

    def progress(self, share: float) -> None:
        """Report the share of the current generation that is evaluated."""
        self._bar.update(self._task, completed=self._done + share * self._step)


def finish(history: History, console: Console, *, video: bool) -> int:
    """Report why a run ended, write its video and page, and return the exit status."""
    is_over = history.finished and history.stop_reason() is not None  # None if a replay was stopped
    if is_over:
        console.print(f"finished: {history.stop_reason()}")
    else:
        console.print(f"stopped; continue with: caterpillar resume {shlex.quote(str(history.folder))}")
    write_results(history, console, video=video)
    return 0 if is_over else 130


def write_results(history: History, console: Console, *, video: bool) -> None:
    """Write the video and the page of a run, and print their paths and the next commands."""
    from caterpillar_env.drawing.video import Recording, is_video_of
    from evolution.report import run_page

    best, path = history.best_robot, history.folder / "best.mp4"
    recording = None
    if best is not None and video and not is_video_of(path, best):
        recording = Recording(best)  # the page uses the same recording
        cli.film(recording, path, console)
    page = run_page.write(history, recording)
    if best is None:
        none_failed = "no robot crawled forwards without failing"
        print(f"best: none, {none_failed if history.generations else 'no generation is complete'}")
    else:
        distance = f"{1000 * (best.fitness_m or 0.0):.1f} mm in 30 s"
        print(f"best: {distance}, evaluation {best.evaluation} in generation {best.generation}")
        if is_video_of(path, best):
            print(f"film: {path}")
    print(f"page: {page}")
    print_commands(history)


def print_commands(history: History) -> None:
    """Print commands for the next steps with a run."""
    from evolution.report.run_page import next_commands

    for command, purpose in next_commands(history, shlex.quote(str(history.folder))):
        print(f"next: {command}  # {purpose}")
