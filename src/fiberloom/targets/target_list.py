"""A target list in focal-plane millimetres."""

from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fiberloom.errors import InputError
from fiberloom.richtext import html_rows
from fiberloom.typing import Array, Floats, Ints

if TYPE_CHECKING:
    from fiberloom.sky.on_sky import OnSky

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
    by_fibre: Mapping[str, Floats] = field(default_factory=dict)
    """(n, 2) mm by fibre, of targets on the sky: colours stand apart. Others have one place for all."""
    on_sky: "OnSky | None" = None
    """Of targets on the sky: where they are there, and the field."""

    def __post_init__(self) -> None:
        n = len(self.target_id)
        for name in ("x_mm", "y_mm", "priority", "fibre", "positioner_id"):
            if getattr(self, name).shape != (n,):
                raise InputError(f"target list: {name} must have {n} values, one per target_id")
        for fibre, places in self.by_fibre.items():
            if places.shape != (n, 2):
                raise InputError(f"target list: by_fibre['{fibre}'] must have {n} places, one per target_id")

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
            {fibre: places[rows] for fibre, places in self.by_fibre.items()},
            None if self.on_sky is None else self.on_sky.select(rows),
        )

    def place_mm(self, fibre: str) -> Floats:
        """Where a fibre must be to look at the targets.

        Parameters
        ----------
        fibre : str
            By its name in the instrument.

        Returns
        -------
        (n, 2) float
            mm; the same for all fibres but for targets on the sky.

        Examples
        --------
        >>> import fiberloom as fl
        >>> targets = fl.read_targets("targets.csv")
        >>> bool((targets.place_mm("BOSS") == targets.xy_mm).all())
        True
        """
        return self.by_fibre.get(fibre, self.xy_mm)

    def settled(self, target: Ints, fibre: NDArray[np.str_]) -> "TargetList":
        """The list with the one place in mm that counts, for targets whose fibre has been chosen.

        Parameters
        ----------
        target : array
            (N,) row of the target of each positioner, -1 for none.
        fibre : array
            (N,) its fibre.

        Returns
        -------
        TargetList
            The same n targets; mm.

        Examples
        --------
        >>> import fiberloom as fl
        >>> targets = fl.read_targets("targets.csv")
        >>> assigned = fl.assign(fl.FocalPlane.of("sdssv", n=7), targets)
        >>> len(targets.settled(assigned.target, assigned.fibre))
        60
        """
        if not self.by_fibre:
            return self
        xy = self.xy_mm
        for name in self.by_fibre:
            rows = target[(target >= 0) & (fibre == name)]
            xy[rows] = self.by_fibre[name][rows]
        return replace(self, x_mm=xy[:, 0].copy(), y_mm=xy[:, 1].copy(), by_fibre={})

    def moved(self, shift_mm: ArrayLike) -> "TargetList":
        """The list with each of its places moved.

        Parameters
        ----------
        shift_mm : array
            (n, 2) mm, or one for all.

        Returns
        -------
        TargetList
            The places of every fibre are moved alike.

        Examples
        --------
        >>> import fiberloom as fl
        >>> targets = fl.read_targets("targets.csv")
        >>> bool((targets.moved([1.0, 0.0]).x_mm == targets.x_mm + 1.0).all())
        True
        """
        x, y = (self.xy_mm + np.asarray(shift_mm)).T.copy()
        by_fibre = {fibre: places + np.asarray(shift_mm) for fibre, places in self.by_fibre.items()}
        return replace(self, x_mm=x, y_mm=y, by_fibre=by_fibre)
