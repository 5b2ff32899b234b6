"""A bus by its address: CAN@net gateways, or any interface that python-can knows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from fiberloom.bus.cannet import CanNetTransport
from fiberloom.bus.identifier import positioner_of
from fiberloom.bus.transport import PythonCanTransport, Transport
from fiberloom.errors import InputError

CANNET = "cannet"


@dataclass(frozen=True)
class BusSpec:
    """A parsed address; `open` connects."""

    interface: str
    channels: tuple[str, ...]

    @classmethod
    def parse(cls, text: str) -> BusSpec:
        """`cannet://HOST[:PORT][,HOST...]`, or `INTERFACE:CHANNEL[,CHANNEL...]` by python-can's names."""
        interface, _, rest = text.partition(":")
        channels = tuple(filter(None, (part.strip() for part in rest.removeprefix("//").split(","))))
        if not interface.isidentifier() or not channels:
            raise InputError(
                f"bus '{text}': expected cannet://HOST:PORT[,HOST:PORT...], or "
                "INTERFACE:CHANNEL[,CHANNEL...] with an interface of python-can, e.g. socketcan:can0,can1 "
                "or slcan:/dev/ttyUSB0"
            )
        if len(set(channels)) < len(channels):
            raise InputError(f"bus '{text}': one channel is named twice")
        return cls(interface, channels)

    async def open(self, whose: Callable[[int], int] = positioner_of) -> Transport:
        """Connects; each gateway or channel is a link of its own. `whose`: positioner of an identifier."""
        if self.interface == CANNET:
            return await CanNetTransport.open(self.channels, whose=whose)
        return PythonCanTransport.open(self.interface, *self.channels, whose=whose)
