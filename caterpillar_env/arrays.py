"""Array types of the project, and compiled functions of arrays."""

from __future__ import annotations

from collections.abc import Callable
from functools import cache, wraps
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

#: NumPy array of 64-bit floats, of any shape; docstrings give shapes and units.
Array = NDArray[np.float64]
#: Indices of robots in a simulation, (R,).
Rows = NDArray[np.intp]

_F = TypeVar("_F", bound=Callable[..., Any])


def select(rows: Rows, size: int) -> Rows | slice:
    """Return `rows` as an index of arrays with `size` rows, or a slice if it selects all rows in order.

    NumPy takes several times as long with an array of indices as with a slice. A slice gives views.

    Args:
        rows: indices without repetitions, (R,).
        size: number of rows of the arrays.
    """
    if len(rows) < size or (size > 1 and (rows[1:] < rows[:-1]).any()):
        return rows
    return slice(None)


def compiled(function: _F) -> _F:
    """Return a function that Numba compiles at its first call, or reads from its cache.

    Use this for loops over numbers. Do not call trigonometric functions: their last bits depend on the
    library. Numba compiles again if the module changes, but not if another module changes, so do not use
    constants of other modules. Numba is imported at the first call, because importing it takes time.
    """

    @cache
    def compile_once() -> Callable[..., Any]:
        from numba import njit

        try:
            compiled: Callable[..., Any] = njit(cache=True)(function)
        except RuntimeError:  # no folder for the cache is writable
            compiled = njit(function)
        return compiled

    @wraps(function)
    def call(*arguments: Any) -> Any:
        return compile_once()(*arguments)

    return cast(_F, call)
