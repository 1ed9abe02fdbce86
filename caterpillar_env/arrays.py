"""Array types of the project."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

#: NumPy array of 64-bit floats, of any shape; docstrings give shapes and units.
Array = NDArray[np.float64]
#: Indices of robots in a simulation, (R,).
Rows = NDArray[np.intp]
