"""DESI's twin behind a CAN@net device on TCP.

A broadcast comes by every port, and is heard by all once and again.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping

import numpy as np

from fiberloom.bus.transport import Frame
from fiberloom.twin.desi.array import DesiTwin
from fiberloom.twin.faults.clock import FaultClock
from fiberloom.twin.faults.schedule import ScheduledFault
from fiberloom.twin.server.address import Address
from fiberloom.twin.server.camera.exposing import Look
from fiberloom.twin.server.can_units import CanUnitsServer, shared_out
from fiberloom.twin.server.device import PORTS


class _DesiUnits:
    """Implements `CanUnits`."""

    def __init__(self, twin: DesiTwin) -> None:
        self._twin = twin
        self.port_of: Mapping[int, int] = shared_out(twin.plane.positioner_id.tolist(), PORTS)

    @property
    def time_s(self) -> float:
        """Of the twin."""
        return self._twin.time_s

    def run(self, duration_s: float) -> None:
        """Lets time pass, s."""
        self._twin.run(duration_s)

    def hear(self, port: int, frame: Frame) -> list[tuple[int, Frame]]:
        """A `frame` of the host, on whatever `port`; the replies, with the numbers of their units."""
        replies = self._twin.send([(frame.id, frame.data)])
        return [(reply.can_id, Frame(reply.identifier, reply.data)) for reply in replies]

    def look(self) -> Look:
        """Fibres that are lit."""
        lit_mm = np.where(self._twin.dark[:, None], np.nan, self._twin.fibre_xy())
        return Look(self._twin.time_s, lit_mm)

    def contacts(self) -> int:
        """So far."""
        return self._twin.contacts()


class DesiServer(CanUnitsServer):
    """Serves a twin of DESI's positioners."""

    def __init__(
        self,
        twin: DesiTwin,
        address: Address,
        *,
        schedule: Iterable[ScheduledFault] = (),
        speed: float = 1.0,
        seed: int = 0,
    ) -> None:
        """`schedule`: faults that begin and end in the twin's time; `speed`: its seconds in one of ours;
        `seed`: of replies that are lost.
        """
        self.twin = twin
        super().__init__(_DesiUnits(twin), address, FaultClock(twin, schedule, seed), speed)
