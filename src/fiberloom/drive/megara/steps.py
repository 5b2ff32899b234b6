"""Signs and steps of MEGARA's rotors: alpha = -360 deg r1 / S1, beta = -180 deg - 360 deg r2 / S2.

r1 is 0 or above, r2 is 0 or below and 0 where the arm is folded. S1 = 194086.302 and S2 = 30720 steps a turn
are those of the axes of the instrument. Signs by the sample programme of guaix-ucm/megara-fmpt, 2017.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane, Instrument
from fiberloom.typing import Floats, Ints

FOLDED_DEG = np.array([0.0, -180.0])
"""Where both rotors are at their home switches: no steps."""


@dataclass(frozen=True, eq=False)
class RotorSteps:
    """Turns angles of the arms into steps of rotors 1 and 2, and back."""

    step_deg: Floats
    """(2,) of alpha and beta at the arm."""

    @classmethod
    def of(cls, instrument: Instrument) -> RotorSteps:
        """Those of an instrument; InputError where an axis has no steps."""
        step = np.array([axis.smallest_step_deg for axis in instrument.axes])
        if not (step > 0.0).all():
            raise InputError(f"{instrument.name}: alpha and beta need steps_per_turn, or step_deg")
        return cls(step)

    def of_angles(self, angles_deg: Floats) -> Ints:
        """(N, 2) steps nearest to angles (N, 2) in deg; InputError for angles that are no numbers."""
        if not np.isfinite(angles_deg).all():
            raise InputError("megara: angles must be finite numbers of deg")
        return np.rint((FOLDED_DEG - angles_deg) / self.step_deg).astype(np.int64)

    def angles_deg(self, steps: Ints) -> Floats:
        """(N, 2) angles in deg of the arms after steps (N, 2), of arms that lost none."""
        out: Floats = FOLDED_DEG - np.asarray(steps) * self.step_deg
        return out

    def of_plane(self, plane: FocalPlane, angles_deg: Floats) -> Ints:
        """As `of_angles`; InputError that names the first of a `plane` whose angles are beyond its stops."""
        low, high = np.moveaxis(plane.stops_of(), -1, 0)
        for row, axis in np.argwhere((angles_deg < low) | (angles_deg > high))[:1]:
            raise InputError(
                f"megara: robot {plane.positioner_id[row]}, rotor {axis + 1}: {angles_deg[row, axis]:g} deg; "
                f"its stops are at {low[row, axis]:g} and {high[row, axis]:g} deg"
            )
        return self.of_angles(angles_deg)
