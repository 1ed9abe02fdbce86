"""Where the cells of a study run: in processes of this machine, or as tasks of a Ray cluster.

Nothing passes between a cell and its study but the run folder: progress is read from its journal, and
a cell that was lost goes on from there.
"""

from __future__ import annotations

import contextlib
import multiprocessing
import multiprocessing.connection
import os
import signal
import threading
from collections.abc import Callable
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, NamedTuple, Protocol

from evolution.run.evaluators import RayEvaluator
from evolution.study.arms import Arm, Standing
from evolution.study.config import Cell, StudyConfig, StudyError, is_finished

_POLL_S = 0.5


class Workers(Protocol):
    """Run cells side by side; a context that stops those that still run."""

    def __enter__(self) -> Workers: ...

    def __exit__(self, *_: object) -> None: ...

    def start(self, cell: Cell, arm: Arm, folder: Path, budget_s: float) -> None:
        """Begin a cell, or go on with it."""
        ...

    def wait(self, timeout_s: float) -> list[tuple[Cell, str]]:
        """Cells that ended since, each with the error that ended it, or an empty text."""
        ...

    @property
    def free(self) -> int:
        """How many more cells can run now."""
        ...


class Processes:
    """A process of this machine for each cell, on one thread each.

    Args:
        count: how many at a time.
    """

    def __init__(self, count: int) -> None:
        if count < 1:
            raise StudyError(f"a study needs at least 1 process; got {count} (--processes 0: all cores)")
        self._count = count
        self._context = multiprocessing.get_context("spawn")
        self._running: dict[Cell, tuple[Any, Connection]] = {}

    def __enter__(self) -> Processes:
        return self

    def __exit__(self, *_: object) -> None:
        for process, _said in self._running.values():
            process.terminate()
        for process, _said in self._running.values():
            process.join()

    def start(self, cell: Cell, arm: Arm, folder: Path, budget_s: float) -> None:
        """See `Workers`."""
        ours, theirs = self._context.Pipe(duplex=False)
        process = self._context.Process(
            target=_in_process, args=(arm, folder, cell.seed, budget_s, theirs), daemon=True
        )
        process.start()
        theirs.close()
        self._running[cell] = process, ours

    def wait(self, timeout_s: float) -> list[tuple[Cell, str]]:
        """See `Workers`."""
        multiprocessing.connection.wait([p.sentinel for p, _ in self._running.values()], timeout_s)
        ended = []
        for cell, (process, said) in list(self._running.items()):
            if process.is_alive():
                continue
            process.join()
            error = ""
            if process.exitcode:
                error = f"its process ended with status {process.exitcode}"
            with contextlib.suppress(EOFError):  # nothing said
                error = said.recv()
            ended.append((cell, error))
            del self._running[cell]
        return ended

    @property
    def free(self) -> int:
        """See `Workers`."""
        return self._count - len(self._running)


def _in_process(arm: Arm, folder: Path, seed: int, budget_s: float, said: Connection) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's to answer
    threading.Thread(target=_end_with_parent, daemon=True).start()
    try:
        arm.run(folder, seed, budget_s)
    except Exception as error:
        said.send(f"{type(error).__name__}: {error}")


def _end_with_parent() -> None:
    """A study that was killed leaves no runs behind that would keep it from going on."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    multiprocessing.connection.wait([parent.sentinel])
    os._exit(1)  # a journal loses nothing by it


def _run(arm: Arm, folder: Path, seed: int, budget_s: float) -> None:
    arm.run(folder, seed, budget_s)


class RayTasks:
    """A task of a Ray cluster for each cell; its machines must all see the study's folder.

    Args:
        address: see `RayEvaluator`.
    """

    def __init__(self, address: str | None = None) -> None:
        self._cluster = RayEvaluator(address)
        self._running: dict[Any, Cell] = {}

    def __enter__(self) -> RayTasks:
        self._cluster.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        import ray

        for reference in self._running:
            ray.cancel(reference)
        self._cluster.__exit__()

    def start(self, cell: Cell, arm: Arm, folder: Path, budget_s: float) -> None:
        """See `Workers`."""
        import ray

        task = ray.remote(num_cpus=1, max_retries=-1)(_run)
        self._running[task.remote(arm, folder.resolve(), cell.seed, budget_s)] = cell

    def wait(self, timeout_s: float) -> list[tuple[Cell, str]]:
        """See `Workers`."""
        import ray

        done, _ = ray.wait(list(self._running), num_returns=1, timeout=timeout_s)
        ended = []
        for reference in done:
            error = ""
            try:
                ray.get(reference)
            except ray.exceptions.RayError as problem:
                cause = getattr(problem, "cause", problem)
                error = f"{type(cause).__name__}: {cause}"
            ended.append((self._running.pop(reference), error))
        return ended

    @property
    def free(self) -> int:
        """See `Workers`."""
        import ray

        return int(ray.cluster_resources().get("CPU", 1)) - len(self._running)


class Progress(NamedTuple):
    """What is told while a study runs."""

    finished: int  #: cells
    cells: int
    spent: float  #: share of all simulated seconds, in [0, 1]
    running: dict[Cell, Standing]


def run_study(
    config: StudyConfig,
    folder: Path,
    workers: Workers,
    on_progress: Callable[[Progress], None] | None = None,
) -> list[tuple[Cell, str]]:
    """Run every cell that is not finished; those that fail do not keep the others from running.

    Args:
        config: the study; `study.begin` has made its folder.
        folder: of the study.
        workers: where to run.
        on_progress: told twice a second.

    Returns:
        The cells that failed, each with its error.
    """
    cells = config.cells()
    waiting = [cell for cell in cells if not is_finished(config, cell, folder)]
    running: list[Cell] = []
    failed: list[tuple[Cell, str]] = []
    with workers:
        while waiting or running:
            while waiting and workers.free > 0:
                cell = waiting.pop(0)
                workers.start(cell, config.arms[cell.arm], cell.folder(folder), config.budget_s)
                running.append(cell)
            for cell, error in workers.wait(_POLL_S):
                running.remove(cell)
                if error:
                    failed.append((cell, error))
            if on_progress is not None:
                now = {cell: config.arms[cell.arm].standing(cell.folder(folder)) for cell in running}
                finished = len(cells) - len(waiting) - len(running) - len(failed)
                under_way = sum(min(s.simulated_s / config.budget_s, 1.0) for s in now.values())
                spent = (finished + len(failed) + under_way) / len(cells)
                on_progress(Progress(finished, len(cells), spent, now))
    return failed
