"""Arms as a bench has found them, beside those of the layout by which targets become angles.

Assignment and planning go by the layout. A unit whose arms are a little longer needs other angles for the
same place: by the inverse of the Jacobian, which is damped where an arm is folded or stretched and no angle
moves the fibre inwards or outwards.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fiberloom.instruments import FocalPlane
from fiberloom.instruments.arms import CENTRE, L_ALPHA
from fiberloom.typing import Floats

DAMPED_MM_DEG = 0.003
"""[A] A fibre that one deg moves by less does not tell an angle."""
MOST_MM = 0.5
"""[A] Arms that are farther off are not believed: such a unit did not turn on circles."""


@dataclass(frozen=True, eq=False)
class FoundArms:
    """N units by their layout, and as they were found."""

    layout: FocalPlane
    found: FocalPlane

    @classmethod
    def of(cls, layout: FocalPlane, circles_mm: Floats) -> FoundArms:
        """By `circles_mm` (N, 4): centre x and y, alpha arm, distance of the fibre from the beta axis.

        One of which these are not finite, or off by more than `MOST_MM`, is as in the `layout`.
        """
        was = np.column_stack([layout.arms[:, : L_ALPHA + 1], layout.l_beta_mm])
        sound = (np.abs(circles_mm - was) < MOST_MM).all(axis=1, keepdims=True)
        now, arms = np.where(sound, circles_mm, was), layout.arms.copy()
        arms[:, CENTRE], arms[:, L_ALPHA] = now[:, CENTRE], now[:, L_ALPHA]
        longer = (now[:, 3] / was[:, 3])[:, None]
        points = {name: longer * at_mm for name, at_mm in layout.points.items()}
        return cls(layout, replace(layout, arms=arms, points=points))

    def of_unit(self, row: int) -> FoundArms:
        """Of one unit, for any number of places of it."""
        return FoundArms(self.layout.select([row]), self.found.select([row]))

    def layout_deg(self, angles_deg: Floats) -> Floats:
        """(n, 2) angles of the layout's arms where the fibres are that found ones have at `angles_deg`."""
        return angles_deg + self._term_deg(angles_deg)

    def arms_deg(self, layout_deg: Floats) -> Floats:
        """(n, 2) deg of the found arms that bring fibres to where the layout's have `layout_deg` (n, 2)."""
        once = layout_deg - self._term_deg(layout_deg)
        return np.asarray(layout_deg - self._term_deg(once))

    def _term_deg(self, angles_deg: Floats) -> Floats:
        rows = np.minimum(np.arange(len(angles_deg)), len(self.layout) - 1)
        alpha, beta = angles_deg.T
        off = self.found.forward(alpha, beta, index=rows) - self.layout.forward(alpha, beta, index=rows)
        jacobian = self.layout.jacobian(alpha, beta, index=rows)
        across = jacobian @ jacobian.transpose(0, 2, 1) + DAMPED_MM_DEG**2 * np.eye(2)
        told = np.linalg.solve(across, off[..., None])
        term: Floats = (jacobian.transpose(0, 2, 1) @ told)[..., 0]
        return term
