"""What the compiled planner and verifier need of a focal plane: plain arrays in mm and rad."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane
from fiberloom.instruments.model import AXES
from fiberloom.typing import Floats
from fiberloom.units import deg_to_rad

ROUNDING_RAD = 1e-8
"""Angles that differ by less are the same: a count of the bus is 5.9e-9 rad, a digit of the JSON
form 1.7e-11 rad."""

BEYOND_RANGE_DEG = np.array([-4.0, 10.0])
"""How far beyond the range of targets an axis may go on its way, if the hard stops allow: for the
approach, and to fold a little more than fully. All of 360 deg for beta would double the search."""

STOP_ROOM_DEG = 1.0
"""Kept to the hard stops on the way: the motor's angle, which is what the firmware limits, differs from
the output's by the non-linearity (up to 0.6 deg accepted) and the backlash (0.25 deg)."""


STOP_DOUBT_DEG = 5.0
"""[A] By so much a report may lie beyond a hard stop, after a poor datum. Farther out no arm can be."""


@dataclass(frozen=True)
class CollisionBodies:
    """First arguments of `_core.planning`."""

    arms: Floats
    segment_mm: tuple[float, float]
    radius_mm: float
    obstacles: Floats

    @classmethod
    def of(cls, plane: FocalPlane, collision_buffer_mm: float | None = None) -> "CollisionBodies":
        """The bodies of a plane; its own collision buffer when left out."""
        _refuse_wide(plane, plane.collision_buffer_mm if collision_buffer_mm is None else collision_buffer_mm)
        discs = plane.fiducials[:, [0, 1, 0, 1, 2]]
        radius = plane.collision_buffer_mm if collision_buffer_mm is None else collision_buffer_mm
        obstacles = np.vstack([discs, plane.guide_cameras.reshape(-1, 5)])
        return cls(plane.arms, plane.beta_segment_mm, float(radius), obstacles)

    @property
    def arguments(self) -> tuple[Floats, tuple[float, float], float, Floats]:
        """In the order of the compiled functions: arms (mm, rad), segment in mm, radius in mm,
        obstacles in mm.
        """
        return self.arms, self.segment_mm, self.radius_mm, self.obstacles


def _refuse_wide(plane: FocalPlane, radius_mm: float) -> None:
    """Arms wider than the pitch overlap everywhere: a search or proof among them takes minutes to hours."""
    if plane.n < 2:
        return
    nearest = cKDTree(plane.centres_mm).query(plane.centres_mm, k=2)[0][:, 1]
    pitch_mm = float(np.median(nearest))
    if not 2.0 * radius_mm < pitch_mm:
        raise InputError(
            f"collision_buffer_mm = {radius_mm:g}: the arms are {2.0 * radius_mm:g} mm wide, the positioners "
            f"{pitch_mm:g} mm apart; wider than that nothing can move"
        )


def obstacle_name(plane: FocalPlane, index: int) -> str:
    """The name of an obstacle by its index in `CollisionBodies.obstacles`."""
    fixed = len(plane.fiducials)
    return f"fiducial {index}" if index < fixed else f"guide camera {index - fixed}"


def travel_rad(plane: FocalPlane) -> Floats:
    """[[alpha_min, alpha_max], [beta_min, beta_max]] within which axes move."""
    stops, range_deg = plane.hard_stops_deg, plane.limits_deg
    wanted = range_deg + BEYOND_RANGE_DEG
    axes = plane.instrument.axes
    approach_deg = np.array([axis.approach_deg for axis in axes])
    low = np.maximum(stops[:, 0] + STOP_ROOM_DEG, wanted[:, 0])
    high = np.minimum(stops[:, 1] - STOP_ROOM_DEG, wanted[:, 1])
    # never less than what targets and their approach need
    low = np.minimum(low, range_deg[:, 0])
    high = np.maximum(high, range_deg[:, 1] + approach_deg)
    return deg_to_rad(np.column_stack([low, high]))


def beyond_stops_deg(plane: FocalPlane, angles_deg: Floats) -> Floats:
    """(n, 2) deg by which alpha and beta (n, 2) lie beyond the hard stops, where no arm can be.

    0 within `STOP_DOUBT_DEG` of them.
    """
    low, high = plane.hard_stops_deg.T
    beyond = np.maximum(low - angles_deg, angles_deg - high)
    return np.where(beyond > STOP_DOUBT_DEG, beyond, 0.0)


def require_within_stops(name: str, plane: FocalPlane, angles_deg: Floats) -> None:
    """Raises InputError where a positioner that is not offline has angles (N, 2) that no arm can have."""
    beyond = np.where(plane.offline[:, None], 0.0, beyond_stops_deg(plane, angles_deg))
    for row, axis in np.argwhere(beyond > 0.0)[:1]:
        low, high = plane.hard_stops_deg[axis]
        whose = f"positioner {plane.positioner_id[row]} has {AXES[axis]} = {angles_deg[row, axis]:g} deg"
        raise InputError(
            f"{name}: {whose}, {beyond[row, axis]:g} deg beyond its hard stop; they are at {low:g} and "
            f"{high:g} deg"
        )


def angles_rad(name: str, angles_deg: ArrayLike, plane: FocalPlane) -> Floats:
    """(N, 2) rad, checked."""
    angles = np.array(angles_deg, dtype=np.float64)
    if angles.shape != (plane.n, 2):
        raise InputError(f"{name}: shape {angles.shape}, {plane.n} positioners need ({plane.n}, 2)")
    bad = np.flatnonzero(~np.isfinite(angles).all(axis=1))
    if len(bad):
        raise InputError(
            f"{name}: positioner {plane.positioner_id[bad[0]]} has {angles[bad[0]]}; "
            "angles must be finite numbers"
        )
    return deg_to_rad(angles)


def approach_rad(plane: FocalPlane, approach_deg: ArrayLike | None) -> Floats:
    """(N,) rad: the instrument's approach when left out."""
    if approach_deg is None:
        approach_deg = plane.instrument.approach_deg
    approach = np.broadcast_to(np.asarray(approach_deg, dtype=np.float64), (plane.n,))
    if not (np.isfinite(approach) & (approach >= 0.0)).all():
        raise InputError("approach_deg: must be finite and not below 0")
    return np.ascontiguousarray(deg_to_rad(approach))


def least_approach_rad(plane: FocalPlane, approach: Floats, least_deg: float | None = None) -> Floats:
    """(N,) rad to which approaches (N,) may be shortened; `least_deg`: the instrument's when left out."""
    least = plane.instrument.least_approach_deg if least_deg is None else least_deg
    return np.minimum(approach, float(deg_to_rad(least)))
