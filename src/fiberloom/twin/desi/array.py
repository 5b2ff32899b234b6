"""The twin of DESI's focal plane: controllers on a bus, tables executed for all units at once."""

from __future__ import annotations

from collections.abc import Iterable
from functools import cached_property

import numpy as np
from numpy.typing import ArrayLike

from fiberloom.drive.desi.frames import ALL, POSITIONERS, DesiCommand, DesiFrame, tables_from
from fiberloom.drive.desi.paths import FieldPath, executed_path
from fiberloom.drive.desi.tables import MoveTables
from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane
from fiberloom.twin.actuators.rigid import RigidArms
from fiberloom.twin.desi.contacts import ContactFinder, Touching
from fiberloom.twin.desi.controller import DesiController
from fiberloom.twin.desi.motion import ArmState, TruePath, true_path
from fiberloom.twin.desi.units import DesiSizes, DesiUnits, draw_desi_units
from fiberloom.twin.faults.faults import Fault
from fiberloom.twin.faults.kinds import AilmentKind, FaultKind, ServiceKind
from fiberloom.twin.twin import Touch
from fiberloom.typing import Floats, Ints


class DesiTwin(RigidArms):
    """N positioners on a virtual bus; the clock does not advance between calls.

    `start_deg` (N, 2): true angles at power-up, folded by default. Arms pass through each other; with
    `contacts` it is counted that they do. Tables that are started while others run are looked at for contacts
    with those where they will end.
    """

    def __init__(
        self,
        plane: FocalPlane,
        units: DesiUnits | None = None,
        *,
        seed: int = 0,
        start_deg: ArrayLike | None = None,
        contacts: bool = True,
    ) -> None:
        self.plane = plane
        self.units = units or draw_desi_units(plane, seed)
        super().__init__(plane, self.units)
        if len(self.units) != len(plane):
            raise InputError(f"twin: {len(self.units)} units for {len(plane)} positioners; draw them anew")
        self.dark = self.units.dark.copy()
        self.deaf = set(plane.positioner_id[plane.offline].tolist())
        """Positioners that hear nothing, by number."""
        self.time_s = 0.0
        self.controllers = {int(k): DesiController(int(k)) for k in plane.positioner_id}
        self._row = {int(k): row for row, k in enumerate(plane.positioner_id)}
        self._finder = ContactFinder(plane, self.units) if contacts else None
        self._state = ArmState.at(self.units.gears, _start(plane, start_deg))
        self._running: list[tuple[float, Ints, TruePath]] = []
        self._seed, self._rng = seed, np.random.default_rng([seed, 0xDE52])

    # the bus

    def send(self, frames: Iterable[tuple[int, bytes]]) -> list[DesiFrame]:
        """Puts frames (identifier, data) on the bus now, in order; the replies. Tables may start."""
        replies: list[DesiFrame] = []
        for identifier, data in frames:
            frame = DesiFrame(identifier, bytes(data))
            addressed = self._addressed(frame)
            for controller in addressed:
                replies += controller.receive(frame)
            self._stop([c for c in addressed if c.stopped])
        self._begin()
        return replies

    def sync(self) -> None:
        """The hardware signal: tables that wait for it start now."""
        for controller in self.controllers.values():
            controller.sync()
        self._begin()

    def run(self, duration_s: float) -> list[DesiFrame]:
        """Lets time pass, s. No unit speaks unasked."""
        if not 0.0 <= duration_s < 1e6:
            raise InputError(f"twin: cannot run for {duration_s} s; give 0 to a million")
        self.time_s += duration_s
        for controller in self.controllers.values():
            controller.advance(duration_s)
        self._running = [entry for entry in self._running if entry[0] + entry[2].end_s > self.time_s]
        return []

    def _addressed(self, frame: DesiFrame) -> list[DesiController]:
        if frame.can_id in (ALL, POSITIONERS):
            return [c for number, c in self.controllers.items() if number not in self.deaf]
        found = self.controllers.get(frame.can_id)
        return [found] if found and frame.can_id not in self.deaf else []

    # what goes wrong

    def inject(self, fault: Fault) -> None:
        """From now on a positioner is dark, deaf, does not move, or makes a share of its way; without power
        (`busoff`) it is deaf, stops and forgets its table."""
        row, number = self._row[fault.positioner_id], fault.positioner_id
        match fault.kind:
            case FaultKind.DARK:
                self.dark[row] = True
            case FaultKind.DEAF:
                self.deaf.add(number)
            case AilmentKind.SLIPPING:
                self.units.scale[row] = self._slips[row]
            case ServiceKind.BUS_OFF:
                self._cut(number)
            case _:
                self.units.stuck[row] = True

    def clear(self, fault: Fault) -> None:
        """Ends what `inject` has begun."""
        row, number = self._row[fault.positioner_id], fault.positioner_id
        match fault.kind:
            case FaultKind.DARK:
                self.dark[row] = False
            case FaultKind.DEAF | ServiceKind.BUS_OFF:
                self.deaf.discard(number)
            case AilmentKind.SLIPPING:
                self.units.scale[row] = 1.0
            case _:
                self.units.stuck[row] = False

    @cached_property
    def _slips(self) -> Floats:
        """(N, 2, 2) scales of these units, were their motors degraded."""
        every = DesiSizes(linear_theta=1.0, linear_phi=1.0)
        return draw_desi_units(self.plane, self._seed, every).scale

    def _cut(self, number: int) -> None:
        self.deaf.add(number)
        controller = self.controllers[number]
        controller.receive(DesiFrame.of(number, DesiCommand.STOP))
        self._stop([controller] if controller.stopped else [])
        controller.receive(DesiFrame.of(number, DesiCommand.RESET))

    # motion

    def _begin(self) -> None:
        """Tables of all that were asked to run, at once."""
        starting = [c for c in self.controllers.values() if c.started]
        if not starting:
            return
        rows = np.array([self._row[c.can_id] for c in starting])
        tables = tables_from([c.rows for c in starting])
        for controller, duration in zip(starting, tables.duration_s, strict=True):
            controller.begin(float(duration))
        self._run(rows, executed_path(tables))

    def execute(self, tables: MoveTables) -> None:
        """Runs tables of all N units to their end, without frames: for studies of motors alone."""
        self._run(np.arange(len(self.plane)), executed_path(tables))
        self.run(float(tables.duration_s.max(initial=0.0)) + 1e-9)

    def _run(self, rows: Ints, field: FieldPath) -> None:
        every = _with_resting(field, rows, len(self.plane))
        before = self._state
        path, self._state = true_path(self.units, before, every, self._rng)
        self._running.append((self.time_s, rows, path))
        if self._finder:
            self._touches += [self._told(touch) for touch in self._finder.find(path)]

    def _told(self, touch: Touching) -> Touch:
        ids = self.plane.positioner_id
        other = int(ids[touch.other]) if touch.other >= 0 else None
        return Touch(self.time_s + touch.time_s, int(ids[touch.unit]), other)

    def _stop(self, stopped: list[DesiController]) -> None:
        """Motors of these stand still from now on."""
        if not stopped:
            return
        rows = np.array([self._row[c.can_id] for c in stopped])
        for start_s, _, path in self._running:
            here, _ = path.state_at(rows, np.full(len(rows), self.time_s - start_s))
            for name in ("rotor_deg", "gear_deg", "scatter_deg"):
                getattr(self._state, name)[rows] = getattr(here, name)
        self._running = [
            (start, rest, path)
            for start, which, path in self._running
            if len(rest := np.setdiff1d(which, rows))
        ]
        for controller in stopped:
            controller.stopped = False

    # what cameras and reports need

    def truth(self) -> Floats:
        """Output angles (N, 2) in deg: theta, phi."""
        angles = self._state.output_deg(self.units.gears)
        for start_s, rows, path in self._running:
            angles[rows] = path.output_deg(rows, np.full(len(rows), self.time_s - start_s))[0]
        return angles


def _with_resting(field: FieldPath, rows: Ints, n: int) -> FieldPath:
    """Fields of all n units: those that run, and the others at rest until the last has ended."""
    tick = np.zeros((n, field.tick.shape[1]), dtype=np.int64)
    tick[:, -1] = field.tick[:, -1].max()
    tenths = np.zeros((n, *field.tenths.shape[1:]))
    tick[rows], tenths[rows] = field.tick, field.tenths
    return FieldPath(tick, tenths)


def _start(plane: FocalPlane, start_deg: ArrayLike | None) -> Floats:
    folded = plane.instrument.positioner.park_deg if start_deg is None else start_deg
    start = np.array(np.broadcast_to(np.asarray(folded, dtype=np.float64), (len(plane), 2)))
    start[plane.offline] = plane.offline_position_deg[plane.offline]
    return start
