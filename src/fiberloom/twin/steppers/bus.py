"""What the buses of the three arrays of steppers have in common: time, plugs, power, faults."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from fiberloom.twin.faults.faults import Fault
from fiberloom.twin.faults.kinds import AilmentKind, FaultKind, Reach, ServiceKind, WiringKind
from fiberloom.twin.steppers.array import StepperArray
from fiberloom.typing import Ints

FAULTS = Reach(
    ("busoff", "dark", "dead", "deaf", "lost", "lying", "slipping", "swapped"),
    timed=True,
)
"""Of --faults. A stepper that is dead counts as one that turns; `slipping` loses steps; `busoff` takes bus
and power from all units of a gateway."""


class StepperBus:
    """Time, and which unit hangs at which address. Subclasses have the frames."""

    def __init__(self, array: StepperArray) -> None:
        self.array, self.time_s = array, 0.0
        array.clock = lambda: self.time_s
        ids = array.plane.positioner_id
        self.row_of = {int(number): row for row, number in enumerate(ids)}
        """Row of the unit that is plugged in at each address."""
        self.unheard = set(ids[array.plane.offline].tolist())
        """Addresses that hear and say nothing."""
        self.homed = np.zeros((len(ids), 2), dtype=bool)
        self.busy_until_s = np.zeros((len(ids), 2))
        self.search_until_s = np.zeros((len(ids), 2))
        self.slip = np.zeros((len(ids), 2), dtype=np.int64)

    def moving(self, row: int, axis: int) -> bool:
        """Whether a rotor still turns."""
        return bool(self.busy_until_s[row, axis] > self.time_s + 1e-9)

    @property
    def next_s(self) -> float:
        """When something happens by itself; infinity: never."""
        return np.inf

    def advance(self, duration_s: float) -> None:
        """Lets time pass, s."""
        self.time_s += duration_s

    def search(self, rows: Ints, axis: int, rate_Hz: float) -> Ints:
        """Units `rows` (m,) search a switch at `rate_Hz`; the rows that will not find it."""
        took_s, found, slip = self.array.seek(rows, axis, rate_Hz)
        self.busy_until_s[rows, axis] = self.search_until_s[rows, axis] = self.time_s + took_s
        self.homed[rows, axis] = found
        self.slip[rows, axis] = slip
        return rows[~found]

    def halt(self, addresses: list[int]) -> None:
        """Rotors of these stop; a search that is cut short has found nothing."""
        every = np.array([self.row_of[a] for a in addresses if a in self.row_of], dtype=np.int64)
        rows = every[(self.busy_until_s[every] > self.time_s).any(axis=1)]
        if not len(rows):
            return
        self.array.halt(rows)
        self.homed[rows] &= self.search_until_s[rows] <= self.time_s
        self.busy_until_s[rows] = self.search_until_s[rows] = np.minimum(self.busy_until_s[rows], self.time_s)

    # what goes wrong

    def inject(self, fault: Fault) -> None:
        """From now on a unit is dark, dead, weak, unheard, or plugged in at its neighbour's place."""
        self._set(fault, True)

    def clear(self, fault: Fault) -> None:
        """Ends what `inject` has begun."""
        self._set(fault, False)

    def _set(self, fault: Fault, on: bool) -> None:
        number = fault.positioner_id
        match fault.kind:
            case ServiceKind.BUS_OFF | FaultKind.DEAF:
                if on and fault.kind == ServiceKind.BUS_OFF:
                    self.halt([number])
                    self.homed[self.row_of[number]] = False
                (self.unheard.add if on else self.unheard.discard)(number)
            case WiringKind.SWAPPED:
                self._exchange(number)
            case FaultKind.DARK | AilmentKind.SLIPPING | _:
                self.array.inject(fault) if on else self.array.clear(fault)

    def _exchange(self, number: int) -> None:
        """The plugs of a unit and of its nearest neighbour."""
        plane = self.array.plane
        row = int(plane.index_of(number))
        _, near = cKDTree(plane.centres_mm).query(plane.centres_mm[row], k=2)
        other = int(plane.positioner_id[next(k for k in near if k != row)])
        self.row_of[number], self.row_of[other] = self.row_of[other], self.row_of[number]
