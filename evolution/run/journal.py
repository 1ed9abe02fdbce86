"""The journal of a run: one SQLite file with the configuration and every evaluation, in their order.

Tables (readable with any SQLite tool; docs/runs.md describes the columns):

- `run`: one row, the configuration as JSON.
- `sessions`: a row each time that the run was started or resumed, with the versions that it ran under.
- `evaluations`: a row for each genome, committed as chunks finish; `digest` tells a damaged row.

Nothing of an optimizer is kept: a run is resumed by asking it anew and answering from here.
"""

from __future__ import annotations

import hashlib
import json
import os
import platform
import sqlite3
from collections.abc import Iterator, Sequence
from contextlib import closing
from datetime import datetime
from importlib.metadata import version
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from caterpillar_env.arrays import Array
from caterpillar_env.robot import Outcomes
from caterpillar_env.task import Failure, label
from evolution.run.database import JournalDamagedError, JournalError, locked, opened, told

FILE = "journal.sqlite"
SCHEMA = 1
_APPLICATION = 0x43415450  # "CATP"

_TABLES = """
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
"""


class Evaluation(NamedTuple):
    """One genome and what became of it."""

    number: int  #: in the order of asking, from 0
    generation: int
    genome: Array  #: in [0, 1], (n,)
    failure: Failure
    distance_m: float
    energy_j: float
    simulated_s: float
    session: int


class Session(NamedTuple):
    """One time that a run was started or resumed."""

    number: int  #: from 1
    started: str  #: date and time, UTC
    finished: str | None  #: likewise, None where the run did not come to its end in it
    fingerprint: dict[str, str]  #: what it ran under, see `fingerprint`

    @property
    def wall_s(self) -> float | None:
        """Wall time in s, to the second; None where nobody noted the end."""
        if self.finished is None:
            return None
        return (
            datetime.fromisoformat(self.finished) - datetime.fromisoformat(self.started)
        ).total_seconds()


def outcomes_of(evaluations: Sequence[Evaluation]) -> Outcomes:
    """What became of recorded genomes, as the evaluator told it."""
    return Outcomes(
        np.array([e.failure for e in evaluations], dtype=np.int8),
        np.array([e.distance_m for e in evaluations], dtype=np.float64),
        np.array([e.energy_j for e in evaluations], dtype=np.float64),
        np.array([e.simulated_s for e in evaluations], dtype=np.float64),
    )


def fingerprint() -> dict[str, str]:
    """What the bits of a result depend on besides the configuration."""
    packages = ("caterpillar-sma", "mujoco", "numpy", "scipy", "cma")
    return {
        **{name: version(name) for name in packages},
        "python": platform.python_version(),
        "machine": platform.machine(),
    }


class Journal:
    """The open journal of one run; no other process can open it to write at the same time.

    Args:
        folder: the run folder.
        read_only: only to look at it, which a process that writes may go on doing meanwhile.

    Raises:
        JournalError: there is none, it is in use, or of a newer version.
        JournalDamagedError: its file is damaged.
    """

    def __init__(self, folder: Path, *, read_only: bool = False) -> None:
        self.path = folder / FILE
        if not self.path.is_file():
            raise JournalError(
                f"{folder} holds no {FILE}: it is no run folder; give one that caterpillar evolve made"
            )
        self._lock = None if read_only else locked(folder)
        try:
            self._db = opened(self.path, read_only=read_only)
            self._check()
        except BaseException:
            if self._lock is not None:
                self._lock.close()
            raise

    @classmethod
    def create(cls, folder: Path, configuration: dict[str, Any]) -> Journal:
        """A new journal in a folder that has none.

        Raises:
            JournalError: there is one already, or the folder cannot be written.
        """
        path = folder / FILE
        if path.exists():
            raise JournalError(f"{path} exists already; resume that run, or choose another folder")
        partial = path.with_name(f".{FILE}.partial")
        with told(path):
            partial.unlink(missing_ok=True)
            with closing(sqlite3.connect(partial)) as db, db:
                db.executescript(
                    f"BEGIN; PRAGMA application_id = {_APPLICATION}; PRAGMA user_version = {SCHEMA};"
                    f"{_TABLES} COMMIT;"
                )
                db.execute("INSERT INTO run VALUES (?)", [json.dumps(configuration)])
            os.replace(partial, path)  # a journal is whole, or not there
        return cls(folder)

    def __enter__(self) -> Journal:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Give the file free for others."""
        self._db.close()
        if self._lock is not None:
            self._lock.close()

    def _check(self) -> None:
        try:
            (application,) = self._db.execute("PRAGMA application_id").fetchone()
            (schema,) = self._db.execute("PRAGMA user_version").fetchone()
            problems = [row[0] for row in self._db.execute("PRAGMA quick_check(3)")]
        except sqlite3.DatabaseError as error:
            raise self._damaged(str(error)) from None
        if application != _APPLICATION:
            raise JournalError(
                f"{self.path} is an SQLite file of something else; give a folder that caterpillar "
                "evolve made"
            )
        if schema > SCHEMA:
            raise JournalError(
                f"{self.path} was written by a newer version of this package (schema {schema}, this one "
                f"knows {SCHEMA}); install that version"
            )
        if problems != ["ok"]:
            raise self._damaged("; ".join(problems))
        for _ in self.evaluations():
            pass

    def _damaged(self, why: str) -> JournalDamagedError:
        return JournalDamagedError(
            f"{self.path} is damaged: {why}. `caterpillar resume {self.path.parent} --repair` keeps the "
            f"evaluations before the damage and goes on from there (the file stays beside it)"
        )

    @property
    def configuration(self) -> dict[str, Any]:
        """The run's configuration, as it was given to `create`."""
        with told(self.path):
            (text,) = self._db.execute("SELECT configuration FROM run").fetchone()
        data: dict[str, Any] = json.loads(text)
        return data

    def configure(self, configuration: dict[str, Any]) -> None:
        """Put another configuration in the place of the first: one with more generations, say."""
        with told(self.path), self._db:
            self._db.execute("UPDATE run SET configuration = ?", [json.dumps(configuration)])

    @property
    def sessions(self) -> list[Session]:
        """Each time that the run was started or resumed, in turn."""
        with told(self.path):
            rows = self._db.execute(
                "SELECT session, started, finished, fingerprint FROM sessions ORDER BY session"
            ).fetchall()
        return [Session(n, start, end, json.loads(text)) for n, start, end, text in rows]

    def begin(self) -> int:
        """Note a new session; its number."""
        with told(self.path), self._db:
            row = self._db.execute(
                "INSERT INTO sessions (started, fingerprint) VALUES (datetime('now'), ?)",
                [json.dumps(fingerprint())],
            )
        assert row.lastrowid is not None
        return row.lastrowid

    def finish(self, session: int) -> None:
        """Note that the run came to its end in this session."""
        with told(self.path), self._db:
            self._db.execute(
                "UPDATE sessions SET finished = datetime('now') WHERE session = ?", [session]
            )

    @property
    def finished(self) -> bool:
        """Whether the last session came to the end of the run."""
        return any(s.finished is not None for s in self.sessions[-1:])

    @property
    def wall_s(self) -> float | None:
        """Wall time of a run that was finished in its first session, s, to the second; else None."""
        return next((s.wall_s for s in self.sessions), None)

    def append(
        self, first: int, generation: int, genomes: Array, outcomes: Outcomes, session: int
    ) -> None:
        """Add evaluations `first`, `first` + 1, ...: all of them or, after a crash, none.

        Raises:
            JournalError: the disk is full or cannot be written; the journal is as it was before.
        """
        rows = []
        for i, genome in enumerate(np.asarray(genomes, dtype="<f8")):
            values = (
                first + i,
                generation,
                genome.tobytes(),
                label(outcomes.failure[i]),
                float(outcomes.distance_m[i]),
                float(outcomes.energy_j[i]),
                float(outcomes.simulated_s[i]),
                session,
            )
            rows.append((*values, _digest(values)))
        with told(self.path), self._db:
            self._db.executemany(f"INSERT INTO evaluations VALUES ({', '.join('?' * 9)})", rows)

    def evaluations(self) -> Iterator[Evaluation]:
        """All evaluations in their order.

        Raises:
            JournalDamagedError: at the first one that is missing or not as it was written.
        """
        expected = 0
        try:
            for *values, digest in self._db.execute("SELECT * FROM evaluations ORDER BY evaluation"):
                if values[0] != expected or digest != _digest(tuple(values)):
                    raise self._damaged(f"evaluation {expected} is not as it was written")
                yield _evaluation(values)
                expected += 1
        except sqlite3.DatabaseError as error:
            raise self._damaged(f"evaluation {expected} cannot be read ({error})") from None

    @classmethod
    def repair(cls, folder: Path) -> int:
        """Keep what is whole of a damaged journal: the evaluations before the first damage.

        The damaged file stays as `journal.sqlite.damaged`.

        Returns:
            How many evaluations were kept.

        Raises:
            JournalError: not even the configuration can be read.
        """
        path = folder / FILE
        if not path.is_file():
            raise JournalError(
                f"{folder} holds no {FILE}: it is no run folder; give one that caterpillar evolve made"
            )
        lock = locked(folder)
        kept: list[tuple[Any, ...]] = []
        try:
            db = sqlite3.connect(path)
            # Else a file that lacks its end is not read at all.
            db.execute("PRAGMA writable_schema = ON")
            (configuration,) = db.execute("SELECT configuration FROM run").fetchone()
            sessions = db.execute("SELECT * FROM sessions ORDER BY session").fetchall()
            json.loads(configuration)
            try:
                for row in db.execute("SELECT * FROM evaluations ORDER BY evaluation"):
                    if row[0] != len(kept) or row[-1] != _digest(row[:-1]):
                        break
                    kept.append(row)
            except sqlite3.DatabaseError:
                pass  # the damage begins here
            db.close()
            for suffix in ("", "-wal", "-shm"):
                old = path.with_name(FILE + suffix)
                if old.exists():
                    old.replace(path.with_name(f"{FILE}.damaged{suffix}"))
        except (sqlite3.DatabaseError, TypeError, ValueError):
            raise JournalError(
                f"{path} is damaged where its configuration lies: nothing can be kept, start anew"
            ) from None
        finally:
            lock.close()
        with cls.create(folder, json.loads(configuration)) as journal, told(path), journal._db as db:
            db.executemany("INSERT INTO sessions VALUES (?, ?, ?, ?)", sessions)
            db.executemany(f"INSERT INTO evaluations VALUES ({', '.join('?' * 9)})", kept)
        return len(kept)


def _evaluation(values: Sequence[Any]) -> Evaluation:
    number, generation, genome, name, distance_m, energy_j, simulated_s, session = values
    failure = next(f for f in Failure if f.label == name)
    return Evaluation(
        number, generation, np.frombuffer(genome, dtype="<f8").astype(np.float64), failure,
        distance_m, energy_j, simulated_s, session,
    )  # fmt: skip


def _digest(values: Sequence[Any]) -> bytes:
    """Of a row's values, each with its type and every bit; a flipped one changes it."""
    state = hashlib.blake2b(digest_size=8)
    for value in values:
        part = value if isinstance(value, bytes) else repr(value).encode()
        state.update(len(part).to_bytes(4, "little") + part)
    return state.digest()
