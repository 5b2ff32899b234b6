"""Cobras of the twin: motors, arms, dots, and which arms touch. Moves begin now and take their time."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fiberloom.drive.piezo import MotorMaps
from fiberloom.drive.piezo.cobras import stops_deg
from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane
from fiberloom.instruments.arms import pairs_within
from fiberloom.instruments.model import METROLOGY
from fiberloom.instruments.pointing import Pointing
from fiberloom.twin.actuators import PiezoErrors, PiezoMotors
from fiberloom.twin.cobras.contacts import ArmBodies, touching
from fiberloom.twin.faults.faults import Fault
from fiberloom.twin.faults.kinds import FaultKind
from fiberloom.typing import Flags, Floats, Ints
from fiberloom.units import rad_to_deg

DOT_MM = (0.0, 2.3, 0.75)
"""[M] Dots are 2.1 to 2.5 mm above the centres in y; radius 0.75 mm."""
DOT_SD_MM = 0.1
MOMENTS = 320
"""At most; a move's way is straight in angles in between, also where a motor begins or ends."""
STEPS_A_MOMENT = 20


@dataclass(frozen=True, eq=False)
class CobraMove:
    """What n cobras are told: theta and phi."""

    steps: Ints
    """(n, 2) signed."""
    pulse_us: Floats
    """(n, 2)."""
    sleeps: Ints
    """(n, 2) steps that a motor waits before its own."""
    step_s: Floats
    """(n,) duration of a step on the board of each."""

    @property
    def duration_s(self) -> float:
        """Until the last motor has ended."""
        ends = (np.abs(self.steps) + self.sleeps).max(axis=1, initial=0) * self.step_s
        return float(ends.max(initial=0.0))


@dataclass(frozen=True)
class Contact:
    """Two arms touched in a move; `other` None: a fiducial."""

    time_s: float
    """When the move began."""
    positioner_id: int
    other: int | None


class CobraArray:
    """The cobras of a focal plane as they really are.

    `plane`: true arms, stops and fiducials; `maps`: of the motors, 2 n, without their errors;
    `errors` of the motors; `seed`; `start_deg` (n, 2): angles from the stops, at them by default: home.
    """

    def __init__(
        self,
        plane: FocalPlane,
        maps: MotorMaps,
        errors: PiezoErrors | None = None,
        seed: int = 0,
        start_deg: Floats | None = None,
    ) -> None:
        n = len(plane)
        if maps.motors != 2 * n:
            raise InputError(f"cobras: motor maps of {maps.motors} motors for {n} cobras; each has two")
        low, high = stops_deg(plane)
        start = np.zeros((n, 2)) if start_deg is None else np.asarray(start_deg, dtype=np.float64)
        used = PiezoErrors() if errors is None else errors
        self.motors = PiezoMotors(maps, (high - low).ravel(), start.ravel(), used, seed)
        self.plane, self.pointing, self.unlit = plane, Pointing(), np.zeros(n, dtype=bool)
        self.dots_mm = drawn_dots(plane.centres_mm, seed) if plane.dots_mm is None else plane.dots_mm
        self.touched: list[Contact] = []
        self.clock: Callable[[], float] = lambda: 0.0
        self._low = low
        self._bodies, self._pairs = _bodies_of(plane), _pairs_of(plane)
        self._moments_s, self._way_deg = np.zeros(1), start[None]

    @property
    def time_s(self) -> float:
        """Now."""
        return self.clock()

    @property
    def stuck(self) -> Flags:
        """(n,) cobras whose motors do not move."""
        return self.motors.stuck[0::2]

    @property
    def angle_deg(self) -> Floats:
        """(n, 2) angles from the stops, now."""
        return self.angle_at_deg(self.time_s)

    def angle_at_deg(self, time_s: float) -> Floats:
        """(n, 2) angles from the stops in deg, at a moment of the last move, in s."""
        k = int(np.searchsorted(self._moments_s, time_s, side="right"))
        if k in (0, len(self._moments_s)):
            end: Floats = self._way_deg[min(k, len(self._way_deg) - 1)]
            return end
        before, after = self._moments_s[k - 1], self._moments_s[k]
        share = (time_s - before) / (after - before)
        here: Floats = (1.0 - share) * self._way_deg[k - 1] + share * self._way_deg[k]
        return here

    def start(self, move: CobraMove) -> float:
        """Motors start; returns how long it takes in s. What touches on the way is noted."""
        begins_s, was_deg = self.time_s, self.angle_deg
        self.motors.angle_deg = was_deg.ravel().copy()
        course = self.motors.run(move.steps.ravel(), move.pulse_us.ravel())
        after_s = np.linspace(0.0, move.duration_s, _moments(move))
        step_s = np.repeat(move.step_s, 2)
        steps, sleeps = np.abs(move.steps).ravel(), move.sleeps.ravel()
        shares = [np.clip((t / step_s - sleeps) / np.maximum(steps, 1), 0.0, 1.0) for t in after_s]
        way = np.array([course.at_deg(share) for share in shares]).reshape(len(after_s), -1, 2)
        way[-1] = self.motors.angle_deg.reshape(-1, 2)
        self._moments_s, self._way_deg = begins_s + after_s, way
        self._note_contacts(begins_s)
        return move.duration_s

    def halt(self, rows: Flags) -> None:
        """Those (n,) stay where they are now: their power is off. The others go on, and may run into them."""
        now, here = self.time_s, self.angle_deg
        k = int(np.searchsorted(self._moments_s, now, side="right"))
        self._moments_s = np.insert(self._moments_s, k, now)
        self._way_deg = np.insert(self._way_deg, k, here, axis=0)
        self._way_deg[k:, rows] = here[rows]
        self.motors.angle_deg = self._way_deg[-1].ravel().copy()
        begins_s = float(self._moments_s[0])
        # what is not reached any more was no contact
        self.touched[:] = [one for one in self.touched if one.time_s < begins_s]
        self._note_contacts(begins_s)

    def _note_contacts(self, begins_s: float) -> None:
        hit = touching(self._bodies, self._pairs, self._with_fixed(self._way_deg))
        ids, n = self.plane.positioner_id, len(self.plane)
        for i, j in self._pairs[hit].tolist():
            self.touched.append(Contact(begins_s, int(ids[i]), int(ids[j]) if j < n else None))

    def contacts(self) -> int:
        """How often arms have touched so far."""
        return len(self.touched)

    def _with_fixed(self, way_deg: Floats) -> Floats:
        fixed = len(self._bodies.radius_mm) - len(self.plane)
        return np.concatenate([way_deg, np.zeros((len(way_deg), fixed, 2))], axis=1)

    # what cameras and reports ask of a twin

    def truth(self) -> Floats:
        """(n, 2) true alpha and beta in deg."""
        return self.angle_deg + self._low

    def fibre_xy(self, fibre: str = METROLOGY) -> Floats:
        """(n, 2) true places of a fibre in mm."""
        alpha_deg, beta_deg = self.truth().T
        return self.plane.forward(alpha_deg, beta_deg, fibre)

    def fibre_xy_at(self, fibre: str, pointing: Pointing) -> Floats:
        """The same (n, 2) mm: cobras do not bend as the telescope points."""
        return self.fibre_xy(fibre)

    def point(self, pointing: Pointing) -> None:
        """Points the telescope."""
        self.pointing = pointing

    @property
    def hidden(self) -> Flags:
        """(n,) fibres that are behind their dot now."""
        gap = np.hypot(*(self.fibre_xy() - self.dots_mm[:, :2]).T)
        behind: Flags = gap < self.dots_mm[:, 2]
        return behind

    @property
    def dark(self) -> Flags:
        """(n,) fibres that no camera sees: without light, or behind a dot."""
        return self.unlit | self.hidden

    def inject(self, fault: Fault) -> None:
        """Breaks something: `dark` a fibre, `dead` or `blocked` the motors."""
        self._set(fault, True)

    def clear(self, fault: Fault) -> None:
        """Repairs it."""
        self._set(fault, False)

    def _set(self, fault: Fault, on: bool) -> None:
        row, kind = int(self.plane.index_of(fault.positioner_id)), FaultKind(fault.kind)
        if kind is FaultKind.DARK:
            self.unlit[row] = on
        elif kind in (FaultKind.DEAD, FaultKind.BLOCKED, FaultKind.LYING, FaultKind.DEAF):
            self.motors.stuck[2 * row : 2 * row + 2] = on
        else:
            raise InputError(f"fault {kind} of a cobra: known are dark, dead, blocked, lying, deaf")


def _moments(move: CobraMove) -> int:
    steps = int((np.abs(move.steps) + move.sleeps).max(initial=0))
    return int(np.clip(steps // STEPS_A_MOMENT, 8, MOMENTS))


def drawn_dots(centres_mm: Floats, seed: int) -> Floats:
    """Dots (n, 3) x, y, radius in mm above centres (n, 2), as the published ones are distributed."""
    rng = np.random.default_rng([seed, 0xD075])
    at = centres_mm + np.array(DOT_MM[:2]) + DOT_SD_MM * rng.standard_normal(centres_mm.shape)
    return np.column_stack([at, np.full(len(at), DOT_MM[2])])


def _bodies_of(plane: FocalPlane) -> ArmBodies:
    """Cobras, then fiducials."""
    fixed = plane.fiducials
    links = np.column_stack([plane.l_alpha_mm, plane.l_beta_mm])
    zero = rad_to_deg(np.column_stack([plane.alpha_off_rad, plane.beta_off_rad + plane.metrology_phi_rad]))
    return ArmBodies(
        np.vstack([plane.centres_mm, fixed[:, :2]]),
        np.vstack([links, np.zeros((len(fixed), 2))]),
        np.vstack([zero + stops_deg(plane)[0], np.zeros((len(fixed), 2))]),
        np.concatenate([np.full(len(plane), plane.collision_buffer_mm), fixed[:, 2]]),
    )


def _pairs_of(plane: FocalPlane) -> Ints:
    """(P, 2) rows of bodies that can meet: cobras, and cobras with fiducials."""
    reach = plane.l_alpha_mm + plane.l_beta_mm + plane.collision_buffer_mm
    gap = np.hypot(*np.moveaxis(plane.centres_mm[:, None] - plane.fiducials[None, :, :2], 2, 0))
    i, j = np.nonzero(gap < reach[:, None] + plane.fiducials[None, :, 2])
    arms = pairs_within(plane.centres_mm, reach, 0.0)
    return np.vstack([arms, np.column_stack([i, j + len(plane)])])
