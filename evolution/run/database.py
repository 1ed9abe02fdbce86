"""An SQLite file that loses nothing, and that one process at a time writes to."""

from __future__ import annotations

import fcntl
import sqlite3
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import IO

from caterpillar_env.errors import CaterpillarError


class JournalError(CaterpillarError):
    """A journal cannot be opened, read or written."""


class JournalDamagedError(JournalError):
    """A journal's file is damaged; what is whole can be kept (`Journal.repair`)."""


def opened(path: Path, *, read_only: bool) -> sqlite3.Connection:
    """A connection that loses nothing that it has committed."""
    db = sqlite3.connect(path)
    try:
        if not read_only:
            # A write-ahead log needs memory that all readers share, which other machines do not.
            mode = "DELETE" if _file_system(path) in _NETWORKED else "WAL"
            db.execute(f"PRAGMA journal_mode = {mode}")
            db.execute("PRAGMA synchronous = FULL")
    except sqlite3.DatabaseError as error:
        db.close()
        if "malformed" in str(error) or "not a database" in str(error):
            raise JournalDamagedError(
                f"{path} is damaged: {error}. `caterpillar resume {path.parent} --repair` keeps what is "
                "whole"
            ) from None
        raise JournalError(f"cannot open {path}: {error}") from None
    return db


_NETWORKED = {
    "nfs", "nfs4", "cifs", "smb3", "smbfs", "fuse.sshfs", "lustre", "beegfs", "gpfs", "ceph",
    "glusterfs", "fuse.glusterfs", "afs",
}  # fmt: skip
_MOUNTS = Path("/proc/self/mounts")


def _file_system(path: Path) -> str:
    """Kind of the file system that holds a path; empty where the system does not tell."""
    try:
        mounts = [line.split(" ")[1:3] for line in _MOUNTS.read_text("utf-8").splitlines()]
    except OSError:
        return ""
    where = path.resolve()
    holding = [
        (len(place), kind) for place, kind in mounts if where.is_relative_to(place.replace("\\040", " "))
    ]
    return max(holding, default=(0, ""))[1]


def is_in_use(folder: Path) -> bool:
    """Whether a process has the journal open to write."""
    try:
        with (folder / ".lock").open("r", encoding="utf-8") as file:
            fcntl.flock(file, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except FileNotFoundError:
        return False
    except OSError:
        return True
    return False


def locked(folder: Path) -> IO[str]:
    """A lock that ends with this process, however it ends."""
    with told(folder / ".lock"):
        file = (folder / ".lock").open("w", encoding="utf-8")
    for attempt in range(10):
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            return file
        except OSError:
            if attempt < 9:
                time.sleep(0.05)  # somebody who only looks has it for an instant
    file.close()
    raise JournalError(f"another process is working on {folder}; wait for it, or stop it, and try again")


@contextmanager
def told(path: Path) -> Iterator[None]:
    """Says plainly what keeps SQLite from reading or writing."""
    try:
        yield
    except (sqlite3.OperationalError, OSError) as error:
        raise JournalError(
            f"cannot read or write {path}: {error} (is the disk full?). What was finished is safe; make "
            f"room and `caterpillar resume {path.parent}`"
        ) from None
