"""Evaluators: they simulate genomes on the cores of this machine, or on a Ray cluster.

A result depends only on the genome and its encoding, bit for bit. It does not depend on the evaluator,
the number of workers, or the genomes that are evaluated together.
"""

from __future__ import annotations

import os
import socket
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any, Protocol, Self

from caterpillar_env.arrays import Array
from caterpillar_env.errors import CaterpillarError
from caterpillar_env.robot import Outcomes, simulate
from evolution.genome import Encoding

CHUNK = 50  #: number of genomes that are evaluated and recorded together
_CONNECT_TIMEOUT_S = 5.0

OnProgress = Callable[[float], None]  #: called with the share that is evaluated, in [0, 1]


class Evaluator(Protocol):
    """Interface of evaluators. The context manager releases the workers."""

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        return None

    def map(
        self, encoding: Encoding, chunks: Sequence[Array], on_progress: OnProgress | None = None
    ) -> Iterator[Outcomes]:
        """Yield the outcomes of each chunk, in order.

        Args:
            encoding: maps the genomes to robots.
            chunks: arrays of genomes, each of shape (P, n).
            on_progress: called with the share of the next chunk that is evaluated, in [0, 1].
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
    bodies, timings = encoding.decode(genomes)
    return simulate(bodies, timings, encoding.physics, threads=threads, on_progress=on_progress)


class LocalEvaluator(Evaluator):
    """Evaluates on threads of this process.

    Args:
        threads: number of threads; 0 for all usable cores. Results do not depend on it.
    """

    def __init__(self, threads: int = 0) -> None:
        self._threads = threads

    def map(
        self, encoding: Encoding, chunks: Sequence[Array], on_progress: OnProgress | None = None
    ) -> Iterator[Outcomes]:
        """See `Evaluator.map`."""
        for chunk in chunks:
            yield evaluate(chunk, encoding, threads=self._threads, on_progress=on_progress)


class RayEvaluator(Evaluator):
    """Evaluates on the workers of a Ray cluster, one chunk per worker at a time.

    The chunk of a lost worker is evaluated again elsewhere. For the address, see `connect_ray`.
    """

    def __init__(self, address: str | None = None) -> None:
        self._connection = connect_ray(address)

    def __enter__(self) -> Self:
        self._connection.__enter__()
        return self

    def __exit__(self, *exception: Any) -> None:
        self._connection.__exit__(*exception)

    def map(
        self, encoding: Encoding, chunks: Sequence[Array], on_progress: OnProgress | None = None
    ) -> Iterator[Outcomes]:
        """See `Evaluator.map`. Workers report complete chunks, so `on_progress` is not called."""
        import ray

        # One thread per task, as many tasks as cores. Ray restarts the task of a lost worker.
        remote = ray.remote(num_cpus=1, max_retries=-1)(evaluate)
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
