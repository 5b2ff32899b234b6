"""Which targets a fibre surely reaches, by how well its arms are known before anything is learnt."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fiberloom.assignment.candidates import Block
from fiberloom.drive.desi.maps.learned import PLANETARY
from fiberloom.instruments import FocalPlane
from fiberloom.typing import Flags, Floats, Ints

EDGE_SIGMA = 3.0
"""[A] A target is so many sigma of centre and arms within the reach."""


@dataclass(frozen=True, eq=False)
class SureReach:
    """Targets at the very edge of the reach may be beyond it: no correction brings a stretched arm farther.

    Implements `fiberloom.assignment.candidates.WayRule`.
    """

    plane: FocalPlane
    margin_mm: float

    @classmethod
    def of(cls, plane: FocalPlane) -> SureReach:
        """For the `plane` of a layout, whose arms are known as `PLANETARY` says."""
        sigma_mm = np.sqrt(PLANETARY.centre_mm**2 + 2.0 * PLANETARY.length_mm**2)
        return cls(plane, EDGE_SIGMA * float(sigma_mm))

    def blocks(self, positioner: Ints, goal_deg: Floats) -> Ints:
        """(C,) `Block.EDGE` for goals (C, 2) in deg of `positioner` (C,) nearer than the margin to an end
        of its reach."""
        l_alpha, l_beta = self.plane.l_alpha_mm[positioner], self.plane.l_beta_mm[positioner]
        turn = np.deg2rad(goal_deg[:, 1]) + self.plane.beta_off_rad[positioner]
        at_mm = np.sqrt(l_alpha**2 + l_beta**2 + 2.0 * l_alpha * l_beta * np.cos(turn))
        near = (l_alpha + l_beta - at_mm < self.margin_mm) | (
            at_mm - np.abs(l_alpha - l_beta) < self.margin_mm
        )
        return np.where(near, Block.EDGE, Block.NONE)

    def crossing(self, positioner: Ints, goal_deg: Floats, first: Ints, second: Ints) -> Flags:
        """(p,) none: ways of such pairs, rows `first` and `second` (p,) of the goals, do not matter.

        `positioner` (C,) and `goal_deg` (C, 2): as of `blocks`.
        """
        return np.zeros(len(first), dtype=bool)
