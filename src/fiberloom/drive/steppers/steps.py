"""Signs and steps of motors that count from a datum: angle = home + sign x steps x step.

Home is where an arm is folded at its switches, `park_deg` of the instrument. MEGARA's alpha turns
backwards with the steps of rotor 1, and its rotor 2 counts 0 or below (a sample programme of megara-fmpt).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane, Instrument
from fiberloom.typing import Floats, Ints

BACKWARDS = ("megara",)
"""Protocols whose steps count against the angles."""


@dataclass(frozen=True, eq=False)
class AxisSteps:
    """Turns angles of the arms into steps of their motors, and back."""

    name: str
    """Of the instrument, for messages."""
    step_deg: Floats
    """(2,) of alpha and beta at the arm."""
    home_deg: Floats
    """(2,) at no steps."""
    sign: float = 1.0
    """1 or -1: angles over steps."""

    @classmethod
    def of(cls, instrument: Instrument) -> AxisSteps:
        """Those of an instrument; InputError where an axis has no steps."""
        step = np.array([axis.smallest_step_deg for axis in instrument.axes])
        if not (step > 0.0).all():
            raise InputError(f"{instrument.name}: alpha and beta need steps_per_turn, or step_deg")
        sign = -1.0 if instrument.drive.protocol in BACKWARDS else 1.0
        return cls(instrument.name, step, np.array(instrument.positioner.park_deg), sign)

    def of_angles(self, angles_deg: Floats) -> Ints:
        """(N, 2) steps nearest to angles (N, 2) in deg; InputError for angles that are no numbers."""
        if not np.isfinite(angles_deg).all():
            raise InputError(f"{self.name}: angles must be finite numbers of deg")
        return np.rint(self.sign * (angles_deg - self.home_deg) / self.step_deg).astype(np.int64)

    def angles_deg(self, steps: Ints | Floats) -> Floats:
        """(..., 2) angles in deg of the arms after steps (..., 2), of arms that lost none."""
        counted = np.asarray(steps, dtype=np.float64)
        out: Floats = self.home_deg + self.sign * counted * self.step_deg
        return out

    def of_plane(self, plane: FocalPlane, angles_deg: Floats) -> Ints:
        """As `of_angles`; InputError that names the first of a `plane` whose angles are beyond its stops."""
        low, high = np.moveaxis(plane.stops_of(), -1, 0)
        for row, axis in np.argwhere((angles_deg < low) | (angles_deg > high))[:1]:
            raise InputError(
                f"{self.name}: robot {plane.positioner_id[row]}, rotor {axis + 1}: {angles_deg[row, axis]:g} "
                f"deg; its stops are at {low[row, axis]:g} and {high[row, axis]:g} deg"
            )
        return self.of_angles(angles_deg)
