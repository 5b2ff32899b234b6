"""Array types that signatures share. Shapes and units are in each docstring."""

from __future__ import annotations

from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

Floats: TypeAlias = NDArray[np.float64]
Flags: TypeAlias = NDArray[np.bool_]
Ints: TypeAlias = NDArray[np.int64]
Array: TypeAlias = NDArray[Any]
"""Of any kind: pixels as a camera gives them, the columns of a table."""
Records: TypeAlias = NDArray[Any]
"""Structured arrays: one record each for a unit, an axis or a sample."""
