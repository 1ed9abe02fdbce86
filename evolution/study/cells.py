"""Runs the cells of a study, in processes of this machine or as tasks of a Ray cluster.

A cell is one run: an arm with a seed. It communicates with its study through its run folder only: the
study reads the progress from the cell's journal, and a stopped cell continues from this journal.
"""

from __future__ import annotations

import multiprocessing
import multiprocessing.connection
import os
import signal
import threading
from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from multiprocessing.connection import Connection
from pathlib import Path

import polars

from caterpillar_env.errors import CaterpillarError
from evolution.run.cluster import Cluster, ClusterError, RayEvaluator
from evolution.run.database import lock
from evolution.run.evaluators import LocalEvaluator
from evolution.run.journal import FILE, read_simulated_s
from evolution.study.arms import Arm
from evolution.study.config import NO_LOCKS, Cell, StudyConfig
from evolution.study.results import is_finished, read_all

_POLL_S = 0.5
#: An arm, the first arguments of `Arm.run`, and evaluations to continue from if there is no journal.
_Task = tuple[Arm, Path, int, float, polars.DataFrame | None]


class Processes:
    """Runs each cell in a process of this machine, at most `count` at a time."""

    def __init__(self, count: int) -> None:
        self.count = count
        self._processes: list[multiprocessing.process.BaseProcess] = []
        self._ended = False
        self._lock = threading.Lock()  # so that no process starts after `__exit__`

    def __enter__(self) -> Processes:
        return self

    def __exit__(self, *_: object) -> None:
        with self._lock:
            self._ended = True
        for process in self._processes:
            process.terminate()
        for process in self._processes:
            process.join()

    def run(self, task: _Task, cells: int) -> None:
        """Run a cell to its end. `cells` is the number of unfinished cells.

        Raises:
            CaterpillarError: the cell raised an error, or its process was killed.
        """
        context = multiprocessing.get_context("spawn")
        receiver, sender = context.Pipe(duplex=False)
        process = context.Process(target=_run_in_process, args=(sender, task), daemon=True)
        with self._lock:
            if self._ended:
                raise CaterpillarError("the study was stopped")
            process.start()
            self._processes.append(process)
        sender.close()
        try:
            error = receiver.recv()
        except EOFError:  # no error was sent
            process.join()
            error = f"its process ended with status {process.exitcode}" if process.exitcode else None
        if error is not None:
            raise CaterpillarError(error)


def _run_in_process(errors: Connection, task: _Task) -> None:
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # the parent handles Ctrl-C
    threading.Thread(target=_exit_with_parent, daemon=True).start()
    try:
        _run(*task)
    except Exception as error:
        errors.send(f"{type(error).__name__}: {error}")


def _exit_with_parent() -> None:
    """End this process when its parent is killed. This releases the lock of the run folder."""
    parent = multiprocessing.parent_process()
    assert parent is not None
    multiprocessing.connection.wait([parent.sentinel])
    os._exit(1)  # committed evaluations are safe


class RayTasks:
    """Runs each cell as a task of a Ray cluster, whose machines share the study's folder.

    If there are fewer cells than cores, the genomes of each cell are evaluated on the cluster too.

    Args:
        address: address of the cluster (see `evolution.run.cluster.Cluster`).
    """

    count = 1000  #: maximum number of cells that are submitted at a time; Ray runs one per core

    def __init__(self, address: str | None = None) -> None:
        self._cluster = Cluster(address)
        self._references: list[object] = []

    def __enter__(self) -> RayTasks:
        self._cluster.__enter__()
        return self

    def __exit__(self, *exception: object) -> None:
        self._cluster.cancel(self._references)
        self._cluster.__exit__(*exception)

    def run(self, task: _Task, cells: int) -> None:
        """Run a cell to its end. `cells` is the number of unfinished cells.

        Raises:
            ClusterError: the cluster was lost.
            CaterpillarError: the cell raised an error, or was cancelled.
        """
        share = 1 / cells if cells < self._cluster.cores else None
        reference = self._cluster.submit(_run, *task, share)
        self._references.append(reference)
        try:
            self._cluster.get(reference)
        except ClusterError:
            raise
        except Exception as error:
            raise CaterpillarError(f"{type(error).__name__}: {error}") from None
        finally:
            self._references.remove(reference)


def run_study(
    config: StudyConfig,
    folder: Path,
    workers: Processes | RayTasks,
    on_progress: Callable[[int, float], None] | None = None,
) -> list[tuple[Cell, str]]:
    """Run all unfinished cells. A cell that fails does not stop the others.

    A cell continues from its journal or, without one, from its evaluations in the study's table.

    Args:
        config: the study.
        folder: folder of the study (see `evolution.study.config.begin`).
        workers: object that runs the cells.
        on_progress: called twice a second with the number of cells that have ended, and with the
            completed share of the simulated seconds of all cells, in [0, 1].

    Returns:
        The cells that failed, each with its error.

    Raises:
        ClusterError: the Ray cluster cannot be reached, or was lost.
        JournalError: another process is running the study.
    """
    with lock(folder, NO_LOCKS), workers:
        cells, known = config.cells(), read_all(config, folder)
        pool = ThreadPoolExecutor(workers.count)
        futures: dict[Future[None], Cell] = {}
        try:
            unfinished = [cell for cell in cells if not is_finished(config, cell, known.get(cell))]
            for cell in unfinished:
                run, budget_s = cell.folder(folder).resolve(), config.budget_of(cell)
                task = (config.arms[cell.arm], run, cell.seed, budget_s, known.get(cell))
                futures[pool.submit(workers.run, task, len(unfinished))] = cell
            recorded_s = {cell: float(rows["simulated_s"].sum()) for cell, rows in known.items()}
            del known
            total_s = sum(config.budget_of(cell) for cell in cells)
            pending = set(futures)
            while pending:
                done, pending = wait(pending, _POLL_S, FIRST_COMPLETED)
                for future in done:
                    if isinstance(error := future.exception(), ClusterError):
                        raise error
                if on_progress is not None:
                    left_s = 0.0
                    for cell in (futures[future] for future in pending):
                        # A run from the table has no journal until its process has restored it.
                        spent_s = max(read_simulated_s(cell.folder(folder)), recorded_s.get(cell, 0.0))
                        left_s += max(config.budget_of(cell) - spent_s, 0.0)
                    on_progress(len(cells) - len(pending), 1.0 - left_s / total_s)
        finally:
            pool.shutdown(wait=False, cancel_futures=True)
    errors = {cell: future.exception() for future, cell in futures.items()}
    return [(cell, str(error)) for cell, error in errors.items() if error is not None]


def _run(
    arm: Arm,
    folder: Path,
    seed: int,
    budget_s: float,
    rows: polars.DataFrame | None,
    share: float | None = None,
) -> None:
    """Run a cell on one thread of this process or, given a share, on that share of its Ray cluster."""
    if rows is not None and not (folder / FILE).exists():
        arm.restore(rows, folder, seed, budget_s)
    evaluator = LocalEvaluator(1) if share is None else RayEvaluator(share=share)
    if not arm.run(folder, seed, budget_s, evaluator):
        raise CaterpillarError(f"{folder} was interrupted; run the study again to continue")
