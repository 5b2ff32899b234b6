"""Years of operation on the statistical twin: told targets in, true and measured places out, labelled.

    years = Years(plane, units, seed=1, ailments=draw_ailments(units, seed=1))
    for night in ...:
        visit = years.visit(maps.to_wire(goal_deg))
        visit.measured_mm, visit.done, visit.label   # what is seen, what is claimed, what is true

One call is one move of every unit. Wear and ailments go on with the
moves. A unit's years depend on the seed and its own commands alone, so they may be cut into chunks of a
campaign anywhere.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from fiberloom.instruments import METROLOGY, FocalPlane
from fiberloom.studies.lifetime import MOVES_PER_CYCLE
from fiberloom.twin.faults.ailments import AilmentModel, Ailments, draw_ailments, excess_torque_Nm, loosened
from fiberloom.twin.noise import UnitNoise
from fiberloom.twin.statistical import StatisticalTwin
from fiberloom.twin.units import Units
from fiberloom.twin.wear import Wear, WearModel
from fiberloom.typing import Flags, Floats
from fiberloom.units import MM_PER_UM


@dataclass(frozen=True)
class Visit:
    """One move of N positioners."""

    move: int
    """Its number, from 0."""
    done: Flags
    """(N,) the positioner reports arrival; otherwise a collision."""
    reported_wire_deg: Floats
    """(N, 2) where it says it is."""
    measured_mm: Floats
    """(N, 2) where the camera sees the metrology fibre; NaN for a dark one."""
    torque_Nm: Floats
    """(N, 2) mean torque of the servo beyond the model that it was told, at the motor."""
    true_deg: Floats
    """(N, 2) output angles."""
    true_mm: Floats
    """(N, 2) where the metrology fibre is."""
    label: NDArray[np.str_]
    """(N,) the ailment that acts; "" for a healthy unit."""


class Years:
    """N positioners that move, wear and fall ill."""

    def __init__(
        self,
        plane: FocalPlane,
        units: Units,
        seed: int,
        *,
        wear: WearModel | None = None,
        ailments: Ailments | AilmentModel | None = None,
        start_deg: ArrayLike | None = None,
    ) -> None:
        """New units. `ailments`: as drawn, or the model to draw them from."""
        self.ailments = ailments if isinstance(ailments, Ailments) else draw_ailments(units, seed, ailments)
        self.twin = StatisticalTwin(plane, units, seed=seed, start_deg=start_deg)
        self._wear = Wear(units, seed, wear)
        self._worn = units
        self.refresh_moves = 500
        """How often wear is brought up to date; a tenth of a mark's change in a year is 15 nm of arm by
        then."""
        self._camera = UnitNoise(seed, 0xCA3F, units.number)
        self._chance = UnitNoise(seed, 0xC4A2, units.number)
        self._sigma_mm = plane.instrument.metrology.noise_rms_um * MM_PER_UM / np.sqrt(2.0)
        self._where_deg = np.zeros((len(units), 2))
        self.move = 0

    def visit(self, wire_deg: ArrayLike, precise: bool = True) -> Visit:
        """All go to (N, 2) wire positions; NaN stays where it is."""
        self._age()
        wire = np.asarray(wire_deg, dtype=np.float64)
        happens = self._chance.uniform(2) >= self._non_moves
        stalls: Flags = np.any(self._stalled, axis=1)  # a collision of one axis stops both
        told = np.where(happens & ~stalls[:, None], wire, np.nan)
        true_deg = self.twin.move(told, precise)
        true_mm = self._with_play(self.twin.fibre_xy(METROLOGY), true_deg)
        measured = true_mm + self._sigma_mm * self._camera.normal(2)
        arrives = np.isfinite(wire) & ~stalls[:, None]
        self._where_deg = np.where(arrives, wire, self._where_deg)
        visit = Visit(
            move=self.move,
            done=~(stalls & np.any(np.isfinite(wire), axis=1)),
            reported_wire_deg=self._where_deg.copy(),
            measured_mm=np.where(self._dark[:, None], np.nan, measured),
            torque_Nm=self._torque_Nm,
            true_deg=true_deg,
            true_mm=true_mm,
            label=self.ailments.label(self.move),
        )
        self.move += 1
        return visit

    def _age(self) -> None:
        """Wear every so often, for all; what an ailment does, from its first move on."""
        if self.move % self.refresh_moves == 0:
            self._worn = self._wear.at(self.move / MOVES_PER_CYCLE)
            self._settle(np.arange(len(self.twin.plane)))
        elif len(fallen := np.flatnonzero(self.ailments.table["onset"] == self.move)):
            self._settle(fallen)

    def _settle(self, rows: NDArray[np.intp]) -> None:
        ill, move = self.ailments.units_at(self._worn, self.move), self.move
        self.twin.set_units(ill, rows)
        self.twin.follows = self.ailments.follows_at(move)
        self._stalled = self.ailments.stalled_at(ill, move)
        self._non_moves = self.ailments.non_moves_at(move)
        self._dark = self.ailments.dark_at(move)
        self._torque_Nm = excess_torque_Nm(ill)

    def _with_play(self, xy_mm: Floats, theta_deg: Floats) -> Floats:
        """A loose arm is somewhat longer or shorter after every move."""
        longer = self.ailments.loose_mm_at(self.move)[:, None] * self._chance.normal(1)
        return loosened(self.twin.units, xy_mm[..., None], theta_deg[..., None], longer)[..., 0]
