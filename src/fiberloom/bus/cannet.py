"""CAN@net NT 420 gateways: CAN frames as ASCII lines over TCP.

One line is one frame: `M 1 CED 00040C10 01 02`: port, classic/extended/data, identifier, bytes. A
unicast goes to the port from which its positioner has answered, a broadcast to every port of every
gateway. A gateway discards what does not fit its transmit queue of 100 frames a port, without a
word; `_Pace` keeps below that.

A gateway that is cut reconnects by itself, in a task of its own. Frames for it are dropped meanwhile: a
START or a goal that comes late is worse than none.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
import re
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial

from fiberloom.bus.identifier import positioner_of
from fiberloom.bus.links import Link, notice_silence, retries_s
from fiberloom.bus.transport import Frame, TransportLost, take_all
from fiberloom.errors import InputError
from fiberloom.files import tcp_port

TCP_PORT = 19228
BITRATES_KBIT = (5, 10, 20, 50, 62.5, 83.3, 100, 125, 500, 800, 1000)

_FRAME = re.compile(r"M ([1-4]) CED ([0-9A-F]{8})((?: [0-9A-F]{2}){0,8})", re.IGNORECASE)

# 1 Mbit/s carries an 8-byte extended frame in about 0.14 ms (131 bits and stuffing); replies come
# over the same wire, so half of that is ours.
_FRAMES_PER_S = 3500.0
_QUEUE = 90.0  # of the 100 places, frames
_STALL_S = 5.0  # a gateway that does not read for so long is gone
# Lines that are read in one step of the loop: 500 positioners answer with thousands at once.
_LINES_A_STEP = 64


_Sent = tuple[int, bytes] | Frame
"""Identifier and data come first."""


def frame_to_line(port: int, frame: _Sent) -> str:
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


@dataclass(frozen=True)
class _Setup:
    """How the CAN ports of every gateway are set up."""

    ports: tuple[int, ...]
    bitrate_kbit: float
    timeout_s: float
    """For the connection, and for each answer."""


class _Gateway:
    """One device: its connection, its ports, and the task that reads it and reconnects it.

    `take` gets each line; `wake` is called when the link goes down or up.
    """

    def __init__(self, host: str, tcp_port: int, setup: _Setup) -> None:
        self.address = (host, tcp_port)
        self.link = Link(f"{host}:{tcp_port}", since_s=time.monotonic())
        self.paces = {port: _Pace() for port in setup.ports}
        self.take: Callable[[str], None] = lambda line: None
        self.wake: Callable[[], None] = lambda: None
        self._setup = setup
        self._task: asyncio.Task[None] | None = None
        self.writer: asyncio.StreamWriter | None = None

    @property
    def name(self) -> str:
        return self.link.name

    async def open(self) -> None:
        """Connects and starts the ports; InputError where the device does not do its part."""
        try:
            self.reader, writer = await asyncio.wait_for(
                asyncio.open_connection(*self.address), self._setup.timeout_s
            )
        except (TimeoutError, OSError, UnicodeError) as error:  # the last of a name that can be none
            raise InputError(
                f"CAN@net gateway {self.name}: no connection ({error or 'timed out'}); check "
                "address and power, and that no other client is connected"
            ) from None
        self.writer = writer
        notice_silence(writer)
        try:
            await self._start_ports()
        except OSError as error:
            raise InputError(f"CAN@net gateway {self.name}: {error}") from None

    async def _start_ports(self) -> None:
        for line in ("STOP", f"INIT STD {self._setup.bitrate_kbit:g}", "FILTER CLEAR",
                     "FILTER ADD EXT 00000000 00000000", "START"):  # fmt: skip
            for port in self.paces:
                self.write([f"CAN {port} {line}"])
                await self._confirm(f"CAN {port} {line}")

    async def _confirm(self, command: str) -> None:
        """Waits for `R ok`; frames and events that come in between are not for us yet."""
        deadline_s = time.monotonic() + self._setup.timeout_s
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

    def serve(self) -> None:
        """From now on the gateway is read, and reconnected whenever it breaks."""
        self._task = asyncio.create_task(self._keep())

    async def _keep(self) -> None:
        while True:
            self.breaks(await self._read())
            await self._reconnect()
            self.link.comes_up(time.monotonic())
            self.wake()

    async def _read(self) -> str:
        """Hands on lines until the connection closes or goes wrong; returns why it ended."""
        try:
            for there in itertools.count(1):
                if not (raw := await self.reader.readline()):
                    break
                self.take(raw.decode("ascii", "replace").strip())
                if there % _LINES_A_STEP == 0:  # a line that has come already is no step of the loop
                    await asyncio.sleep(0)
        except (OSError, ValueError) as error:
            return str(error) or type(error).__name__
        return "closed the connection"

    async def _reconnect(self) -> None:
        for wait_s in retries_s():
            await asyncio.sleep(wait_s)
            with contextlib.suppress(InputError):
                await self.open()
                return
            self._abort()

    def breaks(self, reason: str) -> None:
        """Takes the link down; the task that reads it then reconnects."""
        self.link.goes_down(f"CAN@net gateway {self.name} {reason}", time.monotonic())
        self._abort()
        self.wake()

    def _abort(self) -> None:
        if self.writer is not None:
            self.writer.transport.abort()

    def write(self, lines: Sequence[str]) -> None:
        if self.writer is not None:
            self.writer.write("".join(f"{line}\n" for line in lines).encode("ascii"))

    async def feed(self, port: int, frames: list[_Sent]) -> None:
        """Frames for a port, no faster than the CAN bus takes them; dropped while the link is down."""
        pace = self.paces[port]
        while frames and self.link.up:
            await asyncio.sleep(pace.wait_s())
            room = pace.room()
            now, frames = frames[:room], frames[room:]
            pace.add(len(now))
            await self._push([frame_to_line(port, frame) for frame in now])

    async def _push(self, lines: Sequence[str]) -> None:
        if not self.link.up or self.writer is None:
            return
        try:
            self.write(lines)
            await asyncio.wait_for(self.writer.drain(), _STALL_S)
        except TimeoutError:
            self.breaks("no longer takes what it is sent")
        except OSError as error:
            self.breaks(str(error) or type(error).__name__)

    async def close(self) -> None:
        """Stops the ports and lets go of the connection."""
        if self._task is not None:
            self._task.cancel()
            await asyncio.gather(self._task, return_exceptions=True)
        if self.writer is None:
            return
        try:
            self.write([f"CAN {port} STOP" for port in self.paces])
            self.writer.close()
            await asyncio.wait_for(self.writer.wait_closed(), 1.0)
        except (TimeoutError, OSError, RuntimeError):
            pass  # gone already: closed is what was asked for


class CanNetTransport:
    """A Transport over one or more CAN@net NT 420 gateways, each a link. Time is the wall clock."""

    def __init__(self, gateways: Sequence[_Gateway], whose: Callable[[int], int] = positioner_of) -> None:
        """`whose`: the positioner of an identifier, 0 for all."""
        self._gateways, self._whose = gateways, whose
        self._route: dict[int, tuple[_Gateway, int]] = {}
        self._received: asyncio.Queue[Frame] = asyncio.Queue()
        self._closed = False
        self.events: list[str] = []
        """What the gateways said beside frames: bus off, error warnings, refused commands."""
        for gateway in gateways:
            gateway.take = partial(self._take_line, gateway)
            gateway.wake = self._wake
            gateway.serve()

    @classmethod
    async def open(
        cls,
        hosts: Sequence[str],
        *,
        tcp_port: int = TCP_PORT,
        ports: Sequence[int] = (1, 2, 3, 4),
        bitrate_kbit: float = 1000,
        timeout_s: float = 5.0,
        whose: Callable[[int], int] = positioner_of,
    ) -> CanNetTransport:
        """Connect to gateways and start their CAN ports.

        `hosts`: "host" or "host:port" each, `tcp_port` where none is given; `ports`: the CAN ports to
        use; `bitrate_kbit`: kbit/s of these; `timeout_s`: for the connection and each answer; `whose`: the
        positioner of an identifier, 0 for all.
        InputError for a bit rate that the device does not have, or when a gateway does not answer.
        """
        if bitrate_kbit not in BITRATES_KBIT:
            raise InputError(f"CAN@net has no {bitrate_kbit} kbit/s; it knows {BITRATES_KBIT}")
        setup = _Setup(tuple(ports), bitrate_kbit, timeout_s)
        gateways: list[_Gateway] = []
        try:
            for host in hosts:
                name, _, own_port = host.partition(":")
                gateways.append(_Gateway(name, _tcp_port(own_port, tcp_port, host), setup))
                await gateways[-1].open()
        except BaseException:
            for gateway in gateways:
                await gateway.close()
            raise
        return cls(gateways, whose)

    @property
    def time_s(self) -> float:
        """Monotonic wall-clock time."""
        return time.monotonic()

    @property
    def links(self) -> Sequence[Link]:
        """One for each gateway."""
        return [gateway.link for gateway in self._gateways]

    def link_of(self, positioner: int) -> Link | None:
        """The gateway behind which a positioner has answered; None before it did."""
        known = self._route.get(positioner)
        return None if known is None else known[0].link

    def line_of(self, positioner: int) -> str:
        """The port, in words, at which a positioner has answered; "" before it did."""
        known = self._route.get(positioner)
        return "" if known is None else f"CAN port {known[1]} of {known[0].name}"

    def _wake(self) -> None:
        """The task that waits looks at the links."""
        self._received.put_nowait(Frame(-1))

    def _take_line(self, gateway: _Gateway, line: str) -> None:
        parsed = line_to_frame(line)
        if parsed is None:
            if line and line.upper() != "R OK":
                self.events.append(f"{gateway.name}: {line}")
            return
        port, frame = parsed
        self._route[self._whose(frame.id)] = (gateway, port)
        self._received.put_nowait(frame._replace(time_s=self.time_s))

    async def send(self, frames: Sequence[_Sent]) -> None:
        """Writes frames to the ports they belong to, no faster than the CAN bus takes them.

        What belongs to a gateway whose link is down is dropped.
        """
        if self._closed:
            raise TransportLost("CAN@net: the transport is closed")
        queues: dict[tuple[_Gateway, int], list[_Sent]] = {}
        for frame in frames:
            for place in self._places(self._whose(frame[0])):
                queues.setdefault(place, []).append(frame)
        await asyncio.gather(*(g.feed(p, mine) for (g, p), mine in queues.items()))

    def _places(self, positioner: int) -> list[tuple[_Gateway, int]]:
        known = self._route.get(positioner)
        if positioner and known:
            return [known]
        # port not known yet: the positioner gets it on its own port
        return [(gateway, port) for gateway in self._gateways for port in gateway.paces]

    async def receive(self, timeout_s: float) -> list[Frame]:
        """The frames of all gateways in the order of their arrival."""
        if self._closed:
            raise TransportLost("CAN@net: the transport is closed")
        return await take_all(self._received, timeout_s)

    async def close(self) -> None:
        """Stops the CAN ports and closes the connections."""
        self._closed = True
        self._wake()
        for gateway in self._gateways:
            await gateway.close()


def _tcp_port(text: str, default: int, host: str) -> int:
    if not text:
        return default
    if (port := tcp_port(text)) is None:
        raise InputError(f"gateway '{host}': expected HOST or HOST:PORT with a port 1 to 65535")
    return port
