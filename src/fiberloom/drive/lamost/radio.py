"""Frames of motors over the air: each becomes a packet, and each packet that is whole a frame."""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from typing import Protocol

from fiberloom.bus.links import Link, links_of
from fiberloom.bus.transport import Frame
from fiberloom.drive.lamost.packets import RadioPacket, coordinator_of, decoded, encoded
from fiberloom.errors import InputError


class Radio(Protocol):
    """Sends and hears packets."""

    @property
    def time_s(self) -> float:
        """Never runs backwards."""
        ...

    async def send(self, packets: Sequence[bytes]) -> None:
        """Packets, in order."""
        ...

    async def receive(self, timeout_s: float) -> list[bytes]:
        """What was heard; waits up to `timeout_s` for anything."""
        ...

    async def close(self) -> None:
        """Lets go."""
        ...


class RadioTransport:
    """Implements `fiberloom.bus.transport.Transport` over a radio."""

    def __init__(self, radio: Radio) -> None:
        self._radio = radio

    @property
    def time_s(self) -> float:
        """Of the radio."""
        return self._radio.time_s

    @property
    def links(self) -> Sequence[Link]:
        """Of the radio."""
        return links_of(self._radio)

    async def send(self, frames: Sequence[tuple[int, bytes] | Frame]) -> None:
        """A packet for each frame."""
        await self._radio.send([packet_of(frame[0], frame[1]) for frame in frames])

    async def receive(self, timeout_s: float) -> list[Frame]:
        """Frames of the packets that are whole."""
        out = []
        for data in await self._radio.receive(timeout_s):
            with contextlib.suppress(InputError):
                packet = decoded(data)
                out.append(Frame(packet.identifier, packet.message, self.time_s))
        return out

    async def close(self) -> None:
        """Lets go of the radio."""
        await self._radio.close()


def packet_of(identifier: int, message: bytes) -> bytes:
    """The packet of a frame: `identifier` unit x 4 + motor, and its `message`."""
    return encoded(RadioPacket(coordinator_of(identifier >> 2), identifier, bytes(message)))
