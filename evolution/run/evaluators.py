"""Where genomes are evaluated: on this machine's threads, or on the workers of a Ray cluster.

A result depends on the genome and its encoding alone, bit for bit: not on the evaluator, the number of
workers, or which genomes are evaluated side by side.
"""

from __future__ import annotations

import os
import socket
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Protocol

from caterpillar_env.arrays import Array
from caterpillar_env.errors import CaterpillarError
from caterpillar_env.physics import CONTROL_INTERVAL_S
from caterpillar_env.robot import Outcomes, simulate
from caterpillar_env.task import EPISODE_S
from evolution.genome import Encoding

CHUNK = 50  #: genomes that are evaluated, and recorded, together


class EvaluationError(CaterpillarError):
    """An evaluation raised something; the run stops, and nothing is scored."""


class Evaluator(Protocol):
    """Evaluates chunks of genomes; a context that frees what it holds."""

    def __enter__(self) -> Evaluator: ...

    def __exit__(self, *_: object) -> None: ...

    def map(
        self,
        encoding: Encoding,
        chunks: Sequence[Array],
        on_progress: Callable[[float], None] | None = None,
    ) -> Iterator[Outcomes]:
        """The outcomes of each chunk, in the order of the chunks, as they are done.

        `on_progress` is told the share of a chunk that is done beyond those already given.
        """
        ...


def evaluate(
    genomes: Array,
    encoding: Encoding,
    *,
    threads: int = 0,
    duration_s: float = EPISODE_S,
    on_progress: Callable[[float], None] | None = None,
) -> Outcomes:
    """Let the robots of P genomes crawl side by side, each until it fails.

    Args:
        genomes: in [0, 1], shape (P, n).
        encoding: what they stand for; the gait period a whole number of control intervals.
        threads: 0 means all cores; results do not depend on it.
        duration_s: how long each crawls.
        on_progress: told the share that is done.
    """
    intervals = 0

    def tick(_: object) -> None:
        nonlocal intervals
        intervals += 1
        if on_progress is not None:
            on_progress(intervals * CONTROL_INTERVAL_S / duration_s)

    bodies, timings = encoding.decode(genomes)
    return simulate(
        bodies, timings, encoding.physics, threads=threads, duration_s=duration_s, on_interval=tick
    )


class LocalEvaluator:
    """Threads of this process.

    Args:
        threads: 0 means all cores; results do not depend on it.
    """

    def __init__(self, threads: int = 0) -> None:
        self._threads = threads

    def __enter__(self) -> LocalEvaluator:
        return self

    def __exit__(self, *_: object) -> None:
        pass

    def map(
        self,
        encoding: Encoding,
        chunks: Sequence[Array],
        on_progress: Callable[[float], None] | None = None,
    ) -> Iterator[Outcomes]:
        """See `Evaluator.map`."""
        for chunk in chunks:
            yield explained(chunk, encoding, threads=self._threads, on_progress=on_progress)


def explained(genomes: Array, encoding: Encoding, **kwargs: Any) -> Outcomes:
    """Evaluate; what goes wrong is told with the genome that caused it.

    Raises:
        EvaluationError: an evaluation raised an exception, here or at a second try one by one.
    """
    try:
        return evaluate(genomes, encoding, **kwargs)
    except Exception as error:
        for genome in genomes:
            try:
                evaluate(genome[None], encoding, threads=1)
            except Exception as cause:
                raise EvaluationError(
                    f"evaluating a genome failed with {type(cause).__name__}: {cause}. The genome was "
                    f"{genome.tolist()}"
                ) from cause
        raise EvaluationError(
            f"evaluating {len(genomes)} genomes together failed with {type(error).__name__}: {error}; "
            "each of them alone did not"
        ) from error


class RayEvaluator:
    """Workers of a Ray cluster, a chunk to each at a time; the chunk of a lost one is evaluated anew.

    Args:
        address: of a running cluster ("auto" finds the one that this machine belongs to); None starts
            one on this machine, which ends with the evaluator.

    Raises:
        EvaluationError: Ray is not installed, or no cluster can be reached.
    """

    def __init__(self, address: str | None = None) -> None:
        self._address = address
        self._started = False

    def __enter__(self) -> RayEvaluator:
        try:
            import ray
        except ImportError:
            raise EvaluationError(
                "the Ray evaluator needs Ray: pip install 'caterpillar-sma[ray]'"
            ) from None
        if not ray.is_initialized():
            _reachable(self._address)
            os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
            try:
                ray.init(
                    self._address, log_to_driver=False, include_dashboard=False, logging_level="ERROR"
                )
            except (ConnectionError, ValueError, RuntimeError) as error:
                raise EvaluationError(
                    f"no Ray cluster at {self._address or 'this machine'}: {error}"
                ) from None
            self._started = True
        return self

    def __exit__(self, *_: object) -> None:
        import ray

        if self._started:
            ray.shutdown()

    def map(
        self,
        encoding: Encoding,
        chunks: Sequence[Array],
        on_progress: Callable[[float], None] | None = None,
    ) -> Iterator[Outcomes]:
        """See `Evaluator.map`; progress is told by whole chunks only."""
        import ray

        # As many workers as cores, one thread each; a lost worker's task is started again elsewhere.
        remote = ray.remote(num_cpus=1, max_retries=-1)(explained)
        shared = ray.put(encoding)
        pending = [remote.remote(chunk, shared, threads=1) for chunk in chunks]
        try:
            while pending:
                try:
                    outcomes: Outcomes = ray.get(pending[0])
                except ray.exceptions.RayTaskError as error:
                    raise error.as_instanceof_cause() from None
                del pending[0]
                yield outcomes
        finally:
            # Only what nobody has: to cancel by force what is just done aborts Ray 2.60, and us with it.
            for reference in pending:
                ray.cancel(reference)


def _reachable(address: str | None) -> None:
    """Whether somebody listens there; Ray itself tries for minutes, and then ends the process."""
    host, _, port = (address or "").removeprefix("ray://").rpartition(":")
    if not port.isdigit():
        return  # "auto", "local" or none: Ray knows
    try:
        socket.create_connection((host, int(port)), timeout=5).close()
    except OSError as error:
        raise EvaluationError(
            f"no Ray cluster at {address} ({error.strerror or error}); `ray start --head` begins one; "
            "without an address one is started on this machine"
        ) from None
