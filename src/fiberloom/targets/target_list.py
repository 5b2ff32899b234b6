"""A target list in focal-plane millimetres."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from fiberloom.errors import InputError
from fiberloom.richtext import html_rows
from fiberloom.typing import Array, Floats, Ints

FREE = -1
"""positioner_id of a target that any positioner may take."""


@dataclass(frozen=True, eq=False)
class TargetList:
    """n targets in the focal plane; all arrays have the shape (n,). Read-only.

    Made by `read_targets`, or from arrays of your own.

    Raises
    ------
    InputError
        Arrays of different lengths.

    Examples
    --------
    >>> import numpy as np
    >>> import fiberloom as fl
    >>> targets = fl.TargetList(
    ...     target_id=np.array(["a", "b"]),
    ...     x_mm=np.array([0.0, 20.0]),
    ...     y_mm=np.array([12.0, -3.0]),
    ...     priority=np.array([1.0, 5.0]),
    ...     fibre=np.array(["BOSS", ""]),
    ...     positioner_id=np.array([-1, -1]),
    ... )
    >>> targets
    TargetList(2 targets, x 0 to 20 mm, y -3 to 12 mm)
    """

    target_id: NDArray[np.str_]
    """Name, unique."""
    x_mm: Floats
    """Position in the focal plane."""
    y_mm: Floats
    priority: Floats
    """Higher first."""
    fibre: NDArray[np.str_]
    """Fibre that must look at it; empty: any science fibre."""
    positioner_id: Ints
    """Positioner that must take it; -1: any."""

    def __post_init__(self) -> None:
        n = len(self.target_id)
        for name in ("x_mm", "y_mm", "priority", "fibre", "positioner_id"):
            if getattr(self, name).shape != (n,):
                raise InputError(f"target list: {name} must have {n} values, one per target_id")

    def __len__(self) -> int:
        return len(self.target_id)

    def __repr__(self) -> str:
        n = len(self)
        if n == 0:
            return "TargetList(0 targets)"
        spans = [
            f"{name} {values.min():g} to {values.max():g} mm"
            for name, values in (("x", self.x_mm.round(1)), ("y", self.y_mm.round(1)))
        ]
        return f"TargetList({n} target{'s' if n > 1 else ''}, {', '.join(spans)})"

    def _repr_html_(self) -> str:
        rows = [
            {
                "target": str(self.target_id[k]),
                "x [mm]": float(self.x_mm[k]),
                "y [mm]": float(self.y_mm[k]),
                "priority": float(self.priority[k]),
                "fibre": str(self.fibre[k]) or "any",
                "positioner": "any" if self.positioner_id[k] == FREE else int(self.positioner_id[k]),
            }
            for k in range(min(len(self), 5))
        ]
        return html_rows(repr(self), rows)

    @property
    def xy_mm(self) -> Floats:
        """(n, 2) positions."""
        return np.column_stack([self.x_mm, self.y_mm])

    def select(self, rows: Array) -> "TargetList":
        """Some of the targets.

        Parameters
        ----------
        rows : array
            Numbers or a mask.

        Returns
        -------
        TargetList

        Examples
        --------
        >>> import fiberloom as fl
        >>> targets = fl.read_targets("targets.csv")
        >>> len(targets.select(targets.priority > 2))
        20
        """
        return TargetList(
            self.target_id[rows],
            self.x_mm[rows],
            self.y_mm[rows],
            self.priority[rows],
            self.fibre[rows],
            self.positioner_id[rows],
        )
