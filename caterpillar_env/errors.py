"""Errors that a caller can mend: each says what was expected, what came and what to do."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields
from typing import Any, TypeVar, get_args

T = TypeVar("T")


class CaterpillarError(ValueError):
    """Base of every error that this project raises on purpose."""


class MorphologyError(CaterpillarError):
    """A body parameter is missing, unknown, not finite or outside its bounds."""


class TimingError(CaterpillarError):
    """Times are of the wrong shape, not finite, out of range or no whole number of steps."""


class PhysicsError(CaterpillarError):
    """A physical or numerical setting of the robot is not usable."""


class SimulationError(CaterpillarError):
    """A simulation was asked for something it cannot do (settings, rows, shapes, order of calls)."""


def from_mapping(kind: type[T], value: Any, what: str, error: type[CaterpillarError]) -> T:
    """A dataclass from some of its fields by name.

    Args:
        kind: the dataclass.
        value: what should be a mapping of its fields.
        what: it is, in a message.
        error: raised where `value` is no mapping, or has a field that there is not, or something else
            where a number belongs.
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
    """See that a value is one of a `Literal`'s; `error` is raised where it is not."""
    known = get_args(choices)
    if value not in known:
        raise error(f"{name} = {value!r} must be one of {', '.join(known)}")
