"""The twin of a focal plane: `Twin` wraps `_core.twin.Twin` in public units."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from functools import partial
from typing import Any, Literal, NamedTuple, TypedDict, Unpack

import numpy as np
from numpy.typing import ArrayLike

from fiberloom._core import geometry
from fiberloom._core import twin as _core
from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane
from fiberloom.instruments.model import AXES, BODY_SHARE, METROLOGY
from fiberloom.instruments.pointing import Pointing
from fiberloom.timing import core_count, part
from fiberloom.twin.faults.faults import Fault
from fiberloom.twin.faults.kinds import FaultKind
from fiberloom.twin.units import Units, plain
from fiberloom.typing import Floats, Records
from fiberloom.units import deg_to_rad, rad_to_deg

SCOPE_DTYPE = np.dtype([(name, np.float64) for name in _core.SCOPE_FIELDS])


class Reply(NamedTuple):
    """A frame that a positioner sent, and when (virtual seconds)."""

    id: int
    data: bytes
    time_s: float


_REPLY = partial(tuple.__new__, Reply)
"""Of what the core tells: `Reply(*sent)` in a third of the time."""


class Touch(NamedTuple):
    """Two bodies came into contact: positioner numbers, `other` None for a fixed body."""

    time_s: float
    positioner_id: int
    other: int | None


ADAPTIVE = (10, 2)
"""Substeps: 50 us, but 250 us while an axis pushes its gear. The error is that of 50 us, which contacts and
reversals make (docs/twin.md)."""


class Computing(TypedDict, total=False):
    """How a twin is computed: the same bytes whatever they are, but for the substeps."""

    threads: int | None
    """One for each core that the process may use when None."""
    skip_resting: bool
    """A positioner at rest costs nothing."""
    side_by_side: bool
    """Laws of the firmware in vectors."""
    sort_lanes: bool
    """Positioners whose ways end about together are stepped together from START on."""
    kernel: str
    """Instruction set of the inner loops; empty: the best."""
    substeps: int | tuple[int, int]
    """Of the plant in a tick, `ADAPTIVE` unless told; a second number is that of a tick in which an axis
    pushes its gear all the time. Other numbers are other physics."""
    bound_scale: float
    """Of how far arms may come before they are looked at again: above 1 threads wait for each other more
    often than they must."""


class Twin:
    """Positioners with their firmware on a virtual bus; the clock does not advance between calls.

    `start_deg` (N, 2): output angles at power-up, told to the firmware as after a datum; folded by
    default. Without `neighbours` arms pass through each other (the bench). `computing`: see `Computing`.
    """

    def __init__(
        self,
        plane: FocalPlane,
        units: Units,
        *,
        seed: int = 0,
        neighbours: bool = True,
        start_deg: ArrayLike | None = None,
        **computing: Unpack[Computing],
    ) -> None:
        if len(units) != len(plane):
            raise InputError(f"twin: {len(units)} units for {len(plane)} positioners; draw them anew")
        self.plane = plane
        self.units = units
        self.dark = np.zeros(len(plane), dtype=bool)
        self.pointing = Pointing()
        self._touches: list[Touch] = []
        self._told = 0
        try:
            setup = _core.TwinSetup(
                ids=np.ascontiguousarray(plane.positioner_id, dtype=np.uint16),
                plant=plain(units.plant),
                transmission=plain(units.gear),
                firmware=plain(units.firmware, np.float32),
                start_rad=deg_to_rad(_start(plane, start_deg)),
            )
            body_mm = (*plane.beta_segment_mm, BODY_SHARE * plane.collision_buffer_mm)
            setup.place(units.arms, _obstacles(plane), body_mm)
            setup.seed = seed
            setup.threads = computing.get("threads") or core_count()
            setup.neighbours = neighbours
            setup.skip_resting = computing.get("skip_resting", True)
            setup.side_by_side = computing.get("side_by_side", True)
            setup.sort_lanes = computing.get("sort_lanes", True)
            setup.substeps = computing.get("substeps", ADAPTIVE)
            setup.kernel = computing.get("kernel", "")
            setup.bound_scale = computing.get("bound_scale", 1.0)
            self._core = _core.Twin(setup)
            if units.loaded:
                self._core.set_loads(plain(units.load).reshape(len(plane), -1))
        except ValueError as error:
            raise InputError(f"twin: {error}") from None
        for number in plane.positioner_id[plane.offline]:
            self.inject(Fault(FaultKind.DEAF, int(number)))

    @property
    def time_s(self) -> float:
        """Virtual time since power-up."""
        return self._core.tick * _core.TICK_S

    @property
    def kernel(self) -> str:
        """Instruction set of the inner loops."""
        return self._core.kernel

    @part("twin")
    def send(self, frames: Iterable[Sequence[Any]]) -> None:
        """Puts frames (identifier, data, ...) on the bus now, in order."""
        for frame in frames:
            self._core.send(frame[0], bytes(frame[1]))

    @part("twin")
    def run(self, duration_s: float) -> list[Reply]:
        """Lets time pass, to the nearest tick of 0.5 ms; what was sent since the last call."""
        if not 0.0 <= duration_s < 1e6:
            raise InputError(f"twin: cannot run for {duration_s} s; give 0 to a million")
        return list(map(_REPLY, self._core.run(round(duration_s / _core.TICK_S))))

    @part("twin")
    def run_until_reply(self, slice_s: float, slices: int) -> list[Reply]:
        """As so many calls of `run` with `slice_s`, but none after one that has brought a reply."""
        return list(map(_REPLY, self._core.run_until_reply(round(slice_s / _core.TICK_S), slices)))

    def truth(self) -> Floats:
        """Output angles (N, 2) in deg: alpha, beta."""
        return rad_to_deg(self._core.outputs_rad())

    def fibre_xy(self, fibre: str = METROLOGY) -> Floats:
        """True position (N, 2) in mm of a fibre; NaN where a positioner lacks it."""
        if fibre not in self.plane.points:
            raise InputError(f"fibre '{fibre}': this plane has {', '.join(self.plane.points)}")
        points = self.units.points_mm(self.plane.points[fibre], fibre)
        return geometry.forward(self.units.arms, points, self._core.outputs_rad())

    def point(self, pointing: Pointing) -> None:
        """Points the telescope: gravity pulls at the arms so from now on."""
        self.pointing = pointing
        x_m_s2, y_m_s2 = pointing.gravity_m_s2()
        self._core.point(float(x_m_s2), float(y_m_s2))

    def fibre_xy_at(self, fibre: str, pointing: Pointing) -> Floats:
        """As `fibre_xy`, (N, 2) mm, with arms and motors as they are, were the telescope to point so."""
        here = self.pointing
        self.point(pointing)
        try:
            return self.fibre_xy(fibre)
        finally:
            self.point(here)

    def inject(self, fault: Fault) -> None:
        """Breaks something, until `clear`."""
        self._set(fault, True)

    def clear(self, fault: Fault) -> None:
        """Repairs it. An arm that did not follow its motor stays where the fault left it."""
        self._set(fault, False)

    def _set(self, fault: Fault, on: bool) -> None:
        row = int(self.plane.index_of(fault.positioner_id))
        kind = FaultKind(fault.kind)
        if kind is FaultKind.DARK:
            self.dark[row] = on
            return
        for axis in fault.axes:
            self._core.fault(row, axis, str(kind), on)

    def slip(self, positioner_id: int, axis: Literal["alpha", "beta"], up: float, down: float) -> None:
        """From now on the arm moves only a share of its gear's way; 1 and 1 end it.

        `positioner_id` and `axis`; `up` and `down`: the shares upwards and downwards. Degraded motors
        do this, each direction on its own: DESI's move half as far as commanded. The firmware counts
        its motor and reports arrival.
        """
        row = int(self.plane.index_of(positioner_id))
        self._core.slip(row, AXES.index(axis), up, down)

    def power_cycle(self, positioner_id: int, bootloader: bool = False) -> None:
        """Power off and on: the firmware starts anew with what it has stored.

        At once, or as units do: after ten seconds in the bootloader, if no upgrade comes.
        """
        self._core.power_cycle(int(self.plane.index_of(positioner_id)), bootloader)

    def power_up(self, positioner_id: int, turns: tuple[int, int] = (0, 0)) -> None:
        """Power off and on at rest, with no datum on record.

        The firmware restores what it has stored, and its hall sensors say the angle of each motor within a
        turn. `turns`: whole motor turns of alpha and beta that the counters of `positioner_id` are off by.
        """
        self._core.power_up(int(self.plane.index_of(positioner_id)), *turns)

    def set_gear(self, units: Units) -> None:
        """Gears as these units have them, from now on: wear. Arms stay where they are in the gear."""
        for row in range(len(self.plane)):
            for axis in (0, 1):
                self._core.set_transmission(row, axis, plain(units.gear[row, axis]).ravel())
        self.units = units

    def set_units(self, units: Units) -> None:
        """These units' gears, plant parameters and arms, from now on: wear (`fiberloom.twin.wear`).

        What the firmware believes stays. Neighbours feel the arms that there were at power-up.
        """
        for row in range(len(self.plane)):
            for axis in (0, 1):
                self._core.set_params(row, axis, plain(units.plant[row, axis]).ravel())
        self.set_gear(units)

    def set_temperature(self, counts: ArrayLike) -> None:
        """What the positioners' temperature sensors read from now on: (N,), or one for all, in counts."""
        for row, read in enumerate(np.broadcast_to(np.asarray(counts, dtype=np.int64), (len(self.plane),))):
            self._core.set_temperature(row, int(read))

    def set_external_torque(self, index: int, axis: int, torque_Nm: float) -> None:
        """A torque on an arm from outside, positive towards positive angles. Eq. 5a."""
        self._core.set_external_torque(index, axis, torque_Nm)

    def scope(self, index: int, axis: int) -> Scope:
        """Logs every tick of one axis from now on."""
        return Scope(self._core, index, axis)

    def touches(self) -> list[Touch]:
        """First moments of contact since the last call; what bounces for 40 ms is one contact."""
        self.contacts()
        found, self._touches = self._touches, []
        self._told += len(found)
        return found

    def contacts(self) -> int:
        """How many of these there have been so far."""
        n, ids = len(self.plane), self.plane.positioner_id
        self._touches += [
            Touch(t, int(ids[i]), int(ids[j]) if j < n else None) for t, i, j in self._core.take_touches()
        ]
        return self._told + len(self._touches)


class Scope:
    """What one axis does, tick by tick (fields: SCOPE_DTYPE). Stops at the end of a `with`."""

    def __init__(self, core: _core.Twin, index: int, axis: int) -> None:
        self._core, self._index, self._axis = core, index, axis
        core.scope(index, axis, True)

    def take(self) -> Records:
        """The samples since the last call, and forgets them."""
        return self._core.take_scope(self._index, self._axis).view(SCOPE_DTYPE)[:, 0]

    def close(self) -> None:
        """Stops logging."""
        self._core.scope(self._index, self._axis, False)

    def __enter__(self) -> Scope:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()


def _start(plane: FocalPlane, start_deg: ArrayLike | None) -> Floats:
    folded = plane.park_deg if start_deg is None else start_deg
    start = np.array(np.broadcast_to(np.asarray(folded, dtype=np.float64), (len(plane), 2)))
    start[plane.offline] = plane.offline_position_deg[plane.offline]
    return start


def _obstacles(plane: FocalPlane) -> Floats:
    discs = plane.fiducials.reshape(-1, 3)[:, [0, 1, 0, 1, 2]]
    return np.ascontiguousarray(np.vstack([discs, plane.guide_cameras.reshape(-1, 5)]))
