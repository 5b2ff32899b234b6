"""What the compiled planner and verifier need of a focal plane: plain arrays in mm and rad."""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial import cKDTree

from fiberloom._core import planning as core
from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane
from fiberloom.instruments.model import AXES
from fiberloom.instruments.single_units import handicaps_of
from fiberloom.planning.obstacles import RADIUS, doubt_obstacles, fixed_obstacles, parts_of
from fiberloom.typing import Floats, Ints
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
    """First argument of `_core.planning`, as arrays: N arms, their parts, and what does not move."""

    arms: Floats
    """(N, 5) as in `FocalPlane.arms`."""
    parts: Floats
    """(P, 8): row, arm (0 alpha, 1 beta), x0, y0, x1, y1 in the frame of the arm and radius in mm, layers."""
    obstacles: Floats
    """(K, 7): x0, y0, x1, y1, radius in mm, layers, row of the positioner whose uncertain place it covers
    or -1."""
    segment_mm: tuple[float, float]
    """Of a beta arm: its centre line, from and to along the arm."""
    radius_mm: float
    """The collision buffer that all have in common."""

    @classmethod
    def of(cls, plane: FocalPlane, collision_buffer_mm: float | None = None) -> "CollisionBodies":
        """The bodies of a plane; its own collision buffer when left out."""
        radius_mm = float(plane.collision_buffer_mm if collision_buffer_mm is None else collision_buffer_mm)
        _refuse_wide(plane, radius_mm)
        parts = parts_of(plane, radius_mm)
        obstacles = np.vstack([fixed_obstacles(plane), doubt_obstacles(plane, parts)])
        return cls(plane.arms, parts, obstacles, plane.beta_segment_mm, radius_mm)

    @property
    def compiled(self) -> core.Bodies:
        """As the compiled functions take it."""
        return core.Bodies(self.arms, self.parts, self.obstacles)

    def wider(self, by_mm: float) -> "CollisionBodies":
        """With all parts of all arms wider."""
        parts = self.parts.copy()
        parts[:, RADIUS] += by_mm
        return replace(self, parts=parts)

    @property
    def radii_mm(self) -> Floats:
        """(N,) the largest radius of each."""
        out = np.zeros(len(self.arms))
        np.maximum.at(out, self.parts[:, 0].astype(np.int64), self.parts[:, RADIUS])
        return out


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


def travel_rad(plane: FocalPlane) -> Floats:
    """[[alpha_min, alpha_max], [beta_min, beta_max]] within which axes move."""
    return _travel_rad(plane, plane.hard_stops_deg, plane.limits_deg)


def beyond_range_deg(plane: FocalPlane) -> Floats:
    """(2, 2) by axis: added to the lowest and highest angle of targets, how far ways may go, deg."""
    approach_deg = np.array([axis.approach_deg for axis in plane.instrument.axes])
    folds_below = (approach_deg < 0.0) | (plane.limits_deg[:, 1] <= 0.0)
    return np.where(folds_below[:, None], -BEYOND_RANGE_DEG[::-1], BEYOND_RANGE_DEG)


def travels_rad(plane: FocalPlane) -> Floats | None:
    """(N, 2, 2) the same of each positioner; None: all have the same."""
    own = plane.ranges
    return None if own is None else _travel_rad(plane, own.stops_deg, own.targets_deg)


def _travel_rad(plane: FocalPlane, stops: Floats, range_deg: Floats) -> Floats:
    """(..., 2, 2) between stops and around the range of targets (..., 2, 2) in deg."""
    approach_deg = np.array([axis.approach_deg for axis in plane.instrument.axes])
    wanted = range_deg + beyond_range_deg(plane)
    low = np.maximum(stops[..., 0] + STOP_ROOM_DEG, wanted[..., 0])
    high = np.minimum(stops[..., 1] - STOP_ROOM_DEG, wanted[..., 1])
    # never less than what targets and their approach need
    low = np.minimum(low, range_deg[..., 0] + np.minimum(approach_deg, 0.0))
    high = np.maximum(high, range_deg[..., 1] + np.maximum(approach_deg, 0.0))
    return deg_to_rad(np.stack([low, high], axis=-1))


def beyond_stops_deg(plane: FocalPlane, angles_deg: Floats, rows: Ints | None = None) -> Floats:
    """(n, 2) deg by which alpha and beta (n, 2) lie beyond the hard stops, where no arm can be.

    0 within `STOP_DOUBT_DEG` of them. `rows` (n,) of the positioners; all when left out.
    """
    low, high = np.moveaxis(plane.stops_of(rows), -1, 0)
    beyond = np.maximum(low - angles_deg, angles_deg - high)
    return np.where(beyond > STOP_DOUBT_DEG, beyond, 0.0)


def require_within_stops(name: str, plane: FocalPlane, angles_deg: Floats) -> None:
    """Raises InputError where a positioner that is not offline has angles (N, 2) that no arm can have."""
    beyond = np.where(plane.offline[:, None], 0.0, beyond_stops_deg(plane, angles_deg))
    for row, axis in np.argwhere(beyond > 0.0)[:1]:
        low, high = plane.stops_of(np.array([row]))[0, axis]
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


def beside(plane: FocalPlane, approach: ArrayLike) -> Floats:
    """(..., 2) how far above its goal each axis begins approaches (...,), rad or deg alike; below 0 where it
    comes from below.
    """
    signed: Floats = np.asarray(approach)[..., None] * np.array(plane.instrument.approach_sides)
    return signed


def paces_rad(plane: FocalPlane, speed_deg_s: float, acceleration_deg_s2: float) -> tuple[Floats, Floats]:
    """(N,) rad/s and rad/s2 of each positioner: its share of a speed and of an acceleration."""
    shares = handicaps_of(plane)
    speed, acceleration = deg_to_rad(speed_deg_s), deg_to_rad(acceleration_deg_s2)
    return speed * shares.speed_share, acceleration * shares.acceleration_share
