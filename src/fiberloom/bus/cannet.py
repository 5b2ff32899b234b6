"""CAN@net NT 420 gateways: CAN frames as ASCII lines over TCP.

One line is one frame: `M 1 CED 00040C10 01 02`: port, classic/extended/data, identifier, bytes. A
unicast goes to the port from which its positioner has answered, a broadcast to every port of every
gateway. A gateway discards what does not fit its transmit queue of 100 frames a port, without a
word; `_Pace` keeps below that.
"""

from __future__ import annotations

import asyncio
import re
import time
from collections.abc import Sequence
from dataclasses import dataclass, field

from fiberloom.bus.transport import Frame, TransportLost
from fiberloom.errors import InputError

TCP_PORT = 19228
BITRATES_KBIT = (5, 10, 20, 50, 62.5, 83.3, 100, 125, 500, 800, 1000)

_FRAME = re.compile(r"M ([1-4]) CED ([0-9A-F]{8})((?: [0-9A-F]{2}){0,8})", re.IGNORECASE)

# 1 Mbit/s carries an 8-byte extended frame in about 0.14 ms (131 bits and stuffing); replies come
# over the same wire, so half of that is ours.
_FRAMES_PER_S = 3500.0
_QUEUE = 90.0  # of the 100 places, frames
_STALL_S = 5.0  # a gateway that does not read for so long is gone


def frame_to_line(port: int, frame: tuple[int, bytes] | Frame) -> str:
    """The line that sends a frame on a port, without its end."""
    text = f"M {port} CED {frame[0]:08X}"
    return f"{text} {frame[1].hex(' ').upper()}" if frame[1] else text


def line_to_frame(line: str) -> tuple[int, Frame] | None:
    """Port and frame of a line; None for lines that are no classic extended data frame."""
    match = _FRAME.fullmatch(line.strip())
    if match is None or (identifier := int(match[2], 16)) >= 1 << 29:
        return None
    return int(match[1]), Frame(identifier, bytes.fromhex(match[3]))


@dataclass
class _Pace:
    """A leaky bucket: how full the queue of one port may be."""

    level: float = 0.0
    since_s: float = field(default_factory=time.monotonic)

    def add(self, frames: int) -> None:
        """Frames were handed to the gateway."""
        self.level = self.level_now() + frames
        self.since_s = time.monotonic()

    def level_now(self) -> float:
        return max(self.level - _FRAMES_PER_S * (time.monotonic() - self.since_s), 0.0)

    def wait_s(self) -> float:
        """How long until a quarter of the queue is free again."""
        return max(self.level_now() - 0.75 * _QUEUE, 0.0) / _FRAMES_PER_S

    def room(self) -> int:
        return max(int(_QUEUE - self.level_now()), 0)


class _Gateway:
    """One device: its connection, its ports, and the task that reads it."""

    def __init__(self, host: str, tcp_port: int, ports: Sequence[int]) -> None:
        self.name = f"{host}:{tcp_port}"
        self.address = (host, tcp_port)
        self.paces = {port: _Pace() for port in ports}
        self.task: asyncio.Task[None] | None = None

    async def open(self, bitrate_kbit: float, timeout_s: float) -> None:
        try:
            self.reader, self.writer = await asyncio.wait_for(
                asyncio.open_connection(*self.address), timeout_s
            )
        except (TimeoutError, OSError) as error:
            raise InputError(
                f"CAN@net gateway {self.name}: no connection ({error or 'timed out'}); check "
                "address and power, and that no other client is connected"
            ) from None
        for line in ("STOP", f"INIT STD {bitrate_kbit:g}", "FILTER CLEAR",
                     "FILTER ADD EXT 00000000 00000000", "START"):  # fmt: skip
            for port in self.paces:
                self.write([f"CAN {port} {line}"])
                await self._confirm(f"CAN {port} {line}", timeout_s)

    async def _confirm(self, command: str, timeout_s: float) -> None:
        """Waits for `R ok`; frames and events that come in between are not for us yet."""
        deadline_s = time.monotonic() + timeout_s
        while True:
            try:
                left_s = deadline_s - time.monotonic()
                raw = await asyncio.wait_for(self.reader.readline(), max(left_s, 0.0))
            except (TimeoutError, OSError, ValueError):
                raw = b""
            answer = raw.decode("ascii", "replace").strip()
            if not raw:
                raise InputError(f"CAN@net gateway {self.name}: no answer to '{command}'")
            if answer.upper().startswith("R ERR"):
                raise InputError(f"CAN@net gateway {self.name}: '{command}' answered '{answer}'")
            if answer.upper().startswith("R "):
                return

    def write(self, lines: Sequence[str]) -> None:
        self.writer.write("".join(f"{line}\n" for line in lines).encode("ascii"))

    async def close(self) -> None:
        if self.task is not None:
            self.task.cancel()
        try:
            self.write([f"CAN {port} STOP" for port in self.paces])
            self.writer.close()
            await asyncio.wait_for(self.writer.wait_closed(), 1.0)
        except (TimeoutError, OSError, RuntimeError):
            pass  # gone already: closed is what was asked for


class CanNetTransport:
    """A Transport over one or more CAN@net NT 420 gateways. Time is the wall clock."""

    def __init__(self, gateways: Sequence[_Gateway]) -> None:
        self._gateways = gateways
        self._route: dict[int, tuple[_Gateway, int]] = {}
        self._received: asyncio.Queue[Frame] = asyncio.Queue()
        self._lost: str | None = None
        self.events: list[str] = []
        """What the gateways said beside frames: bus off, error warnings, refused commands."""
        for gateway in gateways:
            gateway.task = asyncio.create_task(self._read(gateway))

    @classmethod
    async def open(
        cls,
        hosts: Sequence[str],
        *,
        tcp_port: int = TCP_PORT,
        ports: Sequence[int] = (1, 2, 3, 4),
        bitrate_kbit: float = 1000,
        timeout_s: float = 5.0,
    ) -> CanNetTransport:
        """Connect to gateways and start their CAN ports.

        `hosts`: "host" or "host:port" each, `tcp_port` where none is given; `ports`: the CAN ports to
        use; `bitrate_kbit`: kbit/s of these; `timeout_s`: for the connection and each answer.
        InputError for a bit rate that the device does not have, or when a gateway does not answer.
        """
        if bitrate_kbit not in BITRATES_KBIT:
            raise InputError(f"CAN@net has no {bitrate_kbit} kbit/s; it knows {BITRATES_KBIT}")
        gateways: list[_Gateway] = []
        try:
            for host in hosts:
                name, _, own_port = host.partition(":")
                gateways.append(_Gateway(name, _tcp_port(own_port, tcp_port, host), ports))
                await gateways[-1].open(bitrate_kbit, timeout_s)
        except BaseException:
            for gateway in gateways:
                if hasattr(gateway, "writer"):
                    await gateway.close()
            raise
        return cls(gateways)

    @property
    def time_s(self) -> float:
        """Monotonic wall-clock time."""
        return time.monotonic()

    async def _read(self, gateway: _Gateway) -> None:
        """Turns one gateway's lines into frames until it closes or goes wrong."""
        try:
            while raw := await gateway.reader.readline():
                self._take_line(gateway, raw.decode("ascii", "replace").strip())
            self._lost = f"CAN@net gateway {gateway.name} closed the connection"
        except (OSError, ValueError) as error:
            self._lost = f"CAN@net gateway {gateway.name}: {error}"
        self._received.put_nowait(Frame(-1))  # wakes the task that waits

    def _take_line(self, gateway: _Gateway, line: str) -> None:
        parsed = line_to_frame(line)
        if parsed is None:
            if line and line.upper() != "R OK":
                self.events.append(f"{gateway.name}: {line}")
            return
        port, frame = parsed
        self._route[frame.id >> 18] = (gateway, port)
        self._received.put_nowait(frame._replace(time_s=self.time_s))

    async def send(self, frames: Sequence[tuple[int, bytes] | Frame]) -> None:
        """Writes frames to the ports they belong to, no faster than the CAN bus takes them."""
        queues: dict[tuple[_Gateway, int], list[str]] = {}
        for frame in frames:
            for gateway, port in self._places(frame[0] >> 18):
                queues.setdefault((gateway, port), []).append(frame_to_line(port, frame))
        try:
            await asyncio.gather(*(self._feed(g, p, lines) for (g, p), lines in queues.items()))
        except OSError as error:
            raise TransportLost(f"CAN@net: {error}") from None
        if self._lost:
            raise TransportLost(self._lost)

    def _places(self, positioner: int) -> list[tuple[_Gateway, int]]:
        known = self._route.get(positioner)
        if positioner and known:
            return [known]
        # port not known yet: the positioner gets it on its own port
        return [(gateway, port) for gateway in self._gateways for port in gateway.paces]

    async def _feed(self, gateway: _Gateway, port: int, lines: list[str]) -> None:
        pace = gateway.paces[port]
        while lines and not self._lost:
            await asyncio.sleep(pace.wait_s())
            now, lines = lines[: pace.room()], lines[pace.room() :]
            gateway.write(now)
            pace.add(len(now))
            try:
                await asyncio.wait_for(gateway.writer.drain(), _STALL_S)
            except TimeoutError:
                self._lost = f"CAN@net gateway {gateway.name} no longer takes what it is sent"

    async def receive(self, timeout_s: float) -> list[Frame]:
        """The frames of all gateways in the order of their arrival."""
        frames: list[Frame] = []
        try:
            if self._received.empty():
                frames.append(await asyncio.wait_for(self._received.get(), max(timeout_s, 0.0)))
            while not self._received.empty():
                frames.append(self._received.get_nowait())
        except TimeoutError:
            return []
        frames = [frame for frame in frames if frame.id >= 0]
        if not frames and self._lost:
            raise TransportLost(self._lost)
        return frames

    async def close(self) -> None:
        """Stops the CAN ports and closes the connections."""
        for gateway in self._gateways:
            await gateway.close()


def _tcp_port(text: str, default: int, host: str) -> int:
    if not text:
        return default
    if not text.isdigit() or not 0 < int(text) < 65536:
        raise InputError(f"gateway '{host}': expected HOST or HOST:PORT with a port 1 to 65535")
    return int(text)
