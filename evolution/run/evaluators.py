"""Evaluators: they simulate genomes on this machine, or on a Ray cluster (`evolution.run.cluster`).

A result depends only on the genome and its encoding, bit for bit. It does not depend on the evaluator,
the number of workers, or the genomes that are evaluated together.
"""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterator, Sequence
from typing import Any, NamedTuple, Protocol, Self

from numpy.typing import NDArray

from caterpillar_env.arrays import Array
from caterpillar_env.robot import Outcomes, gait_power, repeat
from caterpillar_env.task import EPISODE_S, Crawl, CrawlState
from evolution.genome import Encoding

CHUNK = 50  #: largest number of genomes that are evaluated and recorded together

OnProgress = Callable[[float], None]  #: called with the share that is evaluated, in [0, 1]


class Job(NamedTuple):
    """Work for one worker: P genomes to simulate until `end_s`, from time 0 or from a recorded state."""

    genomes: Array  #: (P, n), values in [0, 1]
    end_s: float = EPISODE_S
    start: CrawlState | None = None  #: state to continue from; None means time 0


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

    def split(self, rows: NDArray[Any]) -> list[NDArray[Any]]:
        """Split an array, shape (P, ...), into chunks of genomes that are evaluated together."""
        return [rows[i : i + CHUNK] for i in range(0, len(rows), CHUNK)]

    def map(
        self, encoding: Encoding, jobs: Sequence[Job], on_progress: OnProgress | None = None
    ) -> Iterator[Result]:
        """Yield the result of each job, in order; see `run_job`.

        Args:
            encoding: maps the genomes to robots.
            jobs: jobs to run.
            on_progress: called with the completed share, in [0, 1], of the job whose result comes next.
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
    repeat(crawl, gait_power(timings, encoding.physics), job.end_s, on_progress=on_progress)
    end = crawl.get_state() if job.end_s < EPISODE_S else None
    return Result(Outcomes.of(crawl.progress()), end)


def run_jobs(
    evaluator: Evaluator,
    encoding: Encoding,
    jobs: Sequence[Job],
    on_progress: OnProgress | None = None,
    first: float = 0.0,
    last: float = 1.0,
) -> Generator[Result, None, None]:
    """Yield the result of each job, and report the progress on a scale from `first` to `last`."""
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
