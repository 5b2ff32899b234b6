"""A bus by its address: CAN@net gateways, or any interface that python-can knows."""

from __future__ import annotations

from dataclasses import dataclass

from fiberloom.bus.cannet import CanNetTransport
from fiberloom.bus.transport import PythonCanTransport, Transport
from fiberloom.errors import InputError

CANNET = "cannet"


@dataclass(frozen=True)
class BusSpec:
    """A parsed address; `open` connects."""

    interface: str
    channel: str

    @classmethod
    def parse(cls, text: str) -> BusSpec:
        """`cannet://HOST[:PORT][,HOST...]`, or `INTERFACE://CHANNEL` by python-can's names."""
        interface, separator, channel = text.partition("://")
        if not separator or not interface or not channel:
            raise InputError(
                f"bus '{text}': expected cannet://HOST:PORT[,HOST:PORT...], or INTERFACE://CHANNEL with an "
                "interface of python-can, e.g. socketcan://can0"
            )
        return cls(interface, channel)

    async def open(self) -> Transport:
        """Connects."""
        if self.interface == CANNET:
            return await CanNetTransport.open([host.strip() for host in self.channel.split(",")])
        return PythonCanTransport.open(self.interface, self.channel)
