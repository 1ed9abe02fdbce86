"""SQLite files with a single writer: locks, connections, errors and digests."""

from __future__ import annotations

import fcntl
import hashlib
import os
import shlex
import shutil
import sqlite3
import time
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import IO, Any

from caterpillar_env.errors import CaterpillarError

_LOCK_ATTEMPTS, _LOCK_WAIT_S = 10, 0.05
_BUSY_S = 60.0  # how long to wait for another connection to finish reading
#: Errors of SQLite that do not mean that the file is damaged.
_HEALTHY = {
    sqlite3.SQLITE_PERM, sqlite3.SQLITE_BUSY, sqlite3.SQLITE_LOCKED, sqlite3.SQLITE_NOMEM,
    sqlite3.SQLITE_READONLY, sqlite3.SQLITE_INTERRUPT, sqlite3.SQLITE_IOERR, sqlite3.SQLITE_FULL,
    sqlite3.SQLITE_CANTOPEN, sqlite3.SQLITE_PROTOCOL, sqlite3.SQLITE_NOLFS, sqlite3.SQLITE_AUTH,
}  # fmt: skip


class JournalError(CaterpillarError):
    """A journal cannot be opened, read or written."""


def is_in_use(folder: Path) -> bool:
    """Return whether a process has the journal of a folder open for writing."""
    try:
        with _open_lock(folder, os.O_RDONLY) as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError as error:
        return isinstance(error, BlockingIOError)
    return False


def lock(folder: Path, advice: str = "") -> IO[bytes]:
    """Lock a folder until the file is closed or the process ends. For `advice`, see `explain_errors`."""
    with explain_errors(folder / ".lock", advice=advice), ExitStack() as stack:
        file = stack.enter_context(_open_lock(folder, os.O_RDWR | os.O_CREAT))
        for _ in range(_LOCK_ATTEMPTS):  # retry, because `is_in_use` may hold the lock briefly
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                time.sleep(_LOCK_WAIT_S)
            else:
                stack.pop_all()  # keep the file open
                return file
    raise JournalError(f"another process is working on {folder}; wait until it ends, or stop it")


def _open_lock(folder: Path, flags: int) -> IO[bytes]:
    """Open the lock file of a folder. This does not block, even if the file is a named pipe."""
    descriptor = os.open(folder / ".lock", flags | os.O_NONBLOCK, 0o666)
    return open(descriptor, "rb", buffering=0)


def _check_kind(path: Path) -> None:
    """Raise an error if the file or its rollback journal is a pipe or device, which could block."""
    for file in (path, path.with_name(f"{path.name}-journal")):
        if file.exists() and not file.is_file():
            raise JournalError(f"{file} is not a regular file; remove it, or restore a copy of the run")


def connect_to_write(path: Path, stack: ExitStack) -> sqlite3.Connection:
    """Open a file for writing until `stack` is closed."""
    _check_kind(path)
    db = stack.enter_context(closing(sqlite3.connect(path, timeout=_BUSY_S)))
    db.execute("PRAGMA journal_mode = DELETE")  # works on network file systems
    db.execute("PRAGMA synchronous = FULL")  # rows survive a crash of the machine
    return db


def connect_to_read(path: Path, stack: ExitStack) -> sqlite3.Connection:
    """Open a file for reading until `stack` is closed. This needs no write access.

    If a process was killed while it wrote, SQLite has to undo the last transaction. This function
    then opens a temporary copy, in which SQLite can do so.
    """
    _check_kind(path)
    uri = f"{path.resolve().as_uri()}?mode=ro"
    db = stack.enter_context(closing(sqlite3.connect(uri, timeout=_BUSY_S, uri=True)))
    try:
        db.execute("PRAGMA user_version")
    except sqlite3.OperationalError as error:
        if getattr(error, "sqlite_errorcode", None) != sqlite3.SQLITE_READONLY_ROLLBACK:
            raise
    else:
        return db
    copy = Path(stack.enter_context(TemporaryDirectory()))
    for name in (path.name, f"{path.name}-journal"):
        shutil.copyfile(path.with_name(name), copy / name)
    return stack.enter_context(closing(sqlite3.connect(copy / path.name)))


def damaged(path: Path, why: str) -> JournalError:
    """Return an error that reports damage."""
    return JournalError(
        f"{path} is damaged: {why}. Restore a copy of it, or repeat the run with the same configuration "
        "(for an evolutionary run, report.html contains it)"
    )


@contextmanager
def explain_errors(path: Path, *, reading: bool = False, advice: str = "") -> Iterator[None]:
    """Convert SQLite errors, file system errors and damage to a `JournalError`.

    Args:
        path: the file.
        reading: whether the block only reads.
        advice: advice if the file cannot be written; by default, to resume the run.
    """
    try:
        yield
    except UnicodeError as error:  # from a message of SQLite that quotes damaged text
        raise damaged(path, str(error)) from None
    except sqlite3.IntegrityError as error:
        raise JournalError(f"{path} cannot record these data: {error}") from None
    except (sqlite3.DatabaseError, OSError) as error:
        code = getattr(error, "sqlite_errorcode", None)  # None if text is not UTF-8, which is damage
        if isinstance(error, sqlite3.DatabaseError) and (code is None or code & 0xFF not in _HEALTHY):
            raise damaged(path, str(error)) from None
        if reading:
            raise JournalError(f"cannot read {path}: {error}; make sure that you may read it") from None
        folder = shlex.quote(str(path.parent))
        advice = advice or (
            "Recorded evaluations are safe; make sure that the folder can be written, and run "
            f"`caterpillar resume {folder}` (or `caterpillar rl resume {folder}` for a training run)"
        )
        raise JournalError(f"cannot write {path}: {error} (is the disk full?). {advice}") from None


def digest(values: Sequence[Any]) -> bytes:
    """Return a digest of the values of a row and their types."""
    state = hashlib.blake2b(digest_size=8)
    for value in values:
        part = value if isinstance(value, bytes) else repr(value).encode()
        state.update(len(part).to_bytes(4, "little") + part)
    return state.digest()
