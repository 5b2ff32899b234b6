"""Calibration of steppers on a bench, each unit alone under a camera: mechanical zeros, errors of the gears.

One axis turns to and fro over its range while the other stands, sweep after sweep, each begun by a search of
the datum. The circles that fibres go on tell the axes and both arms. Alpha is found with the arm at a right
angle, where a fibre tells both angles; beta from the elbow that follows then. ukatc/FPUVerification finds
MOONS' tables so.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from fiberloom.calibration.transmission.circle import fit_circles
from fiberloom.drive.steppers.found_arms import FoundArms
from fiberloom.drive.steppers.known import KnownUnits
from fiberloom.drive.steppers.steps import AxisSteps
from fiberloom.instruments import FocalPlane
from fiberloom.typing import Floats, Ints
from fiberloom.units import rad_to_deg

RIGHT_DEG = 90.0
"""From folded, of beta while alpha turns."""
RUN_UP_DEG = 0.5
"""[A] Before the first point of a way, so that it is come to as all others are."""
MOST_DEG = 10.0
"""[A] Beyond this from where its steps say, a unit does not do what it is told."""
ROUNDS = 6
"""Of Newton's method, for angles of places."""


class Bench(Protocol):
    """N units, each alone."""

    def home(self) -> None:
        """All search both switches."""
        ...

    def go(self, counts: Ints) -> None:
        """All go to `counts` (N, 2)."""
        ...

    def look(self) -> Floats:
        """(N, 2) fibres in mm; NaN where not seen."""
        ...


@dataclass(frozen=True)
class BenchSettings:
    """How a bench measures."""

    knots: int = 49
    """Points of an axis; 1: only the zeros are kept, of `zero_points`."""
    sweeps: int = 3
    zero_points: int = 13


def calibrate_units(plane: FocalPlane, bench: Bench, settings: BenchSettings) -> KnownUnits:
    """Zeros, tables and arms of the N units of a `plane` on a `bench`, by `settings`.

    With one knot only the zeros are found, by the arms of the plane.
    """
    zeros = settings.knots == 1
    found = _Found(plane, bench, settings.zero_points if zeros else settings.knots)
    seen = [found.sweep() for _ in range(settings.sweeps)]
    arms = None if zeros else found.arms(seen)
    error = np.mean([found.errors(one) for one in seen], axis=0)
    off_deg = np.nan_to_num(np.abs(error), nan=np.inf).max(axis=(1, 2, 3))
    why = dict.fromkeys(np.flatnonzero(off_deg > MOST_DEG).tolist(), "on the bench it did not go where told")
    knots, error = found.knots_deg, np.nan_to_num(error)
    if zeros:
        knots = knots.mean(axis=1, keepdims=True)
        error = np.broadcast_to(error.mean(axis=(2, 3), keepdims=True), (*error.shape[:3], 1)).copy()
    return KnownUnits(found.steps, knots, error, why, arms)


class _Found:
    """What sweeps have found."""

    def __init__(self, plane: FocalPlane, bench: Bench, points: int) -> None:
        self.layout, self.plane, self.bench = plane, plane, bench
        self.steps = AxisSteps.of(plane.instrument)
        self.knots_deg = np.array(
            [np.linspace(*axis.target_range_deg, points) for axis in plane.instrument.axes]
        )
        folded = self.steps.home_deg[1]
        inner = np.sign(np.mean(plane.instrument.beta.target_range_deg) - folded)
        self._right_deg = folded + RIGHT_DEG * inner
        self._middle = points // 2

    def sweep(self) -> Floats:
        """(N, 2, 2, K, 2) mm: fibres of one sweep, by axis, way and knot."""
        self.bench.home()
        alpha = self._ways(0, self._right_deg)
        return np.stack([alpha, self._ways(1, self.knots_deg[0, self._middle])], axis=1)

    def arms(self, sweeps: list[Floats]) -> FoundArms:
        """Axes and arms by the circles of all `sweeps`; angles are told by them from then on.

        Each sweep has a datum of its own, so it has circles of its own.
        """
        circles = [[_circles(seen[:, axis]) for axis in (0, 1)] for seen in sweeps]
        centre = np.mean([alpha[:, :2] for alpha, _ in circles], axis=0)
        elbow = np.mean([np.hypot(*(beta - alpha)[:, :2].T) for alpha, beta in circles], axis=0)
        reach = np.mean([beta[:, 2] for _, beta in circles], axis=0)
        found = FoundArms.of(self.layout, np.column_stack([centre, elbow, reach]))
        self.plane = found.found
        return found

    def errors(self, seen: Floats) -> Floats:
        """(N, 2, 2, K) errors in deg by the fibres (N, 2, 2, K, 2) of a sweep."""
        alpha = self._alpha(seen[:, 0])
        # where alpha stands while beta turns: it came there falling
        told_deg = self._told(0, self._right_deg, self.knots_deg[0, self._middle])[:, 0]
        beta = self._beta(seen[:, 1], told_deg + alpha[:, 1, self._middle])
        return np.stack([alpha, beta], axis=1)

    def _alpha(self, seen: Floats) -> Floats:
        """(N, 2, K) errors of alpha, by fibres (N, 2, K, 2) in mm.

        Beta stands all the while: its angle is the mean of what all points say. By that the direction of a
        fibre from the axis tells alpha over its whole reach; both angles of one point alone tell it over no
        more than the alpha arm.
        """
        told = np.stack([self._told(0, self._right_deg, knot) for knot in self.knots_deg[0]], axis=1)
        stands_deg = self._standing_deg(seen, told)
        centre, out = self.plane.centres_mm, np.empty(seen.shape[:3])
        for way, knot in np.ndindex(seen.shape[1], seen.shape[2]):
            expected = self.plane.forward(told[:, knot, 0], stands_deg) - centre
            out[:, way, knot] = _direction_deg(seen[:, way, knot] - centre) - _direction_deg(expected)
        return _wrapped(out)

    def _standing_deg(self, seen: Floats, told_deg: Floats) -> Floats:
        """(N,) beta in deg while alpha turns, by fibres (N, 2, K, 2) in mm; `told_deg` (N, K, 2)."""
        off = np.empty(seen.shape[:3])
        for way, knot in np.ndindex(seen.shape[1], seen.shape[2]):
            angles = told_deg[:, knot].copy()
            for _ in range(ROUNDS):
                miss = seen[:, way, knot] - self.plane.forward(*angles.T)
                angles += np.linalg.solve(self.plane.jacobian(*angles.T), miss[..., None])[..., 0]
            off[:, way, knot] = _wrapped(angles - told_deg[:, knot])[:, 1]
        return np.asarray(told_deg[:, 0, 1] + off.mean(axis=(1, 2)))

    def _beta(self, seen: Floats, alpha_deg: Floats) -> Floats:
        """(N, 2, K) errors of beta, by fibres (N, 2, K, 2) in mm and where alpha is, (N,) deg."""
        off = seen - self.plane.elbows_mm(alpha_deg)[:, None, None]
        plane, direction = self.plane, _direction_deg(off)
        zero = alpha_deg + rad_to_deg(plane.alpha_off_rad + plane.beta_off_rad + plane.metrology_phi_rad)
        fixed_deg = self.knots_deg[0, self._middle]
        told = np.stack([self._told(1, fixed_deg, knot)[:, 1] for knot in self.knots_deg[1]], axis=1)
        return _wrapped(direction - zero[:, None, None] - told[:, None])

    def _ways(self, axis: int, other_deg: float) -> Floats:
        """(N, 2, K, 2) mm: fibres at the knots, while angles rise and while they fall."""
        knots = self.knots_deg[axis]
        low, high = self.plane.instrument.axes[axis].hard_stop_deg
        starts = max(knots[0] - RUN_UP_DEG, low), min(knots[-1] + RUN_UP_DEG, high)
        seen = np.empty((len(self.plane), 2, len(knots), 2))
        self._go(axis, starts[0], other_deg + RUN_UP_DEG)  # so that the other axis comes falling
        for way, start in enumerate(starts):
            self._go(axis, start, other_deg)
            for knot in range(len(knots))[:: 1 - 2 * way]:
                self._go(axis, knots[knot], other_deg)
                seen[:, way, knot] = self.bench.look()
        return seen

    def _go(self, axis: int, at_deg: float, other_deg: float) -> None:
        self.bench.go(self.steps.of_angles(self._wanted(axis, at_deg, other_deg)))

    def _told(self, axis: int, other_deg: float, at_deg: float) -> Floats:
        """(N, 2) deg that whole steps make of it."""
        return self.steps.angles_deg(self.steps.of_angles(self._wanted(axis, at_deg, other_deg)))

    def _wanted(self, axis: int, at_deg: float, other_deg: float) -> Floats:
        wanted = np.empty((len(self.plane), 2))
        wanted[:, axis], wanted[:, 1 - axis] = at_deg, other_deg
        return wanted


def _circles(seen: Floats) -> Floats:
    """(N, 3) mm: centre and radius of the circle through fibres (N, 2, K, 2)."""
    points = seen.reshape(len(seen), -1, 2)
    fit = fit_circles(points, np.ones(points.shape[:2], dtype=bool))
    return np.column_stack([fit.centre_mm, fit.radius_mm])


def _direction_deg(way_mm: Floats) -> Floats:
    """(...) deg from x of ways (..., 2)."""
    return rad_to_deg(np.arctan2(way_mm[..., 1], way_mm[..., 0]))


def _wrapped(angles_deg: Floats) -> Floats:
    out: Floats = angles_deg - 360.0 * np.rint(angles_deg / 360.0)
    return out
