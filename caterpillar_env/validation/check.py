"""Rows of the validation table."""

from __future__ import annotations

from typing import NamedTuple


class Check(NamedTuple):
    """A row of the validation table: expected value, computed value, tolerance and result."""

    name: str
    expected: str
    got: str
    tolerance: str
    passed: bool


def check_near(
    name: str, expected: float, got: float, unit: str, *, rel: float = 0.0, abs_: float = 0.0
) -> Check:
    """Check that `got` is within a relative or an absolute tolerance of `expected`."""
    passed = abs(got - expected) <= max(rel * abs(expected), abs_)
    tolerance = f"{100 * rel:g} %" if rel else f"{abs_:g} {unit}"
    return Check(name, f"{expected:.5g} {unit}", f"{got:.5g} {unit}", tolerance, bool(passed))


def check_at_most(name: str, limit: float, got: float, unit: str) -> Check:
    """Check that `got` is at most `limit`."""
    return Check(name, f"at most {limit:.4g} {unit}", f"{got:.4g} {unit}", "", bool(got <= limit))


def check_at_least(name: str, limit: float, got: float, unit: str) -> Check:
    """Check that `got` is at least `limit`."""
    return Check(name, f"at least {limit:.4g} {unit}", f"{got:.4g} {unit}", "", bool(got >= limit))


def check_equal(name: str, expected: object, got: object) -> Check:
    """Check that `got` equals `expected`."""
    return Check(name, str(expected), str(got), "exact", expected == got)
