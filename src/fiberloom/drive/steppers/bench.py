"""Calibration of steppers on a bench, each unit alone under a camera: mechanical zeros, errors of the gears.

One axis turns to and fro over its range while the other stands, sweep after sweep, each begun by a search of
the datum. Alpha is found with the arm at a right angle, where a fibre tells both angles; beta from the elbow
that follows then. Layout and arms are those of the plane. ukatc/FPUVerification finds MOONS' tables so.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

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
    """Zeros and tables of the N units of a `plane` on a `bench`, by `settings`."""
    found = _Found(plane, bench, settings.zero_points if settings.knots == 1 else settings.knots)
    error = np.mean([found.sweep() for _ in range(settings.sweeps)], axis=0)
    off_deg = np.nan_to_num(np.abs(error), nan=np.inf).max(axis=(1, 2, 3))
    why = dict.fromkeys(np.flatnonzero(off_deg > MOST_DEG).tolist(), "on the bench it did not go where told")
    knots, error = found.knots_deg, np.nan_to_num(error)
    if settings.knots == 1:
        knots = knots.mean(axis=1, keepdims=True)
        error = np.broadcast_to(error.mean(axis=(2, 3), keepdims=True), (*error.shape[:3], 1)).copy()
    return KnownUnits(found.steps, knots, error, why)


class _Found:
    """What sweeps have found."""

    def __init__(self, plane: FocalPlane, bench: Bench, points: int) -> None:
        self.plane, self.bench, self.steps = plane, bench, AxisSteps.of(plane.instrument)
        self.knots_deg = np.array(
            [np.linspace(*axis.target_range_deg, points) for axis in plane.instrument.axes]
        )
        folded = self.steps.home_deg[1]
        inner = np.sign(np.mean(plane.instrument.beta.target_range_deg) - folded)
        self._right_deg = folded + RIGHT_DEG * inner

    def sweep(self) -> Floats:
        """(N, 2, 2, K) errors in deg of one sweep."""
        self.bench.home()
        alpha = self._alpha(self._ways(0, self._right_deg))
        middle = self.knots_deg.shape[1] // 2
        fixed_deg = self.knots_deg[0, middle]
        # where alpha stands while beta turns: it came there falling
        beta = self._beta(self._ways(1, fixed_deg), fixed_deg + alpha[:, 1, middle])
        return np.stack([alpha, beta], axis=1)

    def _alpha(self, seen: Floats) -> Floats:
        """(N, 2, K) errors of alpha, by fibres (N, 2, K, 2) in mm."""
        out = np.empty(seen.shape[:3])
        for way, knot in np.ndindex(seen.shape[1], seen.shape[2]):
            told = self._told(0, self._right_deg, self.knots_deg[0, knot])
            angles = told.copy()
            for _ in range(ROUNDS):
                off = seen[:, way, knot] - self.plane.forward(*angles.T)
                angles += np.linalg.solve(self.plane.jacobian(*angles.T), off[..., None])[..., 0]
            out[:, way, knot] = _wrapped(angles - told)[:, 0]
        return out

    def _beta(self, seen: Floats, alpha_deg: Floats) -> Floats:
        """(N, 2, K) errors of beta, by fibres (N, 2, K, 2) in mm and where alpha is, (N,) deg."""
        off = seen - self.plane.elbows_mm(alpha_deg)[:, None, None]
        direction = rad_to_deg(np.arctan2(off[..., 1], off[..., 0]))
        plane = self.plane
        zero = alpha_deg + rad_to_deg(plane.alpha_off_rad + plane.beta_off_rad + plane.metrology_phi_rad)
        return _wrapped(direction - zero[:, None, None] - self.knots_deg[1])

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


def _wrapped(angles_deg: Floats) -> Floats:
    out: Floats = angles_deg - 360.0 * np.rint(angles_deg / 360.0)
    return out
