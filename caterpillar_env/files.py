"""Write files atomically, read them with clear error messages, and create folders."""

from __future__ import annotations

import errno
import hashlib
import json
import os
import stat
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any, TypeVar

from caterpillar_env.errors import CaterpillarError

T = TypeVar("T")


ELSEWHERE = "choose another place with --out"
#: Advice for files whose location is fixed.
COPY = "free some space, or copy the folder to a writable place"


@contextmanager
def writing(path: Path, advice: str = ELSEWHERE) -> Iterator[None]:
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
        raise CaterpillarError(f"cannot write {path}: {why}; {advice}") from None


def make_folder(path: Path, otherwise: str) -> None:
    """Create a folder. An existing folder is accepted if it is empty or has only hidden files.

    A process that is killed at the start leaves locks and partial files, which are hidden.

    Args:
        path: path of the folder.
        otherwise: advice to append to the message if the folder is not empty.

    Raises:
        CaterpillarError: the folder is not empty or cannot be created.
    """
    with writing(path):
        path.mkdir(parents=True, exist_ok=True)
        if any(not file.name.startswith(".") for file in path.iterdir()):
            raise CaterpillarError(f"{path} is not empty; choose another folder with --out{otherwise}")


def unused(parent: Path, name: str) -> Path:
    """Return a path in `parent` that does not exist: `name`, or `name` with a number."""
    number = 1
    while (folder := parent / (name if number == 1 else f"{name}-{number}")).exists():
        number += 1
    return folder


def name_of(path: Path) -> str:
    """Return the name of a file or folder for display. Bytes that are not UTF-8 are replaced."""
    return os.fsencode(path.resolve().name).decode(errors="replace")


def write_bytes(path: Path, data: bytes, advice: str = ELSEWHERE) -> None:
    """Write a file atomically. A symbolic link to a file is followed, and not replaced.

    Raises:
        CaterpillarError: the file cannot be written, for example because the disk is full. An existing
            file is unchanged.
    """
    target = Path(os.path.realpath(path))
    if target.exists() and not target.is_file():
        target = path  # replace a link to a device or a pipe, but not the device
    partial = target.with_name(f".{target.name}.partial")
    try:
        with writing(path, advice):
            partial.write_bytes(data)
            os.replace(partial, target)
    finally:
        with suppress(OSError):
            partial.unlink(missing_ok=True)


def write_json(path: Path, data: Any, advice: str = ELSEWHERE) -> None:
    """Write a JSON file atomically, see `write_bytes`."""
    write_bytes(path, (json.dumps(data, indent=2) + "\n").encode(), advice)


def digest_of(data: Mapping[str, Any]) -> str:
    """Return a hash of data that can be written as JSON."""
    return hashlib.blake2b(json.dumps(data).encode(), digest_size=16).hexdigest()


def with_digest(data: Mapping[str, Any]) -> dict[str, Any]:
    """Return data with an entry `digest`, by which `read` detects damage."""
    return {**data, "digest": digest_of(data)}


def _check_digest(data: Any) -> Any:
    """Return data without its digest, after checking it. Data without a digest is not checked.

    Raises:
        CaterpillarError: the data does not match its digest.
    """
    if not isinstance(data, dict) or not isinstance(data.get("digest"), str):
        return data
    rest = {name: value for name, value in data.items() if name != "digest"}
    if digest_of(rest) != data["digest"]:
        raise CaterpillarError(
            "it does not match its digest, so it was damaged or edited; restore a copy of the file, or "
            'remove its entry "digest" to use the file as it is'
        )
    return rest


def parse_json(text: str) -> Any:
    """Parse JSON.

    Raises:
        ValueError: the text is not JSON, or repeats a key of an object.
        RecursionError: the text is nested too deeply.
    """
    return json.loads(text, object_pairs_hook=_without_repetitions)


def _without_repetitions(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name, value in pairs:
        if name in found:
            raise ValueError(f"it repeats the key {name!r}")
        found[name] = value
    return found


def read(
    path: Path,
    make: Callable[[Any], T],
    missing: str,
    parse: Callable[[str], Any] = parse_json,
) -> T:
    """Read, parse and convert a text file. An entry `digest` is checked and removed, see `with_digest`.

    Args:
        path: path of the file.
        make: function that converts the parsed data to the result.
        missing: advice for the message if the file is missing or cannot be parsed.
        parse: function that parses the text, for JSON or TOML.

    Raises:
        CaterpillarError: the file is missing or invalid, does not match its digest, or is a device, a
            pipe or a folder.
    """
    try:
        if not stat.S_ISREG(path.stat().st_mode):
            raise OSError(errno.EINVAL, "it is not a regular file")
        data = parse(path.read_text(encoding="utf-8"))
    except OSError as problem:
        raise CaterpillarError(f"cannot read {path}: {problem.strerror}; {missing}") from None
    except (ValueError, RecursionError) as problem:
        kind = "JSON" if parse is parse_json else "TOML"
        raise CaterpillarError(f"{path} is not {kind}: {problem}; {missing}") from None
    try:
        return make(_check_digest(data))
    except (CaterpillarError, RecursionError) as problem:
        raise CaterpillarError(f"{path}: {problem}") from None
