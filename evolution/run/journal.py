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
import sqlite3
from collections.abc import Iterator, Mapping, Sequence
from contextlib import ExitStack, closing
from pathlib import Path
from typing import Any

import numpy as np

from caterpillar_env.files import unused
from caterpillar_env.task import Failure, label
from evolution.run.database import JournalError, connect, damaged, digest, explain_errors, lock
from evolution.run.records import Completion, Evaluation, Session, fingerprint

FILE = "journal.sqlite"
SCHEMA = 2  #: schema 1 had no table `generations`
_APPLICATION = 0x43415450  # "CATP"

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


class Journal:
    """The open journal of one run. Only one process at a time can open it for writing.

    Args:
        folder: the run folder.
        read_only: open for reading only, which works while another process writes.

    Raises:
        JournalError: there is no journal, another process is writing to it, or it has a newer schema.
        JournalDamagedError: the file is damaged.
    """

    def __init__(self, folder: Path, *, read_only: bool = False) -> None:
        self.path = _find(folder)
        self._session = 0
        with ExitStack() as stack:
            if not read_only:
                stack.enter_context(lock(folder))
            self._db = stack.enter_context(closing(connect(self.path, read_only=read_only)))
            self._check()
            if not read_only and self._schema == 1:
                self._upgrade()
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
        try:
            (application,) = self._db.execute("PRAGMA application_id").fetchone()
            (self._schema,) = self._db.execute("PRAGMA user_version").fetchone()
            problems = [row[0] for row in self._db.execute("PRAGMA quick_check(3)")]
        except sqlite3.DatabaseError as error:
            raise damaged(self.path, str(error)) from None
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
        for _ in self.evaluations():
            pass

    def _upgrade(self) -> None:
        with explain_errors(self.path):
            self._db.executescript(f"BEGIN; PRAGMA user_version = {SCHEMA}; {_GENERATIONS} COMMIT;")
        self._schema = SCHEMA

    @property
    def configuration(self) -> dict[str, Any]:
        """The configuration of the run, as given to `create` or `configure`."""
        with explain_errors(self.path):
            (text,) = self._db.execute("SELECT configuration FROM run").fetchone()
        data: dict[str, Any] = json.loads(text)
        return data

    def configure(self, configuration: Mapping[str, Any]) -> None:
        """Replace the configuration, for example by one with more generations."""
        with explain_errors(self.path), self._db:
            self._db.execute("UPDATE run SET configuration = ?", [json.dumps(configuration)])

    @property
    def sessions(self) -> list[Session]:
        """All sessions, in order."""
        with explain_errors(self.path):
            rows = self._db.execute(
                "SELECT session, started, finished, fingerprint FROM sessions ORDER BY session"
            ).fetchall()
        return [Session(n, start, end, json.loads(text)) for n, start, end, text in rows]

    def begin(self, packages: Sequence[str] = ()) -> None:
        """Begin a session. Later evaluations belong to it.

        Args:
            packages: names of packages whose versions to record besides those of `fingerprint`.
        """
        with explain_errors(self.path), self._db:
            row = self._db.execute(
                "INSERT INTO sessions (started, fingerprint) VALUES (datetime('now'), ?)",
                [json.dumps(fingerprint(packages))],
            )
        self._session = row.lastrowid or 0

    def finish(self) -> None:
        """Record that the run ended in this session."""
        with explain_errors(self.path), self._db:
            self._db.execute(
                "UPDATE sessions SET finished = datetime('now') WHERE session = ?", [self._session]
            )

    @property
    def finished(self) -> bool:
        """Whether the run ended in its last session."""
        return any(s.finished is not None for s in self.sessions[-1:])

    def append(self, evaluations: Sequence[Evaluation]) -> list[Evaluation]:
        """Add evaluations in one transaction, and return them with their session.

        Raises:
            JournalError: the file cannot be written, for example because the disk is full; the journal
                is unchanged.
        """
        added = [e._replace(session=self._session) for e in evaluations]
        rows = []
        for e in added:
            genome = np.asarray(e.genome, dtype="<f8").tobytes()
            values = (
                e.number, e.generation, genome, label(e.failure), float(e.distance_m),
                float(e.energy_j), float(e.simulated_s), e.session,
            )  # fmt: skip
            rows.append((*values, digest(values)))
        self._insert("evaluations", rows)
        return added

    def complete(self, completion: Completion) -> None:
        """Record the completion of a generation."""
        self._insert("generations", [(*completion, digest(completion))])

    def _insert(self, table: str, rows: Sequence[Sequence[Any]]) -> None:
        if rows:
            with explain_errors(self.path), self._db:
                places = ", ".join("?" * len(rows[0]))
                self._db.executemany(f"INSERT INTO {table} VALUES ({places})", rows)

    def evaluations(self) -> Iterator[Evaluation]:
        """Yield all evaluations, in order.

        Raises:
            JournalDamagedError: an evaluation is missing or was altered.
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
            JournalDamagedError: a row was altered.
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

    @classmethod
    def repair(cls, folder: Path) -> int:
        """Keep the evaluations before the first damage.

        The damaged file is kept as `journal.sqlite.damaged`, numbered if that exists. Resuming the run
        records the completed generations again.

        Returns:
            Number of evaluations kept.

        Raises:
            JournalError: the configuration cannot be read.
        """
        path = _find(folder)
        kept: list[tuple[Any, ...]] = []
        with closing(lock(folder)):
            try:
                with closing(sqlite3.connect(path)) as db:
                    db.execute("PRAGMA writable_schema = ON")  # reads a truncated file too
                    (configuration,) = db.execute("SELECT configuration FROM run").fetchone()
                    sessions = db.execute("SELECT * FROM sessions ORDER BY session").fetchall()
                    settings = json.loads(configuration)
                    try:
                        for row in db.execute("SELECT * FROM evaluations ORDER BY evaluation"):
                            if row[0] != len(kept) or row[-1] != digest(row[:-1]):
                                break
                            kept.append(row)
                    except sqlite3.DatabaseError:
                        pass  # the damage begins here
                damaged_file = unused(folder, f"{FILE}.damaged")
                for suffix in ("", "-wal", "-shm", "-journal"):
                    old = path.with_name(FILE + suffix)
                    if old.exists():
                        old.replace(f"{damaged_file}{suffix}")
            except (sqlite3.DatabaseError, TypeError, ValueError):
                raise JournalError(
                    f"the configuration in {path} is damaged: nothing can be kept; start a new run"
                ) from None
        with cls.create(folder, settings) as journal:
            journal._insert("sessions", sessions)
            journal._insert("evaluations", kept)
        return len(kept)


_FAILURES = {failure.label: failure for failure in Failure}


def _find(folder: Path) -> Path:
    path = folder / FILE
    if not path.is_file():
        raise JournalError(
            f"{folder} is not a run folder: it contains no {FILE}; give a folder that caterpillar made"
        )
    return path


def read_simulated_s(folder: Path) -> float:
    """Return the simulated seconds of a run so far, or 0 without a journal.

    To be fast enough for polling, this reads no genomes and checks no digests.
    """
    try:
        with closing(sqlite3.connect(f"{(folder / FILE).resolve().as_uri()}?mode=ro", uri=True)) as db:
            return float(db.execute("SELECT total(simulated_s) FROM evaluations").fetchone()[0])
    except sqlite3.Error:
        return 0.0
