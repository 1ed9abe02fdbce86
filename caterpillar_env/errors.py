"""Errors that a caller can fix; each says what was expected, what was given and what to do."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any, TypeVar, get_args

T = TypeVar("T")


class CaterpillarError(ValueError):
    """Base class of all errors that this project raises on purpose."""


class MorphologyError(CaterpillarError):
    """A body parameter is missing, unknown, not finite or outside its bounds."""


class TimingError(CaterpillarError):
    """Times have the wrong shape, are not finite or out of range, or are no whole number of steps."""


class PhysicsError(CaterpillarError):
    """A physical or numerical setting of the robot is not usable."""


class SimulationError(CaterpillarError):
    """A simulation cannot do what was asked: wrong settings, rows, shapes or order of calls."""


def from_mapping(kind: type[T], value: Any, what: str, error: type[CaterpillarError]) -> T:
    """Make a dataclass from some of its fields; the others keep their defaults.

    Args:
        kind: the dataclass.
        value: mapping of field names to values.
        what: name of the dataclass in messages.
        error: raised if `value` is not a mapping, has an unknown field, or text in place of a number.
    """
    if not isinstance(value, Mapping):
        raise error(f"{what} takes a mapping of its fields; got {value!r}")
    known = {f.name: type(f.default) for f in fields(kind)}  # type: ignore[arg-type]
    if unknown := set(value) - set(known):
        got = ", ".join(sorted(map(str, unknown)))
        raise error(f"{what} has no {got}; its fields are {', '.join(known)}")
    for name, given in value.items():
        if known[name] in (int, float) and isinstance(given, str):
            raise error(f"{name} = {given!r} must be a number")
    return kind(**value)


def check_choice(name: str, value: Any, choices: Any, error: type[CaterpillarError]) -> None:
    """Raise `error` unless a value is one of a `Literal`'s."""
    known = get_args(choices)
    if value not in known:
        raise error(f"{name} = {value!r} must be one of {', '.join(known)}")
