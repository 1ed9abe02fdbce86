"""SQLite files with a single writer: locks, connections, errors and digests."""

from __future__ import annotations

import fcntl
import hashlib
import sqlite3
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import IO, Any

from caterpillar_env.errors import CaterpillarError

_LOCK_ATTEMPTS, _LOCK_WAIT_S = 10, 0.05


class JournalError(CaterpillarError):
    """A journal cannot be opened, read or written."""


def is_in_use(folder: Path) -> bool:
    """Return whether a process has the journal of a folder open for writing."""
    try:
        with (folder / ".lock").open("r", encoding="utf-8") as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except FileNotFoundError:
        return False
    except OSError:
        return True
    return False


def lock(folder: Path) -> IO[str]:
    """Lock a folder until the file is closed or the process ends."""
    with explain_errors(folder / ".lock"):
        file = (folder / ".lock").open("w", encoding="utf-8")
    for _ in range(_LOCK_ATTEMPTS):  # `is_in_use` holds the lock briefly
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return file
        except OSError:
            time.sleep(_LOCK_WAIT_S)
    file.close()
    raise JournalError(f"another process is working on {folder}; wait until it ends, or stop it")


def damaged(path: Path, why: str) -> JournalError:
    """Return an error that reports damage."""
    return JournalError(
        f"{path} is damaged: {why}. Restore a copy of it, or repeat the run: the configuration in "
        "report.html gives the same result"
    )


@contextmanager
def explain_errors(path: Path) -> Iterator[None]:
    """Convert SQLite and file system errors to a `JournalError`, also for damage."""
    try:
        yield
    except (sqlite3.OperationalError, OSError) as error:
        raise JournalError(
            f"cannot read or write {path}: {error} (is the disk full?). Recorded evaluations are safe; "
            f"free some space and run `caterpillar resume {path.parent}`"
        ) from None
    except sqlite3.DatabaseError as error:
        raise damaged(path, str(error)) from None


def digest(values: Sequence[Any]) -> bytes:
    """Return a digest of the values of a row and their types."""
    state = hashlib.blake2b(digest_size=8)
    for value in values:
        part = value if isinstance(value, bytes) else repr(value).encode()
        state.update(len(part).to_bytes(4, "little") + part)
    return state.digest()
