"""What carries frames: the contract, and the transports for real buses.

The client takes its time from the transport alone, so a transport may have a virtual clock.
"""

from __future__ import annotations

import asyncio
import time
from collections.abc import Sequence
from typing import Any, NamedTuple, Protocol

from fiberloom.errors import InputError


class Frame(NamedTuple):
    """A classic CAN frame with an extended identifier, and when it was received."""

    id: int
    data: bytes = b""
    time_s: float = 0.0


class TransportLost(ConnectionError):
    """The connection to the bus is gone; the transport has to be opened anew."""


class Transport(Protocol):
    """Carries frames to and from the positioners. A lost connection raises TransportLost."""

    @property
    def time_s(self) -> float:
        """The transport's clock: never runs backwards, and runs while `receive` waits."""
        ...

    async def send(self, frames: Sequence[tuple[int, bytes] | Frame]) -> None:
        """Queues frames (identifier, data, ...) in order."""
        ...

    async def receive(self, timeout_s: float) -> list[Frame]:
        """What has arrived; waits up to `timeout_s` for the first frame, then may return none."""
        ...

    async def close(self) -> None:
        """Lets go of the bus. Closing twice does no harm."""
        ...


class PythonCanTransport:
    """Any bus python-can knows: socketcan, slcan, virtual, ..."""

    def __init__(self, bus: Any) -> None:
        self._bus = bus

    @classmethod
    def open(cls, interface: str, channel: str, bitrate: int = 1_000_000) -> PythonCanTransport:
        """Opens a bus by python-can's names for the interface and its channel."""
        import can

        try:
            return cls(can.Bus(interface=interface, channel=channel, bitrate=bitrate))
        except (can.CanError, OSError, NotImplementedError, ValueError) as error:
            raise InputError(
                f"cannot open CAN interface '{interface}', channel '{channel}': {error}; check "
                "the names against python-can's list of interfaces, and that the bus is up"
            ) from None

    @property
    def time_s(self) -> float:
        """Monotonic wall-clock time."""
        return time.monotonic()

    async def send(self, frames: Sequence[tuple[int, bytes] | Frame]) -> None:
        """Hands the frames to python-can in a worker thread; a full queue is waited for."""
        await asyncio.to_thread(self._send, frames)

    def _send(self, frames: Sequence[tuple[int, bytes] | Frame]) -> None:
        import can

        try:
            for frame in frames:
                message = can.Message(arbitration_id=frame[0], data=frame[1], is_extended_id=True, check=True)
                self._bus.send(message, timeout=1.0)
        except (can.CanError, OSError) as error:
            raise TransportLost(f"CAN bus: {error}") from None

    async def receive(self, timeout_s: float) -> list[Frame]:
        """Everything python-can has, once there is something."""
        return await asyncio.to_thread(self._receive, timeout_s)

    def _receive(self, timeout_s: float) -> list[Frame]:
        import can

        frames = []
        try:
            message = self._bus.recv(max(timeout_s, 0.0))
            while message is not None:
                if message.is_extended_id and not message.is_error_frame:
                    stamp = message.timestamp
                    frames.append(Frame(message.arbitration_id, bytes(message.data), stamp))
                message = self._bus.recv(0.0)
        except (can.CanError, OSError) as error:
            raise TransportLost(f"CAN bus: {error}") from None
        return frames

    async def close(self) -> None:
        """Shuts the bus down."""
        self._bus.shutdown()
