"""Connection to a Ray cluster, for runs and studies, and an evaluator that uses it.

If a worker or a node is lost, Ray repeats its tasks on other workers. If the head of the cluster is
lost, this module raises a `ClusterError` after `HEAD_TIMEOUT_S`.
"""

from __future__ import annotations

import math
import os
import signal
import socket
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any, Self

import numpy as np
from numpy.typing import NDArray

from caterpillar_env.errors import CaterpillarError
from evolution.genome import Encoding
from evolution.run import evaluators
from evolution.run.evaluators import Evaluator, Job, OnProgress, Result, run_job

_CONNECT_TIMEOUT_S = 5.0
_CHECK_S = 2.0  # time between two checks of the head
_RETRIES = 10  # retries of a task whose worker was lost
_LEAST_TASK_S = 0.05  # minimum duration of a task; Ray needs about this time to start one
#: The head counts as lost if it does not answer for this time. Ray would end the process after 60 s.
HEAD_TIMEOUT_S = 15.0
CORE_TIMEOUT_S = 600.0  #: longest time without any core in the cluster


class ClusterError(CaterpillarError):
    """The cluster cannot be reached, or was lost. Everything that was recorded before is kept."""


class Cluster:
    """Connection to a Ray cluster. An existing connection of this process is used, and left open.

    Args:
        address: HOST:PORT of the head of a running cluster, or "auto" for the cluster of this machine.
            If None, the environment variable RAY_ADDRESS gives the address, as in a Ray job. Without
            this variable, a cluster on this machine is started, and stopped at the end of the context.
    """

    def __init__(self, address: str | None = None) -> None:
        self._address = address
        self._connected = False
        self._processes: list[Any] = []  # processes of the cluster, if this object started it
        self._remotes: dict[Callable[..., Any], Any] = {}
        self._lock = threading.Lock()
        self._head = self._node = ""
        self._cores = 0
        self._checked_s = 0.0  # this and the next two are times of `time.monotonic`
        self._silent_since_s: float | None = None
        self._empty_since_s: float | None = None

    def __enter__(self) -> Self:
        """Connect.

        Raises:
            ClusterError: Ray is not installed, or no cluster can be reached.
        """
        # Without this, calls of Ray after its shutdown would start a new cluster on this machine.
        os.environ.setdefault("RAY_ENABLE_AUTO_CONNECT", "0")
        try:
            import ray
        except ImportError:
            raise ClusterError("Ray is not installed: pip install 'caterpillar-sma[ray]'") from None
        if not ray.is_initialized():
            self._connect()
        context = ray.get_runtime_context()
        self._head, self._node = context.gcs_address, context.get_node_id()
        self._silent_since_s = self._empty_since_s = None
        return self

    def _connect(self) -> None:
        import ray
        from psutil import Process  # included in Ray

        # Without "local", Ray would use any cluster that was started on this machine.
        address = self._address or os.environ.get("RAY_ADDRESS") or "local"
        _check_reachable(address)
        os.environ.setdefault("RAY_ACCEL_ENV_VAR_OVERRIDE_ON_ZERO", "0")
        before, on_term = set(Process().children()), signal.getsignal(signal.SIGTERM)
        try:
            ray.init(address, log_to_driver=False, include_dashboard=False, logging_level="ERROR")
        except Exception as error:  # Ray raises a plain Exception if a node starts too slowly
            raise ClusterError(
                f"a Ray cluster cannot be reached or started (address {address}): {error}"
            ) from None
        self._connected = True
        if threading.current_thread() is threading.main_thread():
            signal.signal(signal.SIGTERM, on_term)  # Ray's own handler would end the process at once
        # Include the children of Ray's processes: without the head, some agents of Ray would never end.
        for process in set(Process().children()) - before:
            self._processes += [process, *process.children(recursive=True)]

    def __exit__(self, *_: object) -> None:
        import ray

        if self._connected:
            from psutil import NoSuchProcess, wait_procs

            ray.shutdown()
            self._connected = False
            for process in wait_procs(self._processes, timeout=2.0)[1]:
                try:
                    process.kill()
                except NoSuchProcess:
                    continue

    @property
    def cores(self) -> int:
        """Current number of cores in the cluster, at least 1. Nodes may join and leave at any time.

        Raises:
            ClusterError: the cluster was lost.
        """
        while not self._check(now=True):
            time.sleep(_CHECK_S / 2)
        return max(1, self._cores)

    def submit(self, function: Callable[..., Any], *args: Any) -> Any:
        """Start a task with one core, and return its reference. Ray repeats it if its worker is lost."""
        import ray

        with self._lock:
            if function not in self._remotes:
                self._remotes[function] = ray.remote(num_cpus=1, max_retries=_RETRIES)(function)
        return self._remotes[function].remote(*args)

    def get(self, reference: Any) -> Any:
        """Wait for a task, and return its result.

        Raises:
            ClusterError: the cluster was lost.
            CaterpillarError: the task lost its worker too often, or was cancelled.
            Exception: the error that the task raised.
        """
        import ray

        try:
            while not ray.wait([reference], timeout=_CHECK_S)[0]:
                self._check()
            return ray.get(reference)
        except ray.exceptions.RayTaskError as error:
            raise error.cause from None
        except ray.exceptions.LocalRayletDiedError:
            raise ClusterError(_RAYLET_LOST) from None
        except ray.exceptions.RayError as error:
            raise CaterpillarError(
                f"a task on the Ray cluster was lost ({type(error).__name__}), most likely because of "
                f"too little memory; see `ray list nodes`. {_ADVICE}. Ray says: {error}"
            ) from None

    def cancel(self, references: Sequence[Any]) -> None:
        """Cancel tasks that have not finished. They receive a KeyboardInterrupt."""
        import ray

        # Never with force: this crashes Ray 2.60 if the task has just finished.
        for reference in references:
            ray.cancel(reference)

    def _check(self, *, now: bool = False) -> bool:
        """Return whether the head answers, and count the cores.

        If the head is lost, Ray's own calls block, and end the process after a minute. Therefore this
        method connects to the head first.

        Args:
            now: check even if the last check was less than `_CHECK_S` ago.

        Raises:
            ClusterError: the head did not answer, or there was no core, for too long.
        """
        import ray

        with self._lock:
            time_s = time.monotonic()
            if not now and time_s - self._checked_s < _CHECK_S:
                return True
            self._checked_s = time_s
            host, _, port = self._head.rpartition(":")
            try:
                socket.create_connection((host, int(port)), timeout=_CONNECT_TIMEOUT_S).close()
            except OSError as error:
                self._silent_since_s = self._silent_since_s or time_s
                if time_s - self._silent_since_s < HEAD_TIMEOUT_S:
                    return False
                raise ClusterError(
                    f"the head of the Ray cluster at {self._head} has not answered for "
                    f"{HEAD_TIMEOUT_S:.0f} s ({error.strerror or error}). {_ADVICE}"
                ) from None
            self._silent_since_s = None
            alive = [node for node in ray.nodes() if node["Alive"]]
            if self._node not in [node["NodeID"] for node in alive]:
                raise ClusterError(_RAYLET_LOST)
            self._cores = int(sum(node["Resources"].get("CPU", 0) for node in alive))
            self._empty_since_s = None if self._cores else self._empty_since_s or time_s
            if self._empty_since_s and time_s - self._empty_since_s > CORE_TIMEOUT_S:
                raise ClusterError(
                    f"the Ray cluster at {self._head} has had no core for {CORE_TIMEOUT_S:.0f} s; add a "
                    f"machine with `ray start --address={self._head}`. {_ADVICE}"
                )
            return True


_ADVICE = (
    "Recorded evaluations are kept: start the cluster again, and continue with `caterpillar resume`, or "
    "with the same `caterpillar study` command"
)
_RAYLET_LOST = f"the raylet, Ray's process on this machine, has ended. {_ADVICE}"


def _check_reachable(address: str) -> None:
    """Raise an error if nothing listens at HOST:PORT; Ray would retry for minutes and then abort."""
    if address.startswith("ray://"):
        raise ClusterError(
            f"the address {address} needs Ray Client, which is not supported; run this on a machine of "
            "the cluster with the HOST:PORT of its head, or use `ray job submit` (see "
            "docs/howto/cluster.md)"
        )
    host, _, port = address.rpartition(":")
    if not port.isdigit():
        return  # "auto" or "local"
    try:
        socket.create_connection((host, int(port)), timeout=_CONNECT_TIMEOUT_S).close()
    except (OSError, OverflowError) as error:
        raise ClusterError(
            f"no Ray cluster at {address} ({getattr(error, 'strerror', None) or error}); "
            "start a cluster with `ray start --head`, or omit the address and unset RAY_ADDRESS to "
            "start a cluster on this machine"
        ) from None


def chunk_sizes(count: int, workers: int, least: int = 1) -> list[int]:
    """Return the sizes of chunks that keep all workers busy until the end of a generation.

    The chunks become smaller: in each round, half of the remaining genomes are divided equally among the
    workers (factoring, Hummel et al. 1992, Communications of the ACM 35(8)). Large chunks cost less per
    genome, and small chunks at the end shorten the wait for the last worker.

    Args:
        count: number of genomes.
        workers: number of workers.
        least: minimum number of genomes in a chunk, except in the last one.
    """
    sizes: list[int] = []
    while count > 0:
        size = min(max(math.ceil(count / (2 * workers)), least), evaluators.CHUNK)
        for _ in range(min(workers, math.ceil(count / size))):
            sizes.append(min(size, count))
            count -= sizes[-1]
    return sizes


class RayEvaluator(Evaluator):
    """Evaluates on the cores of a Ray cluster. Each task simulates a chunk of genomes on one core.

    Args:
        address: see `Cluster`.
        share: share of the cluster's cores, in (0, 1], for which `split` divides the genomes. A smaller
            share makes the chunks larger. The tasks may still run on all cores.
    """

    def __init__(self, address: str | None = None, share: float = 1.0) -> None:
        self._cluster = Cluster(address)
        self._share = share
        self._genome_s = math.inf  # time per genome in the last job

    def __enter__(self) -> Self:
        self._cluster.__enter__()
        return self

    def __exit__(self, *exception: object) -> None:
        self._cluster.__exit__(*exception)

    def split(self, rows: NDArray[Any]) -> list[NDArray[Any]]:
        """Split an array into chunks that suit the number of cores and the cost of a genome."""
        workers = math.ceil(self._share * self._cluster.cores)
        least = math.ceil(_LEAST_TASK_S / self._genome_s)
        sizes = chunk_sizes(len(rows), workers, max(least, 1))
        return np.split(rows, np.cumsum(sizes)[:-1]) if sizes else []

    def map(
        self, encoding: Encoding, jobs: Sequence[Job], on_progress: OnProgress | None = None
    ) -> Iterator[Result]:
        """See `Evaluator.map`. Progress is reported once per job, at its end."""
        pending = [self._cluster.submit(self._work, job, encoding) for job in jobs]
        try:
            for job in jobs:
                result, spent_s = self._cluster.get(pending[0])
                del pending[0]
                self._genome_s = max(spent_s, 1e-6) / max(len(job.genomes), 1)
                if on_progress is not None:
                    on_progress(1.0)
                yield result
        except ClusterError:
            pending.clear()  # without a cluster, cancelling them would block
            raise
        finally:
            self._cluster.cancel(pending)

    @staticmethod
    def _work(job: Job, encoding: Encoding) -> tuple[Result, float]:
        """Do a job on one thread of a worker; return its result, and the time it took in s."""
        started = time.perf_counter()
        result = run_job(job, encoding, threads=1)
        return result, time.perf_counter() - started
