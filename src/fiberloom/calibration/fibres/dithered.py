"""What an observatory has after one field of stars: fluxes in a few exposures, between which all stars moved.

The telescope puts every star off its place by the same small vector, exposure by exposure (a dither); fibres
stay. All lengths are in the focal plane.
"""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from fiberloom.errors import InputError
from fiberloom.typing import Flags, Floats, Ints

STEP_UM = 45.0
"""Of the pattern. Light falls steepest near the rim of a fibre: a star that is inside in all exposures tells
little of where it is (bounds by step: docs/calibration/fibres.md)."""
MOST_EXPOSURES = 13
"""Of the whole pattern: the middle and two rings."""
CORE_UM = 120.0
"""Diameter of the core of a science fibre (SDSS-V's BOSS and APOGEE fibres)."""


def hexagon(step_um: float = STEP_UM, n: int = MOST_EXPOSURES) -> Floats:
    """(n, 2) um: the middle, the six places around it, and the six between those and farther out.

    `step_um`: distance of neighbouring places, um; `n`: how many of the 13.
    """
    if not 1 <= n <= MOST_EXPOSURES or not step_um > 0.0:
        raise InputError(f"dithers: {n} of {step_um:g} um; give 1 to {MOST_EXPOSURES} and a step above 0")
    turn = np.arange(6) * (np.pi / 3.0)
    rings = [step_um * np.exp(1j * turn), np.sqrt(3.0) * step_um * np.exp(1j * (turn + np.pi / 6.0))]
    z = np.concatenate([[0.0], *rings])[:n]
    return np.column_stack([z.real, z.imag])


@dataclass(frozen=True, eq=False)
class DitheredField:
    """E exposures of N fibres with a star each.

    Raises
    ------
    InputError
        Arrays that do not fit each other, a number that is none, a positioner twice.
    """

    name: str
    """For messages: the file, or the number of the field."""
    positioner_id: Ints
    """(N,) each once."""
    fibre: NDArray[np.str_]
    """(N,) name of the science fibre that was on the star."""
    star_mm: Floats
    """(N, 2) where the star is while nothing is dithered."""
    fibre_mm: Floats
    """(N, 2) where the host believes the science fibre: metrology, then arm angles and layout."""
    arm_deg: Floats
    """(N,) direction of the beta arm in the focal plane: of the x axis in which offsets are given."""
    dither_um: Floats
    """(E, 2) by which the stars were moved in each exposure, as commanded or as the guider says."""
    flux: Floats
    """(E, N) of any unit, background taken away; NaN where there is none."""
    flux_error: Floats
    """(E, N) its standard error, above 0; NaN where there is no flux."""

    def __post_init__(self) -> None:
        n, e = len(self.positioner_id), len(self.dither_um)
        shapes = {
            "fibre": (n,),
            "star_mm": (n, 2),
            "fibre_mm": (n, 2),
            "arm_deg": (n,),
            "dither_um": (e, 2),
            "flux": (e, n),
            "flux_error": (e, n),
        }
        for name, shape in shapes.items():
            if getattr(self, name).shape != shape:
                raise InputError(f"{self.name}: {name} has shape {getattr(self, name).shape}, not {shape}")
        if len(np.unique(self.positioner_id)) < n:
            raise InputError(f"{self.name}: a positioner_id appears twice")
        self._check_numbers()

    def _check_numbers(self) -> None:
        for name, most in (("star_mm", 1e5), ("fibre_mm", 1e5), ("arm_deg", 1e5), ("dither_um", 1e4)):
            if not (np.abs(getattr(self, name)) <= most).all():
                raise InputError(f"{self.name}: {name} holds a number that is none, or beyond {most:g}")
        far = np.abs(self.star_mm - self.fibre_mm).max(initial=0.0)
        if far > _FARTHEST_MM:
            raise InputError(
                f"{self.name}: a star is {far:.3g} mm from its fibre, {_FARTHEST_MM} are possible; "
                "are both in mm of the focal plane?"
            )
        if (self.flux_error <= 0.0).any():
            raise InputError(f"{self.name}: flux_error must be above 0 (NaN where there is no flux)")

    @property
    def n_exposures(self) -> int:
        """E."""
        return len(self.dither_um)

    @property
    def measured(self) -> Flags:
        """(E, N) True where there is a flux with an error."""
        found: Flags = np.isfinite(self.flux) & np.isfinite(self.flux_error)
        return found

    def turned(self) -> Floats:
        """(N, 2, 2) from the frame of the beta arm to the focal plane, of no unit: a ratio."""
        angle = np.deg2rad(self.arm_deg)
        c, s = np.cos(angle), np.sin(angle)
        return np.stack([np.stack([c, -s], axis=-1), np.stack([s, c], axis=-1)], axis=-2)

    def select(self, rows: Ints | Flags) -> DitheredField:
        """The same exposures of some of the fibres."""
        taken = {
            f.name: getattr(self, f.name)[..., rows] if f.name in _BY_COLUMN else getattr(self, f.name)[rows]
            for f in fields(self)
            if f.name not in ("name", "dither_um")
        }
        return DitheredField(self.name, dither_um=self.dither_um, **taken)


_BY_COLUMN = ("flux", "flux_error")
_FARTHEST_MM = 1.0
"""A star farther from where the host has the fibre was not meant for it."""
