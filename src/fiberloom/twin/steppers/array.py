"""Steppers of the twin: rotors that follow counts, arms, datum switches, and which arms touch."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fiberloom._core.geometry import segment_distance
from fiberloom.drive.moons.maker import limits_deg
from fiberloom.instruments import FocalPlane
from fiberloom.instruments.arms import ALPHA_OFF, BETA_OFF, L_ALPHA, pairs_within
from fiberloom.twin.actuators.rigid import RigidArms
from fiberloom.twin.cobras.contacts import ArmBodies, touching
from fiberloom.twin.faults.faults import Fault
from fiberloom.twin.faults.kinds import AilmentKind, FaultKind
from fiberloom.twin.steppers.interlocks import Interlocks, InterlockStop
from fiberloom.twin.steppers.units import StepperUnits, draw_stepper_units
from fiberloom.twin.twin import Touch
from fiberloom.typing import Flags, Floats, Ints
from fiberloom.units import rad_to_deg

MOST_CORNERS, MOMENTS = 260, 120
"""A motion with more corners is kept at so many moments: a group in which each ends at its own time."""
MET_MM = 0.1
"""Arms that are freed from what they have met are no farther from it; play is crossed at once."""
LOSES_SHARE = (0.02, 0.2)
"""[A] Of a way, that a weak motor loses: drawn for each move."""


@dataclass(frozen=True, eq=False)
class CountPath:
    """Counts of m units at C corners of their own, straight in between."""

    rows: Ints
    """(m,)."""
    time_s: Floats
    """(C, m) from the start, never falling."""
    counts: Floats
    """(C, m, 2)."""


@dataclass(frozen=True, eq=False)
class _Running:
    """A motion of all N: rotors at K moments."""

    time_s: Floats
    """(K,) of the twin."""
    rotor: Floats
    """(K, N, 2) counts that rotors are in step with."""
    rising: Floats
    """(K, N, 2)."""


class StepperArray(RigidArms):
    """The steppers of a focal plane as they really are.

    Arms pass through each other, unless interlocks stop them; either is counted.

    `plane`: the layout; `units`: the true ones, drawn by the `seed` when left out; `contacts`: whether arms
    can meet, False on a bench.
    """

    def __init__(
        self, plane: FocalPlane, units: StepperUnits | None = None, *, seed: int = 0, contacts: bool = True
    ) -> None:
        self.plane, n = plane, len(plane)
        self.units = draw_stepper_units(plane, seed) if units is None else units
        super().__init__(plane, self.units)
        self.dark = np.zeros(n, dtype=bool)
        self.dead, self.weak = plane.offline.copy(), np.zeros(n, dtype=bool)
        self.clock: Callable[[], float] = lambda: 0.0
        self.counts = np.zeros((n, 2), dtype=np.int64)
        """(N, 2) as the controllers have them."""
        self._rng = np.random.default_rng([seed, 0x57EA])
        self._datum_deg = self._drawn_datum_deg()
        falling = np.full((1, n, 2), -self.units.steps.sign)
        self._path = _Running(np.zeros(1), np.zeros((1, n, 2)), falling)
        self._bodies = _bodies_of(plane, self.units)
        self._pairs = _pairs_of(plane) if contacts else np.zeros((0, 2), dtype=np.int64)
        self.interlocks: Interlocks | None = None
        """What stops units on their way; None: nothing does."""
        self._stops: list[InterlockStop] = []
        self._watching: Interlocks | None = None
        self._held = np.zeros(n, dtype=bool)
        self._freeing, self._handed = False, set[Touch]()

    # motion

    @property
    def time_s(self) -> float:
        """Now."""
        return self.clock()

    def interlocked(self) -> None:
        """From now on an arm that touches another, or leaves its range, stops there."""
        self.interlocks = Interlocks(self._bodies, self._pairs, limits_deg(self.plane.instrument))

    def stops(self) -> list[InterlockStop]:
        """Stops by interlocks since the last call."""
        found, self._stops = self._stops, []
        return found

    def go(self, path: CountPath, *, freeing: bool = False) -> float:
        """Motors follow counts from now on; how long it takes, s. What touches on the way is noted.

        `freeing`: out of what an interlock has stopped at; nothing stops it, what it has met is noted.
        """
        time_s, rotor = self._others(np.unique(path.time_s), path.rows)
        rotor[:, path.rows] += _gone(path, time_s) * self._kept(path.rows)
        self.counts[path.rows] = np.rint(path.counts[-1]).astype(np.int64)
        self._run(time_s, rotor, None if freeing else self.interlocks)
        self._freeing = freeing
        self._note_contacts()
        return float(path.time_s[-1].max())

    def seek(self, rows: Ints, axis: int, rate_Hz: float) -> tuple[Floats, Flags, Ints]:
        """Units `rows` (m,) search the datum switch of an axis, 0 alpha or 1 beta.

        `rate_Hz`: steps a second.

        Returns (m,) s from now when each has ended; which have found it; and their slip, the counts there.
        """
        start = self._rotor_now()
        self._datum_deg[rows, axis] = self._drawn_datum_deg()[rows, axis]
        found = ~(self.dead[rows] & (np.abs(start[rows, axis]) > self.units.turn_steps))
        way = np.where(self.dead[rows], 0.0, -start[rows, axis])
        slip = np.rint(self.counts[rows, axis] + way).astype(np.int64)
        took_s = np.abs(way) / rate_Hz
        self.counts[rows[found], axis] = 0
        end_s = max(float(took_s.max(initial=0.0)), 1e-3)
        time_s, rotor = self._others(np.unique(np.append(took_s, [0.0, end_s])), rows)
        gone = np.clip(time_s[:, None] / np.maximum(took_s, 1e-9), 0.0, 1.0)
        rotor[:, rows, axis] += gone * way
        self._run(time_s, rotor)
        self._note_contacts()
        return took_s, found, slip

    def halt(self, rows: Ints) -> None:
        """Motors of these stand still now; their controllers count what was gone.

        The others go on, and may run into them.
        """
        if self.time_s >= self._path.time_s[-1]:
            return
        self._hold(rows, self.time_s)
        self._held[rows] = True
        if self._watching is not None:
            self._stop_where_met(self._watching)
        self._note_contacts()

    def _others(self, corners_s: Floats, rows: Ints) -> tuple[Floats, Floats]:
        """Moments (K,) in s from now of a motion with these corners, and rotors (K, N, 2) of all then.

        Those `rows` that begin it stand where they are; the others go on as they do.
        """
        old, now = self._path, self.time_s
        later_s = old.time_s[old.time_s > now] - now
        time_s = _moments_s(np.unique(np.concatenate([corners_s, later_s])))
        start = self._rotor_now()
        rotor = np.broadcast_to(start, (len(time_s), *start.shape)).copy()
        if len(later_s):
            going = np.setdiff1d(np.arange(len(self.plane)), rows)
            at = np.clip(np.searchsorted(old.time_s, now + time_s, side="right"), 1, len(old.time_s) - 1)
            span = old.time_s[at] - old.time_s[at - 1]
            share = np.clip((now + time_s - old.time_s[at - 1]) / np.maximum(span, 1e-12), 0.0, 1.0)
            before, after = old.rotor[at - 1][:, going], old.rotor[at][:, going]
            rotor[:, going] = before + share[:, None, None] * (after - before)
        return time_s, rotor

    def _run(self, after_s: Floats, rotor: Floats, interlocks: Interlocks | None = None) -> None:
        rising = _rising(rotor, self._rising_now(), self.units.steps.sign)
        self._path = _Running(self.time_s + after_s, rotor, rising)
        self._watching, self._held, self._freeing = interlocks, np.zeros(len(self.plane), dtype=bool), False
        if interlocks is not None:
            self._stop_where_met(interlocks)

    def _stop_where_met(self, interlocks: Interlocks) -> None:
        """Stops units on the path one after the other; each stop changes what comes after it."""
        held = self._held
        while True:
            counted = self.units.steps.angles_deg(self._path.rotor)
            stop = interlocks.first(self._path.time_s, self._way_deg(), counted, held)
            if stop is None:
                return
            self._stops.append(stop)
            rows = np.array(stop.rows)
            self._hold(rows[~held[rows]], stop.time_s)
            held[rows] = True

    def obstructed(self, row: int) -> bool:
        """Whether a unit touches something where it stands, or is beyond a limit."""
        if self.interlocks is None:
            return False
        at = np.vstack([self.truth(), np.zeros((len(self._bodies.radius_mm) - len(self.plane), 2))])
        counted = self.units.steps.angles_deg(self._rotor_now()[row])
        return self.interlocks.meets(row, at) or self.interlocks.beyond(counted)

    def _hold(self, rows: Ints, time_s: float) -> None:
        """Rotors `rows` stand from a moment of the path on; their controllers have counted what was gone."""
        path = self._path
        k = int(np.clip(np.searchsorted(path.time_s, time_s, side="right"), 1, len(path.time_s) - 1))
        before_s, after_s = path.time_s[k - 1 : k + 1]
        share = (time_s - before_s) / max(after_s - before_s, 1e-12)  # two stops at one moment
        here = path.rotor[k - 1] + share * (path.rotor[k] - path.rotor[k - 1])
        rotor = np.insert(path.rotor, k, here, axis=0)
        self.counts[rows] -= np.rint(rotor[-1, rows] - here[rows]).astype(np.int64)
        rotor[k:, rows] = here[rows]
        rising = np.insert(path.rising, k, path.rising[k], axis=0)
        rising[k:, rows] = rising[k, rows]
        self._path = _Running(np.insert(path.time_s, k, time_s), rotor, rising)

    def _kept(self, rows: Ints) -> Floats:
        """(m, 2) share of a way that rotors go: the rest a weak motor loses, in whole electrical turns."""
        lost = self._rng.uniform(*LOSES_SHARE, (len(rows), 2))
        kept = np.where(self.weak[rows, None], 1.0 - lost, 1.0)
        return np.where(self.dead[rows, None], 0.0, kept)

    def _drawn_datum_deg(self) -> Floats:
        """(N, 2) where switches close in a search, about home."""
        return np.column_stack([switch.closes_deg(self._rng) for switch in self.units.switches])

    def _index(self) -> tuple[int, float]:
        k = int(np.searchsorted(self._path.time_s, self.time_s, side="right"))
        if k == len(self._path.time_s) or k == 0:
            return min(k, len(self._path.time_s) - 1), 1.0
        before, after = self._path.time_s[k - 1], self._path.time_s[k]
        return k, (self.time_s - before) / (after - before)

    def _rotor_now(self) -> Floats:
        k, share = self._index()
        before = self._path.rotor[max(k - 1, 0)]
        now: Floats = before + share * (self._path.rotor[k] - before)
        return now

    def _rising_now(self) -> Floats:
        return np.asarray(self._path.rising[self._index()[0]])

    def _note_contacts(self) -> None:
        if not len(self._pairs):
            return
        way_deg, begin_s = self._way_deg(), float(self._path.time_s[0])
        hit = touching(self._bodies, self._pairs, way_deg)
        if self._freeing:
            hit &= self._bodies.apart_mm(self._pairs, way_deg[0]) > MET_MM
        ids, n = self.plane.positioner_id, len(self.plane)
        # of a motion, and of those that start at one moment, what is known last tells
        self._touches = [one for one in self._touches if one.time_s < begin_s]
        found = [Touch(begin_s, int(ids[i]), int(ids[j]) if j < n else None) for i, j in self._pairs[hit]]
        self._touches += [one for one in found if one not in self._handed]

    def touches(self) -> list[Touch]:
        """Contacts since the last call: the first moment of each pair in each move."""
        found = super().touches()
        begin_s = self._path.time_s[0]
        self._handed = {one for one in [*self._handed, *found] if one.time_s >= begin_s}
        return found

    def _way_deg(self) -> Floats:
        """(K, n, 2) true angles of arms along the path; fixed bodies have 0."""
        way_deg = self.units.output_deg(self._path.rotor, self._path.rising, self._datum_deg, at_rest=False)
        fixed = len(self._bodies.radius_mm) - len(self.plane)
        return np.concatenate([way_deg, np.zeros((len(way_deg), fixed, 2))], axis=1)

    # what cameras and reports ask of a twin

    def truth(self) -> Floats:
        """(N, 2) true alpha and beta in deg."""
        return self.units.output_deg(self._rotor_now(), self._rising_now(), self._datum_deg)

    # what goes wrong

    def inject(self, fault: Fault) -> None:
        """Breaks something: `dark` a fibre; `slipping` makes a motor lose steps; the others stop it."""
        self._set(fault, True)

    def clear(self, fault: Fault) -> None:
        """Repairs it."""
        self._set(fault, False)

    def _set(self, fault: Fault, on: bool) -> None:
        row = int(self.plane.index_of(fault.positioner_id))
        match fault.kind:
            case FaultKind.DARK:
                self.dark[row] = on
            case AilmentKind.SLIPPING:
                self.weak[row] = on
            case _:
                self.dead[row] = on


def _gone(path: CountPath, time_s: Floats) -> Floats:
    """(K, m, 2) counts gone at moments (K,)."""
    out = np.zeros((len(time_s), *path.counts.shape[1:]))
    for k in range(len(path.time_s) - 1):
        before, after = path.time_s[k], path.time_s[k + 1]
        share = np.clip((time_s[:, None] - before) / np.maximum(after - before, 1e-9), 0.0, 1.0)
        out += share[..., None] * (path.counts[k + 1] - path.counts[k])
    return out


def _moments_s(corners_s: Floats) -> Floats:
    """Moments at which rotors are kept: the corners, or so many that what lies between them is short."""
    if len(corners_s) <= MOST_CORNERS:
        return corners_s
    return np.linspace(corners_s[0], corners_s[-1], MOMENTS)


def _rising(rotor: Floats, before: Floats, sign: float) -> Floats:
    """(K, N, 2) 1 or -1: how each angle changed last, up to each moment."""
    out = np.empty_like(rotor)
    last = before
    for k in range(len(rotor)):
        # at the first moment what comes is known already: play is crossed at once
        change = rotor[min(k + 1, len(rotor) - 1)] - rotor[k] if k == 0 else rotor[k] - rotor[k - 1]
        last = np.where(change == 0.0, last, np.sign(sign * change))
        out[k] = last
    return out


def _bodies_of(plane: FocalPlane, units: StepperUnits) -> ArmBodies:
    """Real beta arms, then fiducials, then edges of keep-outs."""
    fixed, n, edges = plane.fiducials, len(plane), _edges_mm(plane)
    links = np.column_stack([units.arms[:, L_ALPHA], np.full(n, plane.instrument.bodies.beta_segment_mm[1])])
    zero = rad_to_deg(units.arms[:, [ALPHA_OFF, BETA_OFF]])
    length, direction = np.hypot(*(edges[:, 2:] - edges[:, :2]).T), edges[:, 2:] - edges[:, :2]
    turn = rad_to_deg(np.arctan2(direction[:, 1], direction[:, 0]))
    nothing = np.zeros(len(edges))
    return ArmBodies(
        np.vstack([units.arms[:, :2], fixed[:, :2], edges[:, :2]]),
        np.vstack([links, np.zeros((len(fixed), 2)), np.column_stack([nothing, length])]),
        np.vstack([zero, np.zeros((len(fixed), 2)), np.column_stack([turn, nothing])]),
        np.concatenate([np.full(n, units.sizes.body_radius_mm), fixed[:, 2], nothing]),
    )


def _edges_mm(plane: FocalPlane) -> Floats:
    """(E, 4) x0, y0, x1, y1 of the edges of keep-outs, without their margins."""
    kept = [one.capsules_mm[:, :4] for one in plane.instrument.bodies.keep_outs]
    return np.vstack([np.zeros((0, 4)), *kept])


def _pairs_of(plane: FocalPlane) -> Ints:
    """(P, 2) rows of bodies that can meet: arms, and arms with fiducials and keep-outs."""
    n, reach = len(plane), plane.body_reach_mm[:, None]
    gap = np.hypot(*np.moveaxis(plane.centres_mm[:, None] - plane.fiducials[None, :, :2], 2, 0))
    i, j = np.nonzero(gap < reach + plane.fiducials[None, :, 2])
    edges = _edges_mm(plane)
    centre, lines = np.tile(plane.centres_mm, 2)[:, None], edges[None]
    apart = segment_distance(
        *(
            np.ascontiguousarray(np.broadcast_to(one, (n, len(edges), 4)).reshape(-1, 4))
            for one in (centre, lines)
        )
    )
    a, b = np.nonzero(apart.reshape(n, len(edges)) < reach)
    arms = pairs_within(plane.centres_mm, plane.body_reach_mm, 0.0)
    edges_from = n + len(plane.fiducials)
    return np.vstack([arms, np.column_stack([i, j + n]), np.column_stack([a, b + edges_from])])
