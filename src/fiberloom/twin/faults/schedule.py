"""The fault schedule: which positioners and ports have which fault, and when."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from fiberloom.errors import InputError
from fiberloom.twin.faults.faults import Fault
from fiberloom.twin.faults.grammar import FaultRequest
from fiberloom.twin.faults.kinds import SHARES, CameraFaultKind, ServiceKind
from fiberloom.typing import Ints

_Free = TypeVar("_Free")


@dataclass(frozen=True)
class ScheduledFault:
    """One fault of one positioner, port or share of replies. Times are virtual seconds."""

    kind: str
    positioner_id: int = 0  # of faults of a positioner, and power cuts
    place: tuple[int, int] = (0, 0)  # of bus off: device (from 0), port; of a cut: device, 0
    share: float = 0.0  # of replies that are lost or late
    late_s: float = 0.0
    start_s: float = 0.0
    end_s: float = np.inf

    @property
    def fault(self) -> Fault:
        """As the twin knows it."""
        return Fault(self.kind, self.positioner_id)

    def __str__(self) -> str:
        if self.kind == ServiceKind.BUS_OFF:
            return f"{self.kind} device {self.place[0] + 1} port {self.place[1]}"
        if self.kind == ServiceKind.CUT:
            return f"{self.kind} gateway {self.place[0] + 1}"
        if self.kind in SHARES:
            return f"{self.kind} {100 * self.share:g} % of replies"
        if self.kind in set(CameraFaultKind):
            return self.kind
        return f"{self.kind} positioner {self.positioner_id}"


def schedule_faults(
    requests: Iterable[FaultRequest],
    positioner_ids: Sequence[int] | Ints,
    places: Sequence[tuple[int, int]],
    seed: int,
) -> list[ScheduledFault]:
    """Draws by the `seed` which of `positioner_ids` and `places` (device, port) have which fault.

    Each is drawn at most once, in the order of the `requests`. Raises InputError that names the request
    for which too few are left, or whose positioner is not there.
    """
    rng = np.random.default_rng([seed, 0xFA17])
    pool = _Pool(
        [int(i) for i in positioner_ids],
        [int(i) for i in rng.permutation(positioner_ids)],
        [places[k] for k in rng.permutation(len(places))],
        [(int(d), 0) for d in rng.permutation(sorted({device for device, _ in places}))],
    )
    return [fault for request in requests for fault in _scheduled(request, pool)]


@dataclass
class _Pool:
    known: list[int]
    free_ids: list[int]
    free_places: list[tuple[int, int]]
    free_gateways: list[tuple[int, int]]

    def named(self, request: FaultRequest) -> int:
        positioner = request.positioner_id
        if positioner is None or positioner not in self.known:
            numbers = f"{min(self.known)} to {max(self.known)}" if self.known else "none"
            raise InputError(
                f"--faults {request}: no such positioner in the layout, whose numbers are {numbers}"
            )
        if positioner in self.free_ids:
            self.free_ids.remove(positioner)
        return positioner

    def gateway(self, request: FaultRequest) -> tuple[int, int]:
        place = ((request.positioner_id or 0) - 1, 0)
        if place not in self.free_gateways:
            raise InputError(
                f"--faults {request}: no such gateway; they are counted from 1, each is cut once"
            )
        self.free_gateways.remove(place)
        return place

    def drawn(self, request: FaultRequest, free: list[_Free]) -> list[_Free]:
        if request.count > len(free):
            raise InputError(f"--faults {request}: give a whole number, at most {len(free)} here")
        return [free.pop(0) for _ in range(request.count)]


def _scheduled(request: FaultRequest, pool: _Pool) -> list[ScheduledFault]:
    return [replace(fault, start_s=request.start_s, end_s=request.end_s) for fault in _endless(request, pool)]


def _endless(request: FaultRequest, pool: _Pool) -> list[ScheduledFault]:
    kind = request.kind
    if request.share is not None:
        return [ScheduledFault(kind, share=request.share, late_s=request.late_s or 0.0)]
    if kind == ServiceKind.CUT:
        one = request.positioner_id is not None
        places = [pool.gateway(request)] if one else pool.drawn(request, pool.free_gateways)
        return [ScheduledFault(kind, place=place) for place in places]
    if kind in set(CameraFaultKind):
        if request.count > 1:
            raise InputError(f"--faults {request}: there is one camera; write it without a number")
        return [ScheduledFault(kind)] * request.count
    if request.positioner_id is not None:
        return [ScheduledFault(kind, pool.named(request))]
    if kind == ServiceKind.BUS_OFF:
        return [ScheduledFault(kind, place=place) for place in pool.drawn(request, pool.free_places)]
    return [ScheduledFault(kind, positioner) for positioner in pool.drawn(request, pool.free_ids)]
