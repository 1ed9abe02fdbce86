"""Files that are whole or not there, and folders that are new."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, TypeVar

from caterpillar_env.errors import CaterpillarError

T = TypeVar("T")


class FileError(CaterpillarError):
    """A file or folder cannot be made where it is wanted."""


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Tells what keeps a file or a folder from being written, and what can be done.

    Raises:
        FileError: the file system, or what writes into it, refuses.
    """
    try:
        yield
    except (OSError, ValueError) as error:
        if isinstance(error, CaterpillarError):
            raise
        why = getattr(error, "strerror", None) or error
        raise FileError(f"cannot write {path}: {why}; choose another place with --out") from None


def make_folder(path: Path, otherwise: str) -> None:
    """Make a folder, which may be there if nothing is in it.

    Args:
        path: of the folder.
        otherwise: what else there is to say where there is something in it.

    Raises:
        FileError: there is something in it, or it cannot be made.
    """
    with writing(path):
        path.mkdir(parents=True, exist_ok=True)
        if any(path.iterdir()):
            raise FileError(f"{path} is not empty; choose another with --out{otherwise}")


def unused(parent: Path, name: str) -> Path:
    """A folder of this name that is not there yet, numbered if need be."""
    number = 1
    while (folder := parent / (name if number == 1 else f"{name}-{number}")).exists():
        number += 1
    return folder


def write_json(path: Path, data: Any) -> None:
    """Write a file whole or not at all."""
    partial = path.with_name(f".{path.name}.partial")
    partial.write_text(json.dumps(data, indent=2) + "\n", encoding="utf-8")
    os.replace(partial, path)


def read(
    path: Path,
    make: Callable[[Any], T],
    error: type[CaterpillarError],
    missing: str,
    parse: Callable[[str], Any] = json.loads,
) -> T:
    """What a file holds.

    Args:
        path: of the file.
        make: takes its parsed text.
        error: raised where there is no such file, or nothing in it that can be used.
        missing: what is to be done where there is none.
        parse: takes its text.
    """
    try:
        data = parse(path.read_text(encoding="utf-8"))
    except OSError as problem:
        raise error(f"cannot read {path}: {problem.strerror}; {missing}") from None
    except ValueError as problem:
        kind = path.suffix.removeprefix(".").upper() or "text"
        raise error(f"{path} is not {kind}: {problem}") from None
    try:
        return make(data)
    except CaterpillarError as problem:
        raise error(f"{path}: {problem}") from None
