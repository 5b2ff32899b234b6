"""DESI's own way to a target: angles are added up, and set to what is seen only where they are far off."""

from __future__ import annotations

import numpy as np

from fiberloom.drive.desi.places import angles_near
from fiberloom.instruments import FocalPlane
from fiberloom.typing import Flags, Floats

TRACKING_UM = 65.0
"""Tracked angles are set to the measured ones where these are farther off (fiposcontrol)."""


class TrackingLaw:
    """The published law: a blind move by what was added up, then one correction by what is seen."""

    def __init__(self, plane: FocalPlane, tracked_deg: Floats, tracking_um: float = TRACKING_UM) -> None:
        """`plane`: N positioners; `tracked_deg` (N, 2): where they are; `tracking_um`: 0 always believes."""
        self.plane, self.tracking_um = plane, tracking_um
        self.tracked_deg = tracked_deg.copy()
        self.seen_deg = tracked_deg.copy()
        """(N, 2) by the last image, or as tracked since."""

    def blind_way(self, goal_deg: Floats) -> Floats:
        """(N, 2) deg to command for a goal (N, 2) in deg, by what is tracked."""
        return goal_deg - self.tracked_deg

    def correction_way(self, goal_deg: Floats) -> Floats:
        """(N, 2) deg to command for a goal (N, 2) in deg, by the last image."""
        return goal_deg - self.seen_deg

    def went(self, way_deg: Floats) -> None:
        """A way (N, 2) in deg was commanded."""
        self.tracked_deg = self.tracked_deg + way_deg
        self.seen_deg = self.seen_deg + way_deg

    def see(self, xy_mm: Floats, sigma_mm: Floats | float, seen: Flags) -> None:
        """An image shows fibres at `xy_mm` (N, 2), those `seen` (N,); `sigma_mm` per coordinate: not used."""
        measured = angles_near(self.plane, xy_mm, self.tracked_deg)
        off = self.plane.forward(*self.tracked_deg.T) - xy_mm
        told = seen & np.isfinite(measured).all(axis=1)
        self.seen_deg = np.where(told[:, None], measured, self.tracked_deg)
        far = told & (1e3 * np.hypot(*off.T) > self.tracking_um)
        self.tracked_deg = np.where(far[:, None], measured, self.tracked_deg)
