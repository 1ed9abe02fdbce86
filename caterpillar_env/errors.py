"""Errors that a caller can fix, and functions that check values and raise such errors.

Each message states the expected value, the given value and a fix.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import fields, is_dataclass
from functools import cache
from types import NoneType
from typing import Any, Literal, TypeVar, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

T = TypeVar("T")

_LONGEST = 1000  # maximum number of characters in a message
_TYPES: dict[Any, tuple[Any, str]] = {
    bool: ((bool, np.bool_), "true or false"), str: (str, "a string"), Mapping: (Mapping, "a mapping")
}  # fmt: skip


class CaterpillarError(ValueError):
    """Invalid value, file or call. Base class of the other errors of this project.

    The message is shortened to one line of at most 1000 characters.
    """

    def __init__(self, message: str) -> None:
        if len(message) > _LONGEST:
            half = _LONGEST // 2
            message = f"{message[: half - 5]} [...] {message[2 - half :]}"
        printable = "".join(c if c.isprintable() else " " for c in message)
        super().__init__(" ".join(printable.split()))


def from_mapping(kind: type[T], value: Any, what: str) -> T:
    """Create a dataclass from a mapping of fields. Missing fields keep their defaults.

    Args:
        kind: the dataclass. It checks the values, for example with `check_fields`.
        value: mapping of field names to values.
        what: name of the dataclass for error messages.

    Raises:
        CaterpillarError: `value` is not a mapping, or has an unknown field.
    """
    if not isinstance(value, Mapping):
        raise CaterpillarError(f"{what} must be a mapping from field names to values; got {show(value)}")
    known = [f.name for f in fields(kind)]  # type: ignore[arg-type]
    if unknown := set(value) - set(known):
        got = ", ".join(sorted(map(str, unknown)))
        raise CaterpillarError(f"{what} has no {got}; its fields are {', '.join(known)}")
    return kind(**value)


def check_choice(name: str, value: Any, choices: Any) -> None:
    """Raise an error unless `value` is one of the strings of the `Literal` type `choices`."""
    known = get_args(choices)
    if not isinstance(value, str) or value not in known:
        raise CaterpillarError(f"{name} = {show(value)} must be one of {', '.join(known)}")


def to_number(value: Any) -> int | float | None:
    """Return a finite number as a Python number, or None for other values, such as True or 10**400."""
    # `np.timedelta64` is a subclass of `np.integer`.
    if isinstance(value, (bool, np.timedelta64)) or not isinstance(
        value, (int, float, np.integer, np.floating)
    ):
        return None
    try:
        finite = math.isfinite(value)
    except OverflowError:
        return None
    number: int | float = value.item() if isinstance(value, np.generic) else value
    return number if finite else None


def check_number(
    name: str, value: Any, lower: float = -math.inf, upper: float = math.inf, *, whole: bool = False
) -> Any:
    """Return `value` as a Python number, after checking that it is finite and within bounds.

    Args:
        name: name of the value for error messages.
        value: the value.
        lower: smallest valid value.
        upper: largest valid value.
        whole: whether only integers are valid, up to 2**63 in magnitude.

    Raises:
        CaterpillarError: the value is not a valid number.
    """
    number = to_number(value)
    typed = number is not None and not (whole and (isinstance(number, float) or abs(number) > 2**63))
    if number is not None and typed and lower <= number <= upper:
        return number
    wanted, form = ("an integer", "") if whole else ("a finite number", "g")
    upper = min(upper, 2**63) if whole else upper
    if lower > -math.inf:
        wanted += f" from {lower:{form}}" + (f" to {upper:{form}}" if upper < math.inf else "")
    raise CaterpillarError(f"{name} = {show(value)} must be {wanted}")


def check_fields(instance: Any, bounds: Mapping[str, tuple[float, float]] | None = None) -> None:
    """Check the fields of a dataclass. NumPy scalars become Python scalars, and lists become tuples.

    The types and bounds of numbers, `Literal` choices, strings, booleans, mappings, dataclasses and
    tuples of these (of any length) are checked. None is accepted where the annotation allows it. Fields
    of other types are not checked.

    Args:
        instance: an instance of the dataclass. Call this function in `__post_init__`.
        bounds: smallest and largest valid number, by name of the field.

    Raises:
        CaterpillarError: a value has another type, is not finite or is out of bounds.
    """
    for name, kind in _hints(instance.__class__).items():
        limits = (bounds or {}).get(name, (-math.inf, math.inf))
        value = getattr(instance, name)
        checked = _check_type(name, value, kind, limits)
        if checked is not value:
            object.__setattr__(instance, name, checked)


@cache
def _hints(kind: Any) -> dict[str, Any]:
    hints = get_type_hints(kind)
    return {f.name: hints[f.name] for f in fields(kind)}


def _check_type(name: str, value: Any, kind: Any, bounds: tuple[float, float]) -> Any:
    options = get_args(kind)
    if NoneType in options:
        (kind,) = (option for option in options if option is not NoneType)
        return None if value is None else _check_type(name, value, kind, bounds)
    if kind in (int, float):
        return check_number(name, value, *bounds, whole=kind is int)
    origin = get_origin(kind) or kind
    if origin is Literal:
        check_choice(name, value, kind)
    elif origin is tuple and options[1:] == (...,):
        if not isinstance(value, (list, tuple)):
            raise CaterpillarError(f"{name} = {show(value)} must be a list")
        return tuple(_check_type(f"an entry of {name}", entry, options[0], bounds) for entry in value)
    elif origin in _TYPES or is_dataclass(origin):
        types, wanted = _TYPES.get(origin) or (origin, f"a {origin.__name__}")
        if not isinstance(value, types):
            raise CaterpillarError(f"{name} = {show(value)} must be {wanted}")
        return bool(value) if origin is bool else value
    return value


def to_array(value: Any) -> NDArray[np.float64] | None:
    """Return numbers as an array, or None if they are ragged, too large or not numbers."""
    try:
        return np.asarray(value, dtype=np.float64)
    except (TypeError, ValueError, OverflowError, RecursionError):
        return None


def show(value: Any) -> str:
    """Return the `repr` of a value, or its type if `repr` fails (e.g. integers with 5000 digits)."""
    try:
        return repr(value)
    except (ValueError, RecursionError):
        return f"a value of type {type(value).__name__}"
