"""What commands that run something share: where it is computed, what is told, what is left behind."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from rich.console import Console

from caterpillar_env.errors import CaterpillarError
from caterpillar_env.robot import AnyRobot
from evolution import cli
from evolution.config import RunConfig
from evolution.report.tensorboard import FOLDER as TENSORBOARD
from evolution.report.tensorboard import TensorBoard
from evolution.run.evaluators import Evaluator, LocalEvaluator, RayEvaluator
from evolution.run.history import Generation, History


def check_threads(threads: int) -> None:
    """See that there can be so many.

    Raises:
        CaterpillarError: there cannot.
    """
    if threads < 0:
        raise CaterpillarError(f"threads = {threads} must not be negative; 0 is all cores")


def check_address(address: str | None, evaluator: str) -> None:
    """See that an address of a cluster is not ignored.

    Raises:
        CaterpillarError: it would be.
    """
    if address is not None and evaluator != "ray":
        raise CaterpillarError("--ray-address needs --evaluator ray: add that, or leave it out")


@dataclass(frozen=True)
class WorkerArgs:
    """Where a run is computed, which makes no difference to its results."""

    evaluator: Literal["local", "ray"] = "local"
    """local: threads of this machine; ray: a Ray cluster."""
    ray_address: str | None = None
    """Address of a running Ray cluster; by default one is started here, and ended with the run."""
    threads: int = 0
    """Threads to simulate on, where the evaluator is local; 0 for all cores."""
    video: bool = True
    """Write best.mp4, a video of the best robot."""
    track: Literal["nowhere", "tensorboard"] = "nowhere"
    """tensorboard: log into the run folder too; a run that does goes on doing so when resumed."""

    def __post_init__(self) -> None:
        check_threads(self.threads)
        check_address(self.ray_address, self.evaluator)

    def make(self) -> Evaluator:
        """The evaluator."""
        return (
            LocalEvaluator(self.threads) if self.evaluator == "local" else RayEvaluator(self.ray_address)
        )

    @contextmanager
    def following(self, reporter: Reporter, folder: Path) -> Iterator[Callable[[Generation], None]]:
        """What a run tells its generations to."""
        if self.track == "nowhere" and not (folder / TENSORBOARD).is_dir():
            yield reporter.generation
            return
        with TensorBoard(folder) as board:

            def told(generation: Generation) -> None:
                reporter.generation(generation)
                board.generation(generation)

            yield told


class Reporter:
    """Tells how a run goes: a live bar on a terminal, a line per generation elsewhere."""

    def __init__(self, config: RunConfig, console: Console) -> None:
        self._config, self._console = config, console
        self._bar = cli.bar(console)
        self._task = self._bar.add_task("generation 0", total=1.0)
        self._done, self._step, self._replayed = 0.0, 1.0 / config.generations, 0.0

    def __enter__(self) -> Reporter:
        self._bar.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bar.stop()

    def generation(self, told: Generation) -> None:
        """Print what a generation brought."""
        done = self._config.share_done(told.evaluations, told.simulated_s)
        left = self._config.generations - told.number - 1
        # Of a budget it is not known how many generations are left: the next one is like the last.
        even = (1.0 - done) / left if left else 0.0
        self._step = even if self._config.budget_s is None else done - self._done
        self._done = done
        failures = ", ".join(f"{n} {reason}" for reason, n in told.failures.items() if n) or "none"
        line = (
            f"generation {told.number:3d}  best {1000 * told.best_m:6.1f} mm  "
            f"mean {1000 * told.mean_m:5.1f} mm  failed: {failures}  "
            f"simulated {told.simulated_s:,.0f} s"
        )
        if told.replayed:
            self._replayed = done  # it took no time, and says nothing of what is left
        computed = done - self._replayed
        if not self._console.is_terminal and computed > 0:
            line += f"  left {told.elapsed_s / computed * (1.0 - done) / 60:.1f} min"
        self._console.print(line, soft_wrap=True)
        self._bar.update(self._task, completed=done, description=f"generation {told.number + 1}")

    def progress(self, share: float) -> None:
        """Move the bar within a generation."""
        self._bar.update(self._task, completed=self._done + share * self._step)


def finish(result: History, config: RunConfig, folder: Path, console: Console, *, video: bool) -> int:
    """Say why the run ended, and leave pictures of the best robot; the exit status."""
    status = 0 if result.finished else 130
    if not result.finished:
        console.print(f"stopped; go on with: caterpillar resume {folder}")
    elif config.target_m is not None or config.budget_s is not None:  # else there is one end only
        last = result.generations[-1]
        why = config.ending(len(result.generations), last.simulated_s, last.farthest_m)
        console.print(f"{'nothing left to do' if last.replayed else 'ended'}: {why}")
    picture(folder, console, video=video)
    return status


def picture(folder: Path, console: Console, *, video: bool) -> Path:
    """Tell the best robot of a run, and leave its pictures and its page in the folder; the page."""
    from caterpillar_env.drawing.video import is_video_of
    from evolution.report import run_page

    record = History.read(folder)
    best = record.best_robot
    if best is None:
        if record.generations:
            console.print(f"no robot crawled forwards without failing; see caterpillar export {folder}")
    else:
        print(
            f"best: {1000 * (best.fitness_m or 0):.1f} mm in 30 s "
            f"(generation {best.generation}), in {folder}"
        )
        path = folder / "best.mp4"
        if video and not (path.exists() and is_video_of(path, best)):
            film(best, path, console)
    return run_page.write(folder)


def film(robot: AnyRobot, path: Path, console: Console, timestep_s: float | None = None) -> None:
    """Write a video; a machine that cannot draw costs only the video."""
    from caterpillar_env.drawing.video import Recording, write_video

    console.print(f"writing {path} ...")
    try:
        write_video([Recording(robot, timestep_s=timestep_s)], path)
    except CaterpillarError as error:
        console.print(f"no video: {error}")
