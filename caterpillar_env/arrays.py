"""Array types of the project, and a decorator that compiles functions of arrays with Numba."""

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
    """Return `rows`, or a slice if `rows` selects all of `size` rows in ascending order.

    Indexing with a slice is several times faster than with an array of indices, and returns views.

    Args:
        rows: indices without repetitions, (R,).
        size: number of rows of the arrays.
    """
    if len(rows) < size or (size > 1 and (rows[1:] < rows[:-1]).any()):
        return rows
    return slice(None)


def compiled(function: _F) -> _F:
    """Return a version of `function` that Numba compiles, or loads from its cache, at the first call.

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
