"""Where an arm is whose report is not believed: by its fibre in an image.

The inverse does not tell near a folded or stretched arm: some um inside of the reach there is no solution,
and some um outside the elbow is millimetres away. But where the fibre is as far from the alpha axis as
reported, alpha alone is off, and beta is as reported.

And what a dark fibre shows when it is seen again: one image may show the spot of another, two in a row not.
"""

from __future__ import annotations

import numpy as np

from fiberloom.instruments import METROLOGY, FocalPlane
from fiberloom.instruments.axis import DriveTable
from fiberloom.typing import Flags, Floats, Ints

SCATTER_MM = DriveTable().scatter_mm
"""Of healthy positioners about where they report, per coordinate, where no instrument says."""

_SAME_RADIUS = 3.0 * SCATTER_MM
_FOLDED = 0.2
"""Sine of beta, below which an image tells beta to half a degree and worse: 12 deg from either end."""
IN_A_ROW = 2
"""Images, each after a move, that must show the same of a dark fibre to be believed."""


def where_seen(plane: FocalPlane, rows: Ints, seen_mm: Floats, reported_deg: Floats) -> tuple[Floats, Flags]:
    """Angles (n, 2) in deg of the positioners in `rows` (n,) of a `plane`, and (n,) which are known.

    `seen_mm`: (n, 2) their metrology fibres in an image; `reported_deg`: (n, 2) the angles that they report.
    Where the place is not known the angles are the reported ones.
    """
    found = plane.inverse(seen_mm, METROLOGY, index=rows, near_deg=reported_deg)
    folded = ~found.reachable | (np.abs(np.sin(np.deg2rad(found.beta_deg))) < _FOLDED)
    turned_deg, fits = _turned(plane, rows, seen_mm, reported_deg)
    angles_deg = np.where(found.reachable[:, None], np.column_stack(found[:2]), reported_deg)
    return np.where((folded & fits)[:, None], turned_deg, angles_deg), found.reachable | fits


def _turned(plane: FocalPlane, rows: Ints, seen_mm: Floats, reported_deg: Floats) -> tuple[Floats, Flags]:
    """Angles with alpha turned into the direction of the fibre; True where it is as far out as that."""
    reported_mm = plane.forward(reported_deg[:, 0], reported_deg[:, 1], METROLOGY, index=rows)
    seen, reported = (xy - plane.centres_mm[rows] for xy in (seen_mm, reported_mm))
    turn_deg = np.rad2deg(np.arctan2(*seen.T[::-1]) - np.arctan2(*reported.T[::-1]))
    low, high = plane.stops_of(rows)[:, 0].T
    # of two turns that the stops allow the one nearer to what is reported, as the inverse has it
    alpha_deg = reported_deg[:, 0] + (turn_deg + 180.0) % 360.0 - 180.0
    alpha_deg += 360.0 * (alpha_deg < low) - 360.0 * (alpha_deg > high)
    inside = (alpha_deg >= low) & (alpha_deg <= high)
    fits = inside & (np.abs(np.hypot(*seen.T) - np.hypot(*reported.T)) <= _SAME_RADIUS)
    return np.column_stack([alpha_deg, reported_deg[:, 1]]), fits


class InARow:
    """Counts images of N dark fibres that show the same of them, one after the other."""

    def __init__(self, n: int) -> None:
        self._images = np.zeros(n, dtype=np.int64)

    def rows(self, dark: Flags, there: Flags) -> Ints:
        """Those `dark` (N,) until now of which it is believed; an image shows it of those `there` (N,)."""
        self._images = np.where(dark & there, self._images + 1, 0)
        return np.flatnonzero(self._images >= IN_A_ROW)


def is_there(measured_mm: Floats, believed_mm: Floats, allowed_mm: Floats) -> Flags:
    """(N,) fibres that an image shows within `allowed_mm` (N,) of `believed_mm` (N, 2).

    `measured_mm` (N, 2): where it shows them; NaN where not seen.
    """
    return np.asarray(np.hypot(*(measured_mm - believed_mm).T) <= allowed_mm)
