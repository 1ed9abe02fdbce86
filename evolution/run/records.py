"""The rows of a journal: evaluations, completed generations and sessions."""

from __future__ import annotations

import platform
from collections.abc import Sequence
from datetime import datetime
from importlib.metadata import version
from typing import NamedTuple

from caterpillar_env.arrays import Array
from caterpillar_env.task import Failure

_PACKAGES = ("caterpillar-sma", "mujoco", "numpy", "scipy", "cma")


class Evaluation(NamedTuple):
    """One genome and its outcome."""

    number: int  #: index among all evaluations of the run, from 0
    generation: int
    genome: Array  #: genes in [0, 1], shape (n,)
    failure: Failure
    distance_m: float
    energy_j: float
    simulated_s: float
    session: int


class Completion(NamedTuple):
    """The state of a run when a generation was completed."""

    generation: int
    evaluations: int  #: number of evaluations of the run so far
    best: int | None  #: number of the best evaluation so far
    objective: float | None  #: objective of that evaluation


class Session(NamedTuple):
    """One start or resumption of a run."""

    number: int  #: number of the session, from 1
    started: str  #: date and time, UTC
    finished: str | None  #: date and time, UTC; None if the run did not end in this session
    fingerprint: dict[str, str]  #: versions and machine type, see `fingerprint`

    @property
    def wall_s(self) -> float | None:
        """Wall time in s, to the second; None if the end was not recorded."""
        if self.finished is None:
            return None
        start, end = datetime.fromisoformat(self.started), datetime.fromisoformat(self.finished)
        return (end - start).total_seconds()


def fingerprint(packages: Sequence[str] = ()) -> dict[str, str]:
    """Return the versions, also of additional packages, and the machine type that results depend on."""
    versions = {name: version(name) for name in (*_PACKAGES, *packages)}
    return versions | {"python": platform.python_version(), "machine": platform.machine()}
