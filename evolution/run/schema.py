"""The tables of a journal."""

from __future__ import annotations

import sqlite3
from pathlib import Path

from evolution.run.database import JournalError, damaged

SCHEMA = 3
_APPLICATION = 0x43415450  # "CATP"

TABLES = f"""
PRAGMA application_id = {_APPLICATION};
PRAGMA user_version = {SCHEMA};
CREATE TABLE run (configuration TEXT NOT NULL, digest BLOB NOT NULL);
CREATE TABLE sessions (
    session INTEGER PRIMARY KEY,
    started TEXT NOT NULL,
    fingerprint TEXT NOT NULL,
    finished TEXT,
    digest BLOB NOT NULL
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
CREATE TABLE generations (
    generation INTEGER PRIMARY KEY,
    evaluations INTEGER NOT NULL,
    best INTEGER REFERENCES evaluations,
    objective REAL,
    digest BLOB NOT NULL
);
"""
#: Columns of each table. The last one is the digest of the others.
COLUMNS = {
    "run": ["configuration", "digest"],
    "sessions": ["session", "started", "fingerprint", "finished", "digest"],
    "evaluations": [
        "evaluation", "generation", "genome", "failure", "distance_m", "energy_j", "simulated_s",
        "session", "digest",
    ],
    "generations": ["generation", "evaluations", "best", "objective", "digest"],
}  # fmt: skip


def check(db: sqlite3.Connection, path: Path) -> None:
    """Check the structure of a file.

    Raises:
        JournalError: the file belongs to another program, has another schema, or is damaged.
    """
    (application,) = db.execute("PRAGMA application_id").fetchone()
    (schema,) = db.execute("PRAGMA user_version").fetchone()
    problems = [problem for (problem,) in db.execute("PRAGMA quick_check(3)")]
    if application != _APPLICATION:
        raise JournalError(
            f"{path} is an SQLite file of another program; give a folder that caterpillar made"
        )
    if schema != SCHEMA:
        raise JournalError(
            f"{path} was written by another version of this package (schema {schema}; this one reads "
            f"schema {SCHEMA}): install that version to read it, or start a new run"
        )
    if problems != ["ok"]:
        raise damaged(path, "; ".join(problems))
    for table, columns in COLUMNS.items():
        if [row[1] for row in db.execute(f"PRAGMA table_info({table})")] != columns:
            raise damaged(path, f"table {table} does not have the columns of schema {SCHEMA}")
