"""Evaluators: they simulate genomes on the cores of this machine, or on a Ray cluster.

A result depends only on the genome and its encoding, bit for bit. It does not depend on the evaluator,
the number of workers, or the genomes that are evaluated together.
"""

from __future__ import annotations

import os
import socket
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, NamedTuple, Protocol, Self

from numpy.typing import NDArray

from caterpillar_env.arrays import Array
from caterpillar_env.errors import CaterpillarError
from caterpillar_env.robot import Outcomes, follow
from caterpillar_env.task import EPISODE_S, Crawl, CrawlState
from evolution.genome import Encoding

CHUNK = 50  #: number of genomes that are evaluated and recorded together
_CONNECT_TIMEOUT_S = 5.0

OnProgress = Callable[[float], None]  #: called with the share that is evaluated, in [0, 1]


class Job(NamedTuple):
    """Work for one worker: P genomes to simulate from the start, or from a state, to a time."""

    genomes: Array  #: (P, n), values in [0, 1]
    end_s: float = EPISODE_S
    start: CrawlState | None = None  #: state of the robots before; None means the start


class Result(NamedTuple):
    """Result of a `Job`."""

    outcomes: Outcomes
    end: CrawlState | None  #: state at `end_s`; None at the end of an episode


class Evaluator(Protocol):
    """Interface of evaluators. The context manager releases the workers."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        return None

    def map(
        self, encoding: Encoding, jobs: Sequence[Job], on_progress: OnProgress | None = None
    ) -> Iterator[Result]:
        """Yield the result of each job, in order; see `run_job`.

        Args:
            encoding: maps the genomes to robots.
            jobs: the work.
            on_progress: called with the share of the next job that is done, in [0, 1].
        """
        ...


def evaluate(
    genomes: Array, encoding: Encoding, *, threads: int = 0, on_progress: OnProgress | None = None
) -> Outcomes:
    """Simulate the robots of P genomes. Each robot stops when it fails.

    Args:
        genomes: array of shape (P, n) with values in [0, 1].
        encoding: maps the genomes to robots.
        threads: number of threads; 0 for all usable cores. Results do not depend on it.
        on_progress: called with the simulated share of the total duration, in [0, 1].

    Returns:
        The outcomes, arrays of shape (P,).
    """
    return run_job(Job(genomes), encoding, threads=threads, on_progress=on_progress).outcomes


def run_job(
    job: Job, encoding: Encoding, *, threads: int = 0, on_progress: OnProgress | None = None
) -> Result:
    """Do a job on this machine. For the arguments, see `evaluate`."""
    bodies, timings = encoding.decode(job.genomes)
    crawl = Crawl(bodies, encoding.physics, threads)
    if job.start is not None:
        crawl.set_state(job.start)
    follow(crawl, timings, job.end_s, on_progress=on_progress)
    end = crawl.get_state() if job.end_s < EPISODE_S else None
    return Result(Outcomes.of(crawl.progress()), end)


def split(rows: NDArray[Any]) -> list[NDArray[Any]]:
    """Split an array into chunks of `CHUNK` genomes, which are evaluated and recorded together."""
    return [rows[i : i + CHUNK] for i in range(0, len(rows), CHUNK)]


def run_jobs(
    evaluator: Evaluator,
    encoding: Encoding,
    jobs: Sequence[Job],
    on_progress: OnProgress | None = None,
    first: float = 0.0,
    last: float = 1.0,
) -> Iterator[Result]:
    """Yield the result of each job, and report a progress that rises from `first` to `last`."""
    sizes = [len(job.genomes) for job in jobs]
    number = 0

    def report(share: float) -> None:
        if on_progress is not None:
            done = (sum(sizes[:number]) + share * sizes[number]) / sum(sizes)
            on_progress(first + (last - first) * done)

    for result in evaluator.map(encoding, jobs, report):
        yield result
        number += 1


class LocalEvaluator(Evaluator):
    """Evaluates on threads of this process.

    Args:
        threads: number of threads; 0 for all usable cores. Results do not depend on it.
    """

    def __init__(self, threads: int = 0) -> None:
        self._threads = threads

    def map(
        self, encoding: Encoding, jobs: Sequence[Job], on_progress: OnProgress | None = None
    ) -> Iterator[Result]:
        """See `Evaluator.map`."""
        for job in jobs:
            yield run_job(job, encoding, threads=self._threads, on_progress=on_progress)


class RayEvaluator(Evaluator):
    """Evaluates on the workers of a Ray cluster, one job per worker at a time.

    The job of a lost worker is evaluated again elsewhere. For the address, see `connect_ray`.
    """

    def __init__(self, address: str | None = None) -> None:
        self._connection = connect_ray(address)

    def __enter__(self) -> Self:
        self._connection.__enter__()
        return self

    def __exit__(self, *exception: Any) -> None:
        self._connection.__exit__(*exception)

    def map(
        self, encoding: Encoding, jobs: Sequence[Job], on_progress: OnProgress | None = None
    ) -> Iterator[Result]:
        """See `Evaluator.map`. Workers report complete jobs, so `on_progress` is not called."""
        import ray

        # One thread per task, as many tasks as cores. Ray restarts the task of a lost worker.
        remote = ray.remote(num_cpus=1, max_retries=-1)(run_job)
        shared = ray.put(encoding)
        pending = [remote.remote(job, shared, threads=1) for job in jobs]
        try:
            while pending:
                try:
                    result: Result = ray.get(pending[0])
                except ray.exceptions.RayTaskError as error:
                    raise error.as_instanceof_cause() from None
                del pending[0]
                yield result
        finally:
            # Cancel only pending tasks: force-cancelling a finished one crashes Ray 2.60.
            for reference in pending:
                ray.cancel(reference)


@contextmanager
def connect_ray(address: str | None = None) -> Iterator[None]:
    """Connect to a Ray cluster, or use the existing connection.

    Args:
        address: address of a running cluster, or "auto" for the cluster of this machine. None starts a
            cluster on this machine and stops it at the end of the context.

    Raises:
        CaterpillarError: Ray is not installed, or no cluster can be reached.
    """
    try:
        import ray
    except ImportError:
        raise CaterpillarError("Ray is not installed: pip install 'caterpillar-sma[ray]'") from None
    if ray.is_initialized():
        yield
        return
    _check_reachable(address)
    os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
    try:
        ray.init(address, log_to_driver=False, include_dashboard=False, logging_level="ERROR")
    except (ConnectionError, ValueError, RuntimeError) as error:
        raise CaterpillarError(f"no Ray cluster at {address or 'this machine'}: {error}") from None
    try:
        yield
    finally:
        ray.shutdown()


def _check_reachable(address: str | None) -> None:
    """Raise an error if nothing listens at HOST:PORT; Ray would retry for minutes and then abort."""
    host, _, port = (address or "").removeprefix("ray://").rpartition(":")
    if not port.isdigit():
        return  # "auto", "local" or None
    try:
        socket.create_connection((host, int(port)), timeout=_CONNECT_TIMEOUT_S).close()
    except OSError as error:
        raise CaterpillarError(
            f"no Ray cluster at {address} ({error.strerror or error}); `ray start --head` starts one; "
            "without an address, one is started on this machine"
        ) from None
