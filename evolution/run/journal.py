"""The journal of a run: one SQLite file with the configuration and every evaluation, in order.

Tables (readable with any SQLite tool; docs/runs.md describes the columns):

- `run`: one row with the configuration as JSON.
- `sessions`: one row each time the run was started or resumed, with the versions in use.
- `evaluations`: one row per genome, committed in chunks.
- `generations`: one row per completed generation, with the best evaluation so far.

The digests in the last two tables detect damage. The state of the optimizer is not stored: a run is
resumed by replaying it from the journal.
"""

from __future__ import annotations

import json
import os
import platform
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, closing
from datetime import datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from caterpillar_env.arrays import Array
from caterpillar_env.task import Failure
from evolution.run.database import JournalError, damaged, digest, explain_errors, lock

FILE = "journal.sqlite"
SCHEMA = 2  #: schema 1 had no table `generations`
_APPLICATION = 0x43415450  # "CATP"
_BUSY_S = 60.0  # how long to wait for another connection to finish reading
_PACKAGES = ("caterpillar-sma", "mujoco", "numpy", "scipy", "cma")
_FAILURES = {failure.label: failure for failure in Failure}

_GENERATIONS = """
CREATE TABLE generations (
    generation INTEGER PRIMARY KEY,
    evaluations INTEGER NOT NULL,
    best INTEGER REFERENCES evaluations,
    objective REAL,
    digest BLOB NOT NULL
);
"""
_TABLES = f"""
CREATE TABLE run (configuration TEXT NOT NULL);
CREATE TABLE sessions (
    session INTEGER PRIMARY KEY,
    started TEXT NOT NULL,
    fingerprint TEXT NOT NULL,
    finished TEXT
);
CREATE TABLE evaluations (
    evaluation INTEGER PRIMARY KEY,
    generation INTEGER NOT NULL,
    genome BLOB NOT NULL,
    failure TEXT NOT NULL,
    distance_m REAL NOT NULL,
    energy_j REAL NOT NULL,
    simulated_s REAL NOT NULL,
    session INTEGER NOT NULL REFERENCES sessions,
    digest BLOB NOT NULL
);
{_GENERATIONS}
"""


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
    """Return what results depend on: the versions, also of additional packages, and the machine type."""
    versions = {name: version(name) for name in (*_PACKAGES, *packages)}
    return versions | {"python": platform.python_version(), "machine": platform.machine()}


class Journal:
    """The open journal of one run. Only one process at a time can open it for writing.

    Args:
        folder: the run folder.
        read_only: open for reading only, which works while another process writes.

    Raises:
        JournalError: there is no journal, another process is writing to it, it has a newer schema, or it
            is damaged.
    """

    def __init__(self, folder: Path, *, read_only: bool = False) -> None:
        self.path = folder / FILE
        if not self.path.is_file():
            raise JournalError(
                f"{folder} is not a run folder: it contains no {FILE}; give one that caterpillar made"
            )
        self._schema = SCHEMA
        with ExitStack() as stack:
            if not read_only:
                stack.enter_context(lock(folder))
            self._db = stack.enter_context(closing(sqlite3.connect(self.path, timeout=_BUSY_S)))
            with explain_errors(self.path):
                if not read_only:
                    self._db.execute("PRAGMA journal_mode = DELETE")  # works on network file systems
                    self._db.execute("PRAGMA synchronous = FULL")  # rows survive a crash of the machine
                self._check()
                if not read_only and self._schema == 1:
                    self._db.executescript(f"BEGIN; PRAGMA user_version = 2; {_GENERATIONS} COMMIT;")
                    self._schema = SCHEMA
            self._resources = stack.pop_all()

    @classmethod
    def create(cls, folder: Path, configuration: Mapping[str, Any]) -> Journal:
        """Create and open the journal of a new run.

        Raises:
            JournalError: the folder has a journal already, or cannot be written.
        """
        path = folder / FILE
        if path.exists():
            raise JournalError(f"{path} exists already; resume that run, or choose another folder")
        partial = path.with_name(f".{FILE}.partial")
        with explain_errors(path):
            partial.unlink(missing_ok=True)
            with closing(sqlite3.connect(partial)) as db, db:
                db.executescript(
                    f"BEGIN; PRAGMA application_id = {_APPLICATION}; PRAGMA user_version = {SCHEMA};"
                    f"{_TABLES} COMMIT;"
                )
                db.execute("INSERT INTO run VALUES (?)", [json.dumps(configuration)])
            os.replace(partial, path)  # atomic, so that no incomplete journal exists
        return cls(folder)

    def __enter__(self) -> Journal:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file and release the lock."""
        self._resources.close()

    def _check(self) -> None:
        (application,) = self._db.execute("PRAGMA application_id").fetchone()
        (self._schema,) = self._db.execute("PRAGMA user_version").fetchone()
        problems = [problem for (problem,) in self._db.execute("PRAGMA quick_check(3)")]
        if application != _APPLICATION:
            raise JournalError(
                f"{self.path} is an SQLite file of another program; give a folder that caterpillar made"
            )
        if self._schema > SCHEMA:
            raise JournalError(
                f"{self.path} was written by a newer version of this package (schema {self._schema}; "
                f"this version reads up to {SCHEMA}): install the newer version"
            )
        if problems != ["ok"]:
            raise damaged(self.path, "; ".join(problems))

    def _execute(self, statement: str, *values: Any) -> list[Any]:
        """Run a statement in a transaction, and return its rows."""
        with explain_errors(self.path), self._db:
            return self._db.execute(statement, values).fetchall()

    @property
    def configuration(self) -> dict[str, Any]:
        """The configuration of the run, as given to `create` or `configure`."""
        ((text,),) = self._execute("SELECT configuration FROM run")
        data: dict[str, Any] = json.loads(text)
        return data

    def configure(self, configuration: Mapping[str, Any]) -> None:
        """Replace the configuration, for example by one with more generations."""
        self._execute("UPDATE run SET configuration = ?", json.dumps(configuration))

    @property
    def sessions(self) -> list[Session]:
        """All sessions, in order."""
        rows = self._execute(
            "SELECT session, started, finished, fingerprint FROM sessions ORDER BY session"
        )
        return [Session(n, start, end, json.loads(text)) for n, start, end, text in rows]

    def begin(self, packages: Sequence[str] = ()) -> None:
        """Begin a session.

        Args:
            packages: names of packages whose versions to record besides those of `fingerprint`.
        """
        self._execute(
            "INSERT INTO sessions (started, fingerprint) VALUES (datetime('now'), ?)",
            json.dumps(fingerprint(packages)),
        )

    def finish(self) -> None:
        """Record that the run ended in its last session."""
        self._execute(
            "UPDATE sessions SET finished = datetime('now') "
            "WHERE session = (SELECT max(session) FROM sessions)"
        )

    def append(self, evaluations: Sequence[Evaluation]) -> None:
        """Add evaluations in one transaction.

        Raises:
            JournalError: the file cannot be written, for example because the disk is full; the journal
                is unchanged.
        """
        self._insert(
            "evaluations",
            [
                (
                    e.number, e.generation, np.asarray(e.genome, dtype="<f8").tobytes(),
                    e.failure.label, e.distance_m, e.energy_j, e.simulated_s, e.session,
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
                places = ", ".join("?" * len(row))
                self._db.execute(f"INSERT INTO {table} VALUES ({places}, ?)", (*row, digest(row)))

    def evaluations(self) -> Iterator[Evaluation]:
        """Yield all evaluations, in order.

        Raises:
            JournalError: an evaluation is missing or was altered.
        """
        for number, values in enumerate(self._read("evaluations", "evaluation")):
            if values[0] != number:
                raise damaged(self.path, f"evaluation {number} is missing")
            _, generation, genome, failure, *numbers = values
            genes = np.frombuffer(genome, dtype="<f8").astype(np.float64)
            yield Evaluation(number, generation, genes, _FAILURES[failure], *numbers)

    def generations(self) -> list[Completion]:
        """Return the completed generations, in order. Files with schema 1 record none.

        Raises:
            JournalError: a row was altered.
        """
        if self._schema == 1:
            return []
        return [Completion(*values) for values in self._read("generations", "generation")]

    def _read(self, table: str, key: str) -> Iterator[tuple[Any, ...]]:
        """Yield the rows of a table without their digests, after checking these."""
        count = 0
        try:
            for *values, stored in self._db.execute(f"SELECT * FROM {table} ORDER BY {key}"):
                if stored != digest(tuple(values)):
                    raise damaged(self.path, f"{key} {count} was altered")
                yield tuple(values)
                count += 1
        except sqlite3.DatabaseError as error:
            raise damaged(self.path, f"{key} {count} cannot be read ({error})") from None


def read_simulated_s(folder: Path) -> float:
    """Return the simulated seconds of a run so far, or 0 without a journal.

    To be fast enough for polling, this reads no genomes and checks no digests.
    """
    try:
        with closing(sqlite3.connect(f"{(folder / FILE).resolve().as_uri()}?mode=ro", uri=True)) as db:
            return float(db.execute("SELECT total(simulated_s) FROM evaluations").fetchone()[0])
    except sqlite3.Error:
        return 0.0
