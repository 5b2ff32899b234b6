"""Where fiducials really are, and how the file of the arms that were calibrated with them keeps it."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane
from fiberloom.typing import Floats

_KEY = "fiducials"
_FARTHEST_MM = 1.0
"""From the table: beyond it no image would have been matched."""


@dataclass(frozen=True, eq=False)
class Fiducials:
    """Where the F fiducials of a focal plane are.

    Raises
    ------
    InputError
        Numbers that cannot be places.
    """

    table_mm: Floats
    """(F, 2) where the layout has them."""
    xy_mm: Floats
    """(F, 2) where they are."""
    sigma_um: Floats
    """(F,) standard error per coordinate, without shift, turn and scale of all."""
    spot_um: float = 0.0
    """Per coordinate, by which spots of fiducials are off the fit: air, pixels."""
    n_images: int = 0
    turned_deg: float = 0.0
    """By how much the images differ in their turn, from the first to the last."""

    def __post_init__(self) -> None:
        shape = self.table_mm.shape
        if self.xy_mm.shape != shape or self.sigma_um.shape != shape[:1]:
            raise InputError(f"fiducials: {len(self.xy_mm)} places, the layout has {len(self.table_mm)}")
        if not (np.abs(self.xy_mm - self.table_mm) <= _FARTHEST_MM).all():
            raise InputError(f"fiducials: farther than {_FARTHEST_MM:g} mm from where the layout has them")
        if not (self.sigma_um >= 0.0).all():
            raise InputError("fiducials: their standard errors are none")

    @property
    def moved_um(self) -> float:
        """2-D rms of what they are off their table."""
        return 1e3 * float(np.sqrt(((self.xy_mm - self.table_mm) ** 2).sum(axis=1).mean()))

    @property
    def formal_um(self) -> float:
        """2-D rms of their standard errors."""
        return float(np.sqrt(2.0 * (self.sigma_um**2).mean()))

    def applied(self, plane: FocalPlane) -> FocalPlane:
        """The `plane` with its fiducials where they are."""
        return replace(plane, fiducials=np.column_stack([self.xy_mm, plane.fiducials[:, 2:]]))

    def summary(self) -> dict[str, Any]:
        """For focal_plane.json."""
        return {
            "off_their_table_um": self.moved_um,
            "formal_um": self.formal_um,
            "spot_um": self.spot_um,
            "images": self.n_images,
            "turned_deg": self.turned_deg,
        }

    def to_meta(self) -> dict[str, Any]:
        """For the head of a file."""
        numbers = {"xy_mm": self.xy_mm.tolist(), "sigma_um": self.sigma_um.tolist()}
        return {_KEY: numbers | {"table": _sum(self.table_mm), "sum": _sum(self.xy_mm)}}

    @classmethod
    def of_meta(cls, meta: Mapping[str, Any], table_mm: Floats) -> Fiducials | None:
        """Those of the head of a file; None where it has none. `table_mm` (F, 2): of the layout.

        InputError where they are those of another layout, or were changed by hand.
        """
        if _KEY not in meta:
            return None
        known = meta[_KEY]
        if not isinstance(known, dict) or not {"xy_mm", "sigma_um", "table", "sum"} <= known.keys():
            raise InputError("fiducials: no table of their places; calibrate again")
        xy_mm = np.asarray(known["xy_mm"], dtype=np.float64).reshape(-1, 2)
        if known["table"] != _sum(table_mm):
            raise InputError(
                "fiducials: were calibrated with another layout, which has them elsewhere; calibrate again"
            )
        if known["sum"] != _sum(xy_mm):
            raise InputError("fiducials: their numbers do not fit their sum; calibrate again")
        return cls(table_mm, xy_mm, np.asarray(known["sigma_um"], dtype=np.float64))


def _sum(xy_mm: Floats) -> str:
    """16 hex digits of places (F, 2) to the nanometre."""
    nm = np.rint(np.asarray(xy_mm) * 1e6).astype(np.int64)
    return hashlib.sha256(np.ascontiguousarray(nm).tobytes()).hexdigest()[:16]
