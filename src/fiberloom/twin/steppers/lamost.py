"""LAMOST's units in the twin: packets over the air, in virtual time."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence

from fiberloom.drive.lamost.packets import decoded
from fiberloom.drive.lamost.radio import packet_of
from fiberloom.errors import InputError
from fiberloom.twin.desi.transport import DesiTransport, OnBus
from fiberloom.twin.faults.clock import FaultClock


class VirtualRadio:
    """Implements `fiberloom.drive.lamost.radio.Radio`."""

    def __init__(self, units: OnBus, faults: FaultClock) -> None:
        """`units` take the messages in packets; `faults`: what begins and ends meanwhile."""
        self._air = DesiTransport(units, faults)

    @property
    def time_s(self) -> float:
        """Virtual."""
        return self._air.time_s

    async def send(self, packets: Sequence[bytes]) -> None:
        """To the units; a packet that is not whole is not heard."""
        whole = []
        for data in packets:
            with contextlib.suppress(InputError):
                packet = decoded(data)
                whole.append((packet.identifier, packet.message))
        await self._air.send(whole)

    async def receive(self, timeout_s: float) -> list[bytes]:
        """What units answer; else time passes."""
        return [packet_of(frame.id, frame.data) for frame in await self._air.receive(timeout_s)]

    async def close(self) -> None:
        """Nothing to let go of."""
