"""The arms of n cobras: from angles of motors to fibres, and back. Angles are counted from the stops.

theta turns the elbow about the centre, phi the fibre about the elbow; `angle_deg` (n, 2) of both motors is
0 at their counter-clockwise stop. The arm's own angles (alpha, beta of a focal plane) are these plus the
stop's. phi of an arm is in [-180, 0] deg: folded at -180, stretched at 0.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fiberloom.instruments import FocalPlane
from fiberloom.typing import Floats, Ints
from fiberloom.units import deg_to_rad, rad_to_deg

BEYOND_STOP_DEG = (8.0, 1.0)
"""So far beyond a stop of theta and phi an arm may be seen: folded, a micrometre turns theta by degrees."""
NEAREST_MM = 0.005
ON_CENTRE = 10.0
"""So many errors of the camera from its centre a fibre tells which way it is."""
NO_LEVER_MM = 0.1
"""A fibre this near to a singular place is taken to be so far from it: errors stay finite."""


@dataclass(frozen=True, eq=False)
class CobraArms:
    """Arms of n cobras."""

    centre_mm: Floats
    """(n, 2)."""
    link_mm: Floats
    """(n, 2): centre to elbow, elbow to fibre."""
    zero_deg: Floats
    """(n, 2) directions of the links at the counter-clockwise stops: the second against the first."""
    range_deg: Floats
    """(n, 2) from stop to stop."""
    radius_mm: Floats
    """(n,) of the line from elbow to fibre: what touches."""

    @classmethod
    def of(cls, plane: FocalPlane) -> CobraArms:
        """Those of a focal plane, by its calibration."""
        low, high = stops_deg(plane)
        zero = rad_to_deg(
            np.column_stack([plane.alpha_off_rad, plane.beta_off_rad + plane.metrology_phi_rad])
        )
        links = np.column_stack([plane.l_alpha_mm, plane.l_beta_mm])
        radius = np.full(len(plane), plane.collision_buffer_mm)
        return cls(plane.centres_mm, links, zero + low, high - low, radius)

    def with_discs(self, discs_mm: Floats) -> CobraArms:
        """And after them fixed discs (m, 3) x, y, radius in mm, as arms that have no length."""
        nothing = np.zeros((len(discs_mm), 2))
        return CobraArms(
            np.vstack([self.centre_mm, discs_mm[:, :2]]),
            np.vstack([self.link_mm, nothing]),
            np.vstack([self.zero_deg, nothing]),
            np.vstack([self.range_deg, nothing]),
            np.concatenate([self.radius_mm, discs_mm[:, 2]]),
        )

    def __len__(self) -> int:
        return len(self.centre_mm)

    def fibre_deg(self, angle_deg: Floats) -> Floats:
        """(n, 2) directions in deg, of angles (n, 2): of the first link, and between the links."""
        return self.zero_deg + angle_deg

    def segments_mm(self, angle_deg: Floats, rows: slice | Ints = slice(None)) -> Floats:
        """(m, 4) x0, y0, x1, y1 of elbow and fibre in mm, of angles (m, 2) in deg of cobras `rows`."""
        turn = deg_to_rad(self.zero_deg[rows] + angle_deg)
        first, second = turn[:, 0], turn[:, 0] + turn[:, 1]
        along = np.column_stack([np.cos(first), np.sin(first)]) * self.link_mm[rows, :1]
        out = np.column_stack([np.cos(second), np.sin(second)]) * self.link_mm[rows, 1:]
        elbow = self.centre_mm[rows] + along
        return np.hstack([elbow, elbow + out])

    def xy_mm(self, angle_deg: Floats) -> Floats:
        """(n, 2) fibres in mm of angles (n, 2) in deg."""
        return self.segments_mm(angle_deg)[:, 2:]

    def angles_deg(self, xy_mm: Floats, near_deg: Floats) -> Floats:
        """(n, 2) angles in deg of fibres (n, 2) in mm, by the usual elbow; NaN stays.

        Of two theta that the stops allow, the one nearer to `near_deg` (n, 2). Places out of reach: the arm
        stretched or folded towards them.
        """
        theta, phi = self._elbow_deg(xy_mm, -1.0)
        highest = np.floor((self.range_deg[:, 0] + BEYOND_STOP_DEG[0] - theta) / 360.0)
        turn = np.clip(np.rint((near_deg[:, 0] - theta) / 360.0), 0.0, np.maximum(highest, 0.0))
        return np.column_stack([theta + 360.0 * turn, phi])

    def poses_deg(self, xy_mm: Floats) -> Floats:
        """(n, 4, 2) all angles in deg that put fibres at (n, 2) mm; NaN where the stops do not allow one.

        The usual elbow and the other one, each with theta as it is and a turn farther. A pose a little
        beyond a stop is one at the stop.
        """
        poses = []
        for side in (-1.0, 1.0):
            theta, phi = self._elbow_deg(xy_mm, side)
            poses += [np.column_stack([theta, phi]), np.column_stack([theta + 360.0, phi])]
        found = np.stack(poses, axis=1)
        top = self.range_deg[:, None]
        allowed = (found > -np.array(BEYOND_STOP_DEG)) & (found < top + np.array(BEYOND_STOP_DEG))
        # the first one stands for places out of reach too
        allowed[:, 0, 1] = True
        return np.where(allowed.all(axis=2)[..., None], found, np.nan)

    def _elbow_deg(self, xy_mm: Floats, side: float) -> tuple[Floats, Floats]:
        """Theta, the least that the stops allow, and phi: (n,) each, in deg."""
        at, (a, b) = xy_mm - self.centre_mm, self.link_mm.T
        far = np.hypot(*at.T)
        between = side * np.arccos(np.clip((far**2 - a**2 - b**2) / (2.0 * a * b), -1.0, 1.0))
        bent = a + b * np.exp(1j * between)
        theta = rad_to_deg(np.arctan2(at[:, 1], at[:, 0]) - np.angle(bent)) - self.zero_deg[:, 0]
        theta = theta + 360.0 * np.ceil((-BEYOND_STOP_DEG[0] - theta) / 360.0)
        phi = rad_to_deg(between) - self.zero_deg[:, 1]
        return theta, phi + 360.0 * np.rint((0.5 * self.range_deg[:, 1] - phi) / 360.0)

    def jacobian_mm(self, angle_deg: Floats) -> Floats:
        """(n, 2, 2) mm per rad: x and y of fibres by theta and phi, at angles (n, 2) in deg."""
        at = self.segments_mm(angle_deg)
        theta, phi = at[:, 2:] - self.centre_mm, at[:, 2:] - at[:, :2]
        columns = [np.column_stack([-arm[:, 1], arm[:, 0]]) for arm in (theta, phi)]
        return np.stack(columns, axis=2)

    def sigma_deg(self, angle_deg: Floats, camera_um: float | Floats) -> Floats:
        """(n, 2) deg by which angles seen err, for an error of the camera in um per axis."""
        turn = deg_to_rad(self.fibre_deg(angle_deg)[:, 1])
        a, b = self.link_mm.T
        far = np.maximum(np.abs(a + b * np.exp(1j * turn)), NEAREST_MM)
        # how much the fibre's distance from the centre changes with phi
        lever = np.maximum(np.abs(a * b * np.sin(turn)) / far, NO_LEVER_MM)
        camera_mm = 1e-3 * np.asarray(camera_um)
        # by how much the fibre's direction turns against the first link with phi
        bends = b * (b + a * np.cos(turn)) / far**2
        theta = np.hypot(camera_mm / far, bends * camera_mm / lever)
        sigma = np.minimum(rad_to_deg(np.stack([theta, camera_mm / lever])), 180.0)
        # a fibre on its centre shows nothing of theta
        sigma[0] = np.where(far < ON_CENTRE * camera_mm, 180.0, sigma[0])
        return sigma.T

    def reach_mm(self, phi_deg: Floats) -> Floats:
        """(n, ...) distances of fibres from their centres in mm, of phi from the stop (n, ...) in deg."""
        more = (slice(None), *(None,) * (phi_deg.ndim - 1))
        a, b = self.link_mm[:, 0][more], self.link_mm[:, 1][more]
        turn = deg_to_rad(self.zero_deg[:, 1][more] + phi_deg)
        far: Floats = np.sqrt(a**2 + b**2 + 2.0 * a * b * np.cos(turn))
        return far

    def phi_within_deg(self, reach_mm: Floats) -> Floats:
        """(n,) the most open phi in deg, from the stop, at which the fibre is within `reach_mm` (n,)."""
        a, b = self.link_mm.T
        cosine = np.clip((reach_mm**2 - a**2 - b**2) / (2.0 * a * b), -1.0, 1.0)
        phi = -rad_to_deg(np.arccos(cosine)) - self.zero_deg[:, 1]
        phi = phi + 360.0 * np.rint((0.5 * self.range_deg[:, 1] - phi) / 360.0)
        return np.clip(phi, 0.0, self.range_deg[:, 1])

    def arm_deg(self, plane: FocalPlane, angle_deg: Floats) -> Floats:
        """(n, 2) alpha and beta in deg of a `plane`, of angles from the stops."""
        return angle_deg + stops_deg(plane)[0]


def stops_deg(plane: FocalPlane) -> tuple[Floats, Floats]:
    """Hard stops (n, 2) in deg, counter-clockwise and clockwise, of alpha and beta."""
    stops = plane.stops_of()
    return stops[:, :, 0], stops[:, :, 1]
