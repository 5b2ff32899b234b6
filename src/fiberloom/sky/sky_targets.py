"""Targets on the sky."""

from __future__ import annotations

from dataclasses import dataclass, field, fields
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fiberloom.errors import InputError
from fiberloom.typing import Array, Flags, Floats, Ints

_ZERO = (
    "pm_ra_mas_yr",
    "pm_dec_mas_yr",
    "parallax_mas",
    "velocity_km_s",
    "delta_ra_arcsec",
    "delta_dec_arcsec",
    "priority",
)
FREE = -1
GUIDE = "guide"
"""In place of a fibre: a guide star, seen at the guide wavelength and taken by no positioner."""


def _empty() -> Any:
    return None


@dataclass(frozen=True, eq=False)
class SkyTargets:
    """n targets in the ICRS; all arrays have the shape (n,). What is left out is 0, free or any.

    Raises
    ------
    InputError
        Arrays of different lengths; a declination beyond 90 deg; a motion without an epoch.
    """

    target_id: NDArray[np.str_]
    ra_deg: Floats
    dec_deg: Floats
    epoch_yr: Floats = field(default_factory=_empty)
    """Julian year of the place, TDB; NaN: 2000, for what does not move."""
    pm_ra_mas_yr: Floats = field(default_factory=_empty)
    """With the cosine of the declination."""
    pm_dec_mas_yr: Floats = field(default_factory=_empty)
    parallax_mas: Floats = field(default_factory=_empty)
    velocity_km_s: Floats = field(default_factory=_empty)
    """Radial."""
    delta_ra_arcsec: Floats = field(default_factory=_empty)
    """Offset by which the fibre is put beside the target, with the cosine of the declination."""
    delta_dec_arcsec: Floats = field(default_factory=_empty)
    wavelength_A: Floats = field(default_factory=_empty)
    """NaN: that of the fibre."""
    priority: Floats = field(default_factory=_empty)
    fibre: NDArray[np.str_] = field(default_factory=_empty)
    """Empty: any."""
    positioner_id: Ints = field(default_factory=_empty)
    """-1: any."""

    def __post_init__(self) -> None:
        n = len(self.target_id)
        fill: dict[str, Array] = {name: np.zeros(n) for name in _ZERO}
        fill |= {"epoch_yr": np.full(n, np.nan), "wavelength_A": np.full(n, np.nan)}
        fill |= {"fibre": np.full(n, "", dtype=np.str_), "positioner_id": np.full(n, FREE)}
        for name, value in fill.items():
            if getattr(self, name) is None:
                object.__setattr__(self, name, value)
        for part in fields(self):
            if getattr(self, part.name).shape != (n,):
                raise InputError(f"sky targets: {part.name} must have {n} values, one per target_id")
        self._check()

    def _check(self) -> None:
        wrong = {
            "dec_deg": (np.abs(self.dec_deg) > 90.0, "must be -90 to 90"),
            "ra_deg": (np.abs(self.ra_deg) > 360.0, "must be 0 to 360"),
        }
        for name, (rows, rule) in wrong.items():
            for row in np.flatnonzero(rows | ~np.isfinite(getattr(self, name)))[:1].tolist():
                raise InputError(
                    f"target {self.target_id[row]}: {name} = {getattr(self, name)[row]:g}: {rule}"
                )
        for row in np.flatnonzero(self.moves & np.isnan(self.epoch_yr))[:1].tolist():
            raise InputError(f"target {self.target_id[row]}: has a proper motion, but no epoch")

    def __len__(self) -> int:
        return len(self.target_id)

    def __repr__(self) -> str:
        return f"SkyTargets({len(self)} target{'' if len(self) == 1 else 's'})"

    @property
    def moves(self) -> Flags:
        """(n,) which have a proper motion."""
        moving: Flags = (self.pm_ra_mas_yr != 0.0) | (self.pm_dec_mas_yr != 0.0)
        return moving

    @classmethod
    def at(cls, ra_deg: ArrayLike, dec_deg: ArrayLike) -> SkyTargets:
        """Places of no name that do not move, deg."""
        ra, dec = (
            np.atleast_1d(np.asarray(ra_deg, np.float64)),
            np.atleast_1d(np.asarray(dec_deg, np.float64)),
        )
        return cls(np.arange(len(ra)).astype(np.str_), ra, dec)

    def select(self, rows: Array) -> SkyTargets:
        """Some of them, by numbers or a mask (`rows`)."""
        return SkyTargets(**{part.name: getattr(self, part.name)[rows] for part in fields(self)})
