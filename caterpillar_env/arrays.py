"""Array types of the project."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

#: NumPy array of 64-bit floats, of any shape; docstrings give shapes and units.
Array = NDArray[np.float64]
#: Indices of robots in a simulation, (R,).
Rows = NDArray[np.intp]

_NEXT, _LAST = np.array([1, 2, 0]), np.array([2, 0, 1])  # axes after and before x, y and z


def select(rows: Rows, size: int) -> Rows | slice:
    """Return an index of the same rows of arrays with `size` rows, as a slice if it is all of them.

    NumPy takes several times as long with an array of indices as with a slice. A slice gives views.

    Args:
        rows: indices without repetitions, (R,).
        size: number of rows of the arrays.
    """
    if len(rows) < size or (size > 1 and (rows[1:] < rows[:-1]).any()):
        return rows
    return slice(None)


def cross(a: Array, b: Array) -> Array:
    """Return the cross product of (..., 3) arrays, several times faster than `np.cross`."""
    next_a, next_b = a.take(_NEXT, axis=-1), b.take(_NEXT, axis=-1)
    last_a, last_b = a.take(_LAST, axis=-1), b.take(_LAST, axis=-1)
    return next_a * last_b - last_a * next_b
