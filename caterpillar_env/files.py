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


@contextmanager
def writing(path: Path) -> Iterator[None]:
    """Turn errors from writing to `path` into a `CaterpillarError` with advice.

    Raises:
        CaterpillarError: the block raised an OSError or a ValueError.
    """
    try:
        yield
    except (OSError, ValueError) as error:
        if isinstance(error, CaterpillarError):
            raise
        why = getattr(error, "strerror", None) or error
        raise CaterpillarError(f"cannot write {path}: {why}; choose another place with --out") from None


def make_folder(path: Path, otherwise: str) -> None:
    """Create a folder. An existing empty folder is accepted.

    Args:
        path: path of the folder.
        otherwise: advice to append to the message if the folder is not empty.

    Raises:
        CaterpillarError: the folder is not empty or cannot be created.
    """
    with writing(path):
        path.mkdir(parents=True, exist_ok=True)
        if any(path.iterdir()):
            raise CaterpillarError(f"{path} is not empty; choose another with --out{otherwise}")


def unused(parent: Path, name: str) -> Path:
    """Return a path in `parent` that does not exist: `name`, or `name` with a number."""
    number = 1
    while (folder := parent / (name if number == 1 else f"{name}-{number}")).exists():
        number += 1
    return folder


def write_json(path: Path, data: Any) -> None:
    """Write a JSON file atomically."""
    partial = path.with_name(f".{path.name}.partial")
    partial.write_text(json.dumps(data, indent=2) + "\n", encoding="utf-8")
    os.replace(partial, path)


def read(
    path: Path,
    make: Callable[[Any], T],
    missing: str,
    parse: Callable[[str], Any] = json.loads,
) -> T:
    """Read, parse and convert a text file.

    Args:
        path: path of the file.
        make: function that converts the parsed data to the result.
        missing: advice for the message if the file is missing.
        parse: function that parses the text.

    Raises:
        CaterpillarError: the file is missing or invalid.
    """
    try:
        data = parse(path.read_text(encoding="utf-8"))
    except OSError as problem:
        raise CaterpillarError(f"cannot read {path}: {problem.strerror}; {missing}") from None
    except ValueError as problem:
        kind = path.suffix.removeprefix(".").upper() or "text"
        raise CaterpillarError(f"{path} is not {kind}: {problem}") from None
    try:
        return make(data)
    except CaterpillarError as problem:
        raise CaterpillarError(f"{path}: {problem}") from None
