"""Errors that a caller can fix. Each message states the expected value, the given value and a fix."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any, TypeVar, get_args

T = TypeVar("T")


class CaterpillarError(ValueError):
    """A value, a file or a call that does not fit; base class of the other errors of this project."""


def from_mapping(kind: type[T], value: Any, what: str) -> T:
    """Create a dataclass from a mapping of fields. Missing fields keep their defaults.

    Args:
        kind: the dataclass.
        value: mapping of field names to values.
        what: name of the dataclass for error messages.

    Raises:
        CaterpillarError: `value` is not a mapping, has an unknown field, or has a string where a number
            is expected.
    """
    if not isinstance(value, Mapping):
        raise CaterpillarError(f"{what} must be a mapping of its fields; got {value!r}")
    known = {f.name: type(f.default) for f in fields(kind)}  # type: ignore[arg-type]
    if unknown := set(value) - set(known):
        got = ", ".join(sorted(map(str, unknown)))
        raise CaterpillarError(f"{what} has no {got}; its fields are {', '.join(known)}")
    for name, given in value.items():
        if known[name] in (int, float) and isinstance(given, str):
            raise CaterpillarError(f"{name} = {given!r} must be a number")
    return kind(**value)


def check_choice(name: str, value: Any, choices: Any) -> None:
    """Raise an error unless `value` is one of the values of the `Literal` type `choices`."""
    known = get_args(choices)
    if value not in known:
        raise CaterpillarError(f"{name} = {value!r} must be one of {', '.join(known)}")
