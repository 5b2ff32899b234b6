"""LAMOST: motors that hear packets over the air. Little of it is public: its page says what is assumed."""

from fiberloom.drive.lamost.packets import RadioPacket, coordinator_of, decoded, encoded
from fiberloom.drive.lamost.radio import RadioTransport

__all__ = ["RadioPacket", "RadioTransport", "coordinator_of", "decoded", "encoded"]
