"""The tables of a journal in all versions of its schema, and upgrades from earlier versions.

Schema 1 had no table `generations`. Schema 2 had no digests in the tables `run` and `sessions`.
"""

from __future__ import annotations

import sqlite3
from pathlib import Path

from evolution.run.database import JournalError, damaged, digest

SCHEMA = 3
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
{_GENERATIONS}
"""
_DIGEST = "digest"


def list_columns(schema: int) -> dict[str, list[str]]:
    """Return the columns of each table. The digest of the other columns, if any, comes last."""
    later = [_DIGEST] if schema >= 3 else []
    return {
        "run": ["configuration", *later],
        "sessions": ["session", "started", "fingerprint", "finished", *later],
        "evaluations": [
            "evaluation", "generation", "genome", "failure", "distance_m", "energy_j", "simulated_s",
            "session", _DIGEST,
        ],
        "generations": (
            ["generation", "evaluations", "best", "objective", _DIGEST] if schema >= 2 else []
        ),
    }  # fmt: skip


def has_digests(table: str, schema: int) -> bool:
    """Return whether the rows of a table have digests."""
    return _DIGEST in list_columns(schema)[table]


def check(db: sqlite3.Connection, path: Path) -> int:
    """Check the structure of a file, and return its schema.

    Raises:
        JournalError: it belongs to another program, has a newer schema, or is damaged.
    """
    (application,) = db.execute("PRAGMA application_id").fetchone()
    (schema,) = db.execute("PRAGMA user_version").fetchone()
    problems = [problem for (problem,) in db.execute("PRAGMA quick_check(3)")]
    if application != _APPLICATION:
        raise JournalError(
            f"{path} is an SQLite file of another program; give a folder that caterpillar made"
        )
    if schema > SCHEMA:
        raise JournalError(
            f"{path} was written by a newer version of this package (schema {schema}; this version "
            f"reads up to {SCHEMA}): install the newer version"
        )
    if problems != ["ok"]:
        raise damaged(path, "; ".join(problems))
    for table, columns in list_columns(schema).items():
        if [row[1] for row in db.execute(f"PRAGMA table_info({table})")] != columns:
            raise damaged(path, f"table {table} does not have the columns of schema {schema}")
    return int(schema)


def upgrade(db: sqlite3.Connection, schema: int) -> None:
    """Upgrade a file of an earlier schema in one transaction."""
    if schema == SCHEMA:
        return
    with db:
        db.execute("BEGIN IMMEDIATE")
        if schema < 2:
            db.execute(_GENERATIONS)
        for table, columns in list_columns(2).items():
            if not has_digests(table, 2):
                db.execute(f"ALTER TABLE {table} ADD COLUMN {_DIGEST} BLOB")
                for rowid, *values in db.execute(
                    f"SELECT rowid, {', '.join(columns)} FROM {table}"
                ).fetchall():
                    row = (digest(tuple(values)), rowid)
                    db.execute(f"UPDATE {table} SET {_DIGEST} = ? WHERE rowid = ?", row)
        db.execute(f"PRAGMA user_version = {SCHEMA}")
