"""What arms really do while their tables run: scales, stops, play, the gear's error, scatter."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fiberloom.drive.desi.clock import FINAL_DIRECTION, GEAR, TICK_HZ, degrees_of
from fiberloom.drive.desi.paths import FieldPath
from fiberloom.twin.actuators.planetary import PlanetaryGears, played
from fiberloom.twin.desi.units import DOWN, UP, DesiUnits
from fiberloom.typing import Flags, Floats, Ints

TURN_DEG = 360.0 / GEAR
"""A motor turn at the arm: what a rotor that was held loses is a whole number of them."""


@dataclass
class ArmState:
    """Where N units stand; deg at the arm, internal angles."""

    rotor_deg: Floats
    """(N, 2) of the field that the rotor follows, as through a linear gear."""
    gear_deg: Floats
    """(N, 2) behind the play."""
    scatter_deg: Floats
    """(N, 2) of the last move."""

    @classmethod
    def at(cls, gears: PlanetaryGears, output_deg: Floats) -> ArmState:
        """Arms at `output_deg` (N, 2), the play closed as after a move."""
        gear = gears.gear_deg(output_deg[:, None])[:, 0]
        return cls(gear + 0.5 * gears.play_deg * FINAL_DIRECTION, gear, np.zeros_like(gear))

    def output_deg(self, gears: PlanetaryGears) -> Floats:
        """(N, 2) true angles in deg."""
        return gears.output_deg(self.gear_deg[:, None])[:, 0] + self.scatter_deg

    def copy(self) -> ArmState:
        """Another one with the same numbers."""
        return ArmState(self.rotor_deg.copy(), self.gear_deg.copy(), self.scatter_deg.copy())


@dataclass(frozen=True, eq=False)
class TruePath:
    """True motion of N units at any time; K corners each."""

    gears: PlanetaryGears
    time_s: Floats
    """(N, K) never falling."""
    rotor_deg: Floats
    """(N, K, 2)."""
    gear_deg: Floats
    """(N, K, 2)."""
    scatter_deg: Floats
    """(N, K, 2)."""
    travelled_deg: Floats
    """(N, K, 2) way of the gears since the start."""

    @property
    def end_s(self) -> float:
        """When the last unit has arrived, s."""
        return float(self.time_s[:, -1].max(initial=0.0))

    def state_at(self, unit: Ints, time_s: Floats) -> tuple[ArmState, Floats]:
        """State of units (M,) at times (M,) in s, and how far their gears have travelled, (M, 2) deg."""
        k, share = self._segment(unit, time_s)
        rotor = _between(self.rotor_deg, unit, k, share)
        half = 0.5 * self.gears.play_deg[unit]
        before = self.gear_deg[unit, k]
        gear = np.clip(before, rotor - half, rotor + half)
        travelled = self.travelled_deg[unit, k] + np.abs(gear - before)
        return ArmState(rotor, gear, _between(self.scatter_deg, unit, k, share)), travelled

    def _segment(self, unit: Ints, time_s: Floats) -> tuple[Ints, Floats]:
        """The corner before each time, and the share of the way to the next."""
        n, corners = self.time_s.shape
        span = self.end_s + 1.0
        flat = (self.time_s + span * np.arange(n)[:, None]).ravel()
        at = np.clip(time_s, 0.0, self.time_s[unit, -1])
        found = np.searchsorted(flat, at + span * unit, side="right") - 1 - corners * unit
        k = np.clip(found, 0, corners - 2)
        length = self.time_s[unit, k + 1] - self.time_s[unit, k]
        share = np.where(length > 0.0, (at - self.time_s[unit, k]) / np.maximum(length, 1e-12), 1.0)
        return k, np.clip(share, 0.0, 1.0)

    def output_deg(self, unit: Ints, time_s: Floats) -> tuple[Floats, Floats]:
        """True angles (M, 2) in deg of units (M,) at times (M,) in s; and ways of the gears, (M, 2) deg."""
        state, travelled = self.state_at(unit, time_s)
        return state.output_deg(self.gears_of(unit)), travelled

    def gears_of(self, unit: Ints) -> PlanetaryGears:
        """Gears of units (M,)."""
        return select(self.gears, unit)


def select(gears: PlanetaryGears, unit: Ints | Flags) -> PlanetaryGears:
    """Gears of some units, by rows or a mask."""
    return PlanetaryGears(gears.amplitude_deg[unit], gears.phase_rad[unit], gears.play_deg[unit])


def true_path(
    units: DesiUnits, state: ArmState, field: FieldPath, rng: np.random.Generator
) -> tuple[TruePath, ArmState]:
    """What N units do along their fields, and where they stand then.

    `units` and `state`: of all N, `field`: their (N, K, 2) fields; `rng` draws scatter and moves that do
    nothing.
    """
    ways = np.diff(degrees_of(field.tenths), axis=1, prepend=0.0)
    commanded = np.abs(ways).sum(axis=1) > 0.0
    ways = ways * _followed(units, ways, rng)
    rotor, after = _rotors(state.rotor_deg, ways, units.stops_deg)
    gear = played(state.gear_deg, rotor, units.gears.play_deg)
    goes = commanded & ~units.stuck[:, None]
    fresh = units.sizes.scatter_deg * rng.standard_normal(goes.shape)
    scatter = _ramped(state.scatter_deg, np.where(goes, fresh, state.scatter_deg), ways)
    travelled = np.cumsum(np.abs(np.diff(gear, axis=1, prepend=state.gear_deg[:, None])), axis=1)
    path = TruePath(units.gears, field.tick / TICK_HZ, rotor, gear, scatter, travelled)
    return path, ArmState(after, gear[:, -1], scatter[:, -1])


def _followed(units: DesiUnits, ways: Floats, rng: np.random.Generator) -> Floats:
    """(N, K, 2) share of a commanded way that a rotor goes."""
    up, down = units.scale[:, None, :, UP], units.scale[:, None, :, DOWN]
    share = np.where(ways > 0.0, up, down)
    idle = units.linear & (rng.random(units.linear.shape) < units.sizes.idle)
    held = idle | units.stuck[:, None]
    return np.where(held[:, None], 0.0, share)


def _rotors(start: Floats, ways: Floats, stops: Floats) -> tuple[Floats, Floats]:
    """(N, K, 2) rotors, held at the stops, and the fields (N, 2) that they follow at the end.

    The field of a held rotor goes on; what it goes beyond by more than half a turn are turns lost.
    """
    out, field = np.empty_like(ways), start.copy()
    low, high = stops[..., 0], stops[..., 1]
    for k in range(ways.shape[1]):
        field = field + ways[:, k]
        beyond = np.maximum(field - high, 0.0) + np.minimum(field - low, 0.0)
        field = field - TURN_DEG * np.rint(beyond / TURN_DEG)
        out[:, k] = np.clip(field, low, high)
    return out, field


def _ramped(old: Floats, new: Floats, ways: Floats) -> Floats:
    """(N, K, 2) from the old scatter to the new one, in proportion to the way gone."""
    gone = np.cumsum(np.abs(ways), axis=1)
    share = gone / np.maximum(gone[:, -1:], 1e-12)
    out: Floats = old[:, None] + (new - old)[:, None] * share
    return out


def _between(values: Floats, unit: Ints, k: Ints, share: Floats) -> Floats:
    """(M, 2) values (N, K, 2) of units between the corners k and k + 1."""
    first = values[unit, k]
    out: Floats = first + share[:, None] * (values[unit, k + 1] - first)
    return out
