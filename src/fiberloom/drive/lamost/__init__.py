"""LAMOST: motors that hear packets over the air. Little of it is public: its page says what is assumed."""

from fiberloom.drive.lamost.coordinators import TcpRadio, radio_address
from fiberloom.drive.lamost.packets import RadioPacket, RadioReader, coordinator_of, decoded, encoded
from fiberloom.drive.lamost.radio import RadioTransport

__all__ = [
    "RadioPacket",
    "RadioReader",
    "RadioTransport",
    "TcpRadio",
    "coordinator_of",
    "decoded",
    "encoded",
    "radio_address",
]
