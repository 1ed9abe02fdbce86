"""The journal of a run: one SQLite file with the configuration and every evaluation, in order.

Tables (readable with any SQLite tool; docs/runs.md describes the columns):

- `run`: one row with the configuration as JSON.
- `sessions`: one row each time the run was started or resumed, with the versions in use.
- `evaluations`: one row per genome, committed in chunks.
- `generations`: one row per completed generation, with the best evaluation so far.

Each row has a digest of its other columns, which detects damage (see `evolution.run.schema`). The state
of the optimizer is not stored: a run is resumed by replaying it from the journal.
"""

from __future__ import annotations

import json
import math
import os
import platform
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, closing
from datetime import UTC, datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from caterpillar_env.arrays import Array
from caterpillar_env.errors import check_number
from caterpillar_env.files import parse_json
from caterpillar_env.task import Failure
from evolution.run import schema
from evolution.run.database import (
    JournalError,
    connect_to_read,
    connect_to_write,
    damaged,
    digest,
    explain_errors,
    lock,
)

FILE = "journal.sqlite"
_PACKAGES = ("caterpillar-sma", "mujoco", "numpy", "scipy", "cma")
_MEASURED = ("distance_m", "energy_j", "simulated_s")
FAILURES = {failure.label: failure for failure in Failure}  #: by `Failure.label`


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

    @property
    def fitness_m(self) -> float:
        """Distance crawled forwards, m; 0 for a robot that failed. See `Outcomes.fitness`."""
        return max(self.distance_m, 0.0) if self.failure is Failure.NONE else 0.0


class Completion(NamedTuple):
    """The state of a run when a generation was completed."""

    generation: int
    evaluations: int  #: number of evaluations of the run so far
    best: int | None  #: number of the best evaluation so far
    value: float | None  #: value of the objective of that evaluation


class Session(NamedTuple):
    """One start or resumption of a run."""

    number: int  #: number of the session, from 1
    started: str  #: date and time, UTC
    fingerprint: dict[str, str]  #: versions and machine type, see `fingerprint`
    finished: str | None  #: date and time, UTC; None if the run did not end in this session

    @property
    def wall_s(self) -> float | None:
        """Wall time in s, to the second; None if the end was not recorded."""
        if self.finished is None:
            return None
        start, end = datetime.fromisoformat(self.started), datetime.fromisoformat(self.finished)
        return (end - start).total_seconds()


def fingerprint(packages: Sequence[str] = ()) -> dict[str, str]:
    """Return the versions and the machine type, on which results depend. `packages` adds packages."""
    versions = {name: version(name) for name in (*_PACKAGES, *packages)}
    return versions | {"python": platform.python_version(), "machine": platform.machine()}


class Journal:
    """The open journal of one run. Only one process at a time can open it for writing.

    Args:
        folder: the run folder.
        read_only: open for reading only, which works while another process writes.

    Raises:
        JournalError: there is no journal, another process is writing to it, another version of this
            package wrote it, or it is damaged.
    """

    def __init__(self, folder: Path, *, read_only: bool = False) -> None:
        self.path = folder / FILE
        with ExitStack() as stack:
            with explain_errors(self.path, reading=read_only):
                if not self.path.exists():
                    raise JournalError(
                        f"{folder} is not a run folder: it contains no {FILE}; give a folder that "
                        "caterpillar made"
                    )
                if not read_only:
                    stack.enter_context(lock(folder))
                connect = connect_to_read if read_only else connect_to_write
                self._db = connect(self.path, stack)
                schema.check(self._db, self.path)
            self._resources = stack.pop_all()

    @classmethod
    def create(cls, folder: Path, configuration: Mapping[str, Any]) -> Journal:
        """Create and open the journal of a new run.

        Raises:
            JournalError: the folder has a journal already, or cannot be written.
        """
        path = folder / FILE
        partial = path.with_name(f".{FILE}.partial")
        advice = (
            "Nothing was recorded; start the run again in a folder on a file system with locks and with "
            "enough disk space"
        )
        with explain_errors(path, advice=advice), closing(lock(folder, advice)):
            if path.exists():
                raise JournalError(f"{path} exists already; resume that run, or choose another folder")
            partial.unlink(missing_ok=True)
            with closing(sqlite3.connect(partial)) as db, db:
                db.executescript(f"BEGIN; {schema.TABLES} COMMIT;")
                text = json.dumps(configuration)
                db.execute("INSERT INTO run VALUES (?, ?)", [text, digest([text])])
            os.replace(partial, path)  # atomic, so that no incomplete journal exists
        return cls(folder)

    def __enter__(self) -> Journal:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file and release the lock."""
        self._resources.close()

    @property
    def configuration(self) -> dict[str, Any]:
        """The configuration of the run, as given to `create` or `begin`."""
        rows = list(self._read("run"))
        if len(rows) != 1:
            raise damaged(self.path, f"it has {len(rows)} configurations")
        return self._parse(rows[0][0], "the configuration")

    @property
    def sessions(self) -> list[Session]:
        """All sessions, in order."""
        found = []
        for number, start, text, end in self._read_numbered("sessions", "session", first=1):
            session = Session(number, start, self._parse(text, f"session {number}"), end)
            try:
                _ = session.wall_s
            except (TypeError, ValueError):
                raise damaged(self.path, f"session {number} has no valid time") from None
            found.append(session)
        return found

    def begin(
        self, packages: Sequence[str] = (), configuration: Mapping[str, Any] | None = None
    ) -> None:
        """Begin a session.

        Args:
            packages: names of further packages whose versions are recorded, see `fingerprint`.
            configuration: replaces the configuration, for example by one with more generations.
        """
        number = 1 + sum(1 for _ in self._read_numbered("sessions", "session", first=1))
        row = (number, _now(), json.dumps(fingerprint(packages)), None)
        with explain_errors(self.path), self._db:
            if configuration is not None:
                text = json.dumps(configuration)
                self._db.execute("UPDATE run SET configuration = ?, digest = ?", (text, digest([text])))
            self._db.execute("INSERT INTO sessions VALUES (?, ?, ?, ?, ?)", (*row, digest(row)))

    def finish(self) -> None:
        """Record that the run ended in its last session."""
        *_, (number, started, text, _) = self._read_numbered("sessions", "session", first=1)
        row = (number, started, text, _now())
        self._write(
            "UPDATE sessions SET finished = ?, digest = ? WHERE session = ?",
            (row[-1], digest(row), number),
        )

    def _parse(self, text: Any, what: str) -> dict[str, Any]:
        """Parse a JSON object, and report anything else as damage. `what` names it in the message."""
        try:
            data = parse_json(text)
        except (TypeError, ValueError, RecursionError) as error:
            raise damaged(self.path, f"{what} is not JSON: {error}") from None
        if not isinstance(data, dict):
            raise damaged(self.path, f"{what} is not a JSON object")
        return data

    def append(self, evaluations: Sequence[Evaluation]) -> None:
        """Add evaluations in one transaction.

        Raises:
            CaterpillarError: a distance, an energy or a time is not a finite number.
            JournalError: the file cannot be written, for example because the disk is full; the journal
                is unchanged.
        """
        self._insert(
            "evaluations",
            [
                (
                    e.number, e.generation, np.asarray(e.genome, dtype="<f8").tobytes(),
                    e.failure.label,
                    *(float(check_number(name, getattr(e, name))) for name in _MEASURED), e.session,
                )
                for e in evaluations
            ],
        )  # fmt: skip

    def complete(self, completion: Completion) -> None:
        """Record the completion of a generation."""
        self._insert("generations", [completion])

    def _insert(self, table: str, rows: Sequence[Sequence[Any]]) -> None:
        """Add rows, with their digests."""
        with explain_errors(self.path), self._db:
            for row in rows:
                # SQLite stores -0.0 as 0.0, which has another digest.
                values = [value + 0.0 if isinstance(value, float) else value for value in row]
                places = ", ".join("?" * len(values))
                self._db.execute(f"INSERT INTO {table} VALUES ({places}, ?)", (*values, digest(values)))

    def _write(self, statement: str, values: Sequence[Any]) -> None:
        """Run a statement in a transaction."""
        with explain_errors(self.path), self._db:
            self._db.execute(statement, values)

    def evaluations(self) -> Iterator[Evaluation]:
        """Yield all evaluations, in order.

        Raises:
            JournalError: an evaluation is missing or was altered.
        """
        sizes = set()  # sizes of the genomes in bytes
        for number, generation, genome, failure, *numbers in self._read_numbered(
            "evaluations", "evaluation"
        ):
            sizes.add(len(genome))
            try:
                genes = np.frombuffer(genome, dtype="<f8").astype(np.float64)
                valid = len(sizes) == 1 and math.isfinite(sum(numbers))
                evaluation = Evaluation(number, generation, genes, FAILURES[failure], *numbers)
            except (TypeError, ValueError, KeyError):
                valid = False
            if not valid:
                raise damaged(self.path, f"evaluation {number} is invalid")
            yield evaluation

    def generations(self) -> list[Completion]:
        """Return the completed generations, in order.

        Raises:
            JournalError: a row is missing or was altered.
        """
        return [Completion(*values) for values in self._read_numbered("generations", "generation")]

    def _read_numbered(self, table: str, what: str, first: int = 0) -> Iterator[tuple[Any, ...]]:
        """Yield the rows of a table, and check that they are numbered from `first` without gaps."""
        for expected, row in enumerate(self._read(table), start=first):
            if row[0] != expected:
                raise damaged(self.path, f"{what} {expected} is missing")
            yield row

    def _read(self, table: str) -> Iterator[tuple[Any, ...]]:
        """Check the digests of a table, and yield its rows without them."""
        with explain_errors(self.path, reading=True):
            for count, row in enumerate(self._db.execute(f"SELECT * FROM {table} ORDER BY rowid")):
                *values, found = row
                if found != digest(values):
                    raise damaged(self.path, f"row {count} of the table {table} was altered")
                yield tuple(values)


def _now() -> str:
    """Return the date and time, UTC."""
    return datetime.now(UTC).strftime("%Y-%m-%d %H:%M:%S")


def read_simulated_s(folder: Path) -> float:
    """Return the simulated seconds of a run so far, or 0 if its journal cannot be read.

    To be fast enough for polling, this reads no genomes and checks no digests.
    """
    try:
        with ExitStack() as stack:
            db = connect_to_read(folder / FILE, stack)
            return float(db.execute("SELECT total(simulated_s) FROM evaluations").fetchone()[0])
    except (sqlite3.Error, OSError, JournalError):
        return 0.0
