"""Writing files atomically, reading them with clear errors, and making new folders."""

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
    """Raise a `FileError` with advice if a file or folder cannot be written.

    Raises:
        FileError: the block raised an OSError or a ValueError.
    """
    try:
        yield
    except (OSError, ValueError) as error:
        if isinstance(error, CaterpillarError):
            raise
        why = getattr(error, "strerror", None) or error
        raise FileError(f"cannot write {path}: {why}; choose another place with --out") from None


def make_folder(path: Path, otherwise: str) -> None:
    """Make a folder; it may exist if it is empty.

    Args:
        path: of the folder.
        otherwise: further advice for the message if the folder is not empty.

    Raises:
        FileError: the folder is not empty, or cannot be made.
    """
    with writing(path):
        path.mkdir(parents=True, exist_ok=True)
        if any(path.iterdir()):
            raise FileError(f"{path} is not empty; choose another with --out{otherwise}")


def unused(parent: Path, name: str) -> Path:
    """Return a path in `parent` that does not exist yet, numbered if necessary."""
    number = 1
    while (folder := parent / (name if number == 1 else f"{name}-{number}")).exists():
        number += 1
    return folder


def write_json(path: Path, data: Any) -> None:
    """Write a JSON file completely or not at all."""
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
    """Read a file.

    Args:
        path: of the file.
        make: makes the result from the parsed text.
        error: raised if the file is missing or not usable.
        missing: advice for the message if the file is missing.
        parse: parses the text.
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
