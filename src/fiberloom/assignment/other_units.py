"""Target lists whose coordinates look like another unit than millimetres."""

import numpy as np

from fiberloom.instruments import FocalPlane
from fiberloom.targets import TargetList
from fiberloom.typing import Floats

DEG_MM = (60.0, 2200.0)
"""[A] mm of focal plane per degree of sky, from survey telescopes (SDSS-V 217, PFS 320) to MOONS (2100)."""

UNITS_MM: dict[str, tuple[float, float]] = {
    "m": (1e3, 1e3),
    "um": (1e-3, 1e-3),
    "deg": DEG_MM,
    "arcsec": (DEG_MM[0] / 3600.0, DEG_MM[1] / 3600.0),
}
"""Unit: mm in one of it, least and most."""

FILLS = (0.2, 1.5)
"""[A] Share of the focal plane's radius to which the targets of a field reach."""
FEW = 0.5
"""[A] A list is doubted where fewer than this share of what could be assigned was."""


def unit_hint(plane: FocalPlane, targets: TargetList, n_assigned: int) -> str:
    """A line for the operator where few targets were assigned and another unit explains it; else empty.

    `n_assigned`: how many targets of the list have a positioner.
    """
    could = min(len(targets), plane.n)
    if not could or n_assigned >= FEW * could:
        return ""
    radius_mm = float((np.hypot(*plane.centres_mm.T) + plane.body_reach_mm).max())
    extent = _extent(targets)
    if FILLS[0] * radius_mm <= extent <= FILLS[1] * _whole_radius_mm(plane, radius_mm):
        return ""
    fits = [unit for unit, mm in UNITS_MM.items() if _fills(extent, mm, radius_mm)]
    if not fits:
        return ""
    return (
        f"the targets spread over {extent:.3g} and the focal plane over {radius_mm:.3g} mm: "
        f"x_mm and y_mm look like {' or '.join(fits)}; they must be mm"
    )


def _whole_radius_mm(plane: FocalPlane, radius_mm: float) -> float:
    """Of the instrument's focal plane, of which `plane` may be a part."""
    share = plane.n / plane.instrument.layout.n_positioners
    return float(radius_mm / np.sqrt(min(share, 1.0)))


def _extent(targets: TargetList) -> float:
    """Distance of the outermost target from the centre, or from the middle of all on a sky far from 0."""
    xy: Floats = targets.xy_mm
    from_centre = float(np.hypot(*xy.T).max())
    spread = float(np.hypot(*(xy - np.median(xy, axis=0)).T).max())
    return spread if 0.0 < spread < FILLS[0] * from_centre else from_centre


def _fills(extent: float, unit_mm: tuple[float, float], radius_mm: float) -> bool:
    low, high = FILLS[0] * radius_mm, FILLS[1] * radius_mm
    return extent * unit_mm[0] <= high and extent * unit_mm[1] >= low
