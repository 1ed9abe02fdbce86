"""One line of the validation table."""

from __future__ import annotations

from typing import NamedTuple


class Check(NamedTuple):
    """What was expected, what came, and whether that is close enough."""

    name: str
    expected: str
    got: str
    tolerance: str
    passed: bool


def near(
    name: str, expected: float, got: float, unit: str, *, rel: float = 0.0, abs_: float = 0.0
) -> Check:
    """`got` within a relative or an absolute tolerance of `expected`."""
    passed = abs(got - expected) <= max(rel * abs(expected), abs_)
    tolerance = f"{100 * rel:g} %" if rel else f"{abs_:g} {unit}"
    return Check(name, f"{expected:.5g} {unit}", f"{got:.5g} {unit}", tolerance, bool(passed))


def at_most(name: str, limit: float, got: float, unit: str) -> Check:
    """`got` not above `limit`."""
    return Check(name, f"at most {limit:.4g} {unit}", f"{got:.4g} {unit}", "", bool(got <= limit))


def at_least(name: str, limit: float, got: float, unit: str) -> Check:
    """`got` not below `limit`."""
    return Check(name, f"at least {limit:.4g} {unit}", f"{got:.4g} {unit}", "", bool(got >= limit))


def same(name: str, expected: object, got: object) -> Check:
    """`got` equal to `expected`."""
    return Check(name, str(expected), str(got), "exact", expected == got)
