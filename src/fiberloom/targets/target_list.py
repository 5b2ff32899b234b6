"""A target list in focal-plane millimetres."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fiberloom.errors import InputError

FREE = -1
"""positioner_id of a target that any positioner may take."""


@dataclass(frozen=True, eq=False)
class TargetList:
    """n targets; all arrays have the shape (n,)."""

    target_id: NDArray[np.str_]
    x_mm: NDArray[np.float64]
    y_mm: NDArray[np.float64]
    priority: NDArray[np.float64]
    """Higher first."""
    fibre: NDArray[np.str_]
    """Fibre that must look at it; empty: any science fibre."""
    positioner_id: NDArray[np.int64]
    """Positioner that must take it; -1: any."""

    def __post_init__(self) -> None:
        n = len(self.target_id)
        for name in ("x_mm", "y_mm", "priority", "fibre", "positioner_id"):
            if getattr(self, name).shape != (n,):
                raise InputError(f"target list: {name} must have {n} values, one per target_id")

    def __len__(self) -> int:
        return len(self.target_id)

    @property
    def xy_mm(self) -> NDArray[np.float64]:
        """(n, 2) positions."""
        return np.column_stack([self.x_mm, self.y_mm])

    def select(self, rows: NDArray) -> "TargetList":
        """Some rows of the list, by index or mask."""
        return TargetList(
            self.target_id[rows],
            self.x_mm[rows],
            self.y_mm[rows],
            self.priority[rows],
            self.fibre[rows],
            self.positioner_id[rows],
        )
