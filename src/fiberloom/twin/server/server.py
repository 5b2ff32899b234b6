"""A twin behind CAN@net NT 420 devices on TCP, in real time: what jaeger and `CanNetTransport` connect to.

The clock runs in a thread (`RealTimeTwin`); everything here is one asyncio loop that nothing blocks:
bytes come in, frames go to the thread, replies come back through their port's wire. Positioners keep
moving or holding while no host is connected.
"""

from __future__ import annotations

import asyncio
import heapq
import socket
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from fiberloom.bus.cannet import frame_to_line
from fiberloom.bus.transport import Frame
from fiberloom.errors import InputError
from fiberloom.twin.camera.imaging import TwinScene
from fiberloom.twin.faults.faults import Fault
from fiberloom.twin.faults.kinds import SHARES, CameraFaultKind, FaultKind, ServiceKind
from fiberloom.twin.faults.schedule import ScheduledFault
from fiberloom.twin.real_time import RealTimeTwin
from fiberloom.twin.server.address import Address
from fiberloom.twin.server.camera.exposing import Look
from fiberloom.twin.server.device import PORTS, Device, Port
from fiberloom.twin.server.told import counts_text, paced_text
from fiberloom.twin.server.wire import Wire
from fiberloom.twin.twin import Reply, Twin

POSITIONERS_PER_DEVICE = 84
"""21 on each of four ports, as at SDSS-V: with more, the queue of 100 frames overflows easily."""

GRACE_S = 0.25
"""So long a new client waits for the old one's end before it is turned away."""

BACKLOG_BYTES = 1 << 20
"""What a client may leave unread before its frames are thrown away."""

_NO_POWER = (FaultKind.DEAD, FaultKind.DEAF, FaultKind.MUTE)


@dataclass
class Traffic:
    """What went over the devices."""

    frames_in: int = 0
    frames_out: int = 0
    lost: int = 0
    late: int = 0
    overflowed: int = 0
    unread: int = 0
    clients: int = 0
    refused_clients: int = 0


def device_count(positioners: int) -> int:
    """Devices needed for so many positioners."""
    return -(-positioners // POSITIONERS_PER_DEVICE)


def places_of(positioners: int, devices: int) -> list[tuple[int, int]]:
    """(device from 0, port) of each row: neighbours in the list share a port, all ports alike."""
    places = [(device, port) for device in range(devices) for port in PORTS]
    shares = np.array_split(np.arange(positioners), len(places))
    return [place for place, share in zip(places, shares, strict=True) for _ in share]


class _Host(asyncio.Protocol):
    """One TCP connection to a device."""

    def __init__(self, listener: _Listener) -> None:
        self._listener = listener
        self.early = b""
        self.transport: asyncio.Transport | None = None

    def connection_made(self, transport: asyncio.BaseTransport) -> None:
        assert isinstance(transport, asyncio.Transport)
        self.transport = transport
        sock = transport.get_extra_info("socket")
        sock.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        _keep_alive(sock)
        self._listener.arrived(self)

    def data_received(self, data: bytes) -> None:
        if self._listener.host is self:
            self._listener.device.take(data)
        else:  # waits for the one before it to go
            self.early = (self.early + data)[:BACKLOG_BYTES]

    def connection_lost(self, error: Exception | None) -> None:
        self._listener.left(self)


class _Listener:
    """One device on its address, and the host connected to it."""

    def __init__(self, server: TwinServer, number: int, address: Address) -> None:
        self.server = server
        self.number = number
        self.address = address
        self.device = Device(self._on_frame, lambda: server.time_s)
        self.device.say = self.write
        self.host: _Host | None = None
        self._waiting: _Host | None = None
        self._cut = False
        self._listening: asyncio.Server | None = None

    async def open(self) -> None:
        loop = asyncio.get_running_loop()
        try:
            self._listening = await loop.create_server(
                lambda: _Host(self), self.address.host, self.address.port
            )
            # what the system chose, where the port was 0
            self.address = Address(self.address.host, self._listening.sockets[0].getsockname()[1])
        except OSError as error:
            raise InputError(
                f"--listen {self.address}: {error.strerror or error}; choose another address"
            ) from None

    def close(self) -> None:
        if self._listening is not None:
            self._listening.close()
        for host in (self.host, self._waiting):
            if host is not None and host.transport is not None:
                host.transport.close()

    def cut(self, on: bool) -> None:
        """Hangs up on the host, and on every connection until it is over."""
        self._cut = on
        if on and self.host is not None and self.host.transport is not None:
            self.host.transport.abort()

    def arrived(self, host: _Host) -> None:
        if self._cut:
            assert host.transport is not None
            host.transport.abort()
        elif self.host is None:
            self._adopt(host)
        elif self._waiting is None:
            self._waiting = host
            asyncio.get_running_loop().call_later(GRACE_S, self._turn_away, host)
        else:
            self._turn_away(host)

    def _adopt(self, host: _Host) -> None:
        self.host = host
        self.server.traffic.clients += 1
        early, host.early = host.early, b""
        if early:
            self.device.take(early)

    def _turn_away(self, host: _Host) -> None:
        """The device has one host: the second is hung up on."""
        if host is self.host or host.transport is None or host.transport.is_closing():
            return
        self.server.traffic.refused_clients += 1
        host.transport.abort()

    def left(self, host: _Host) -> None:
        if self._waiting is host:
            self._waiting = None
        if self.host is not host:
            return
        self.host = None
        self.device.restart()
        if self._waiting is not None:
            next_host, self._waiting = self._waiting, None
            self._adopt(next_host)

    def _on_frame(self, port: Port, frame: Frame) -> None:
        self.server.to_positioners(self, port, frame)

    def write(self, line: str) -> None:
        """A line to the host, if there is one and it reads."""
        if self.host is None or self.host.transport is None or self.host.transport.is_closing():
            return
        if self.host.transport.get_write_buffer_size() > BACKLOG_BYTES:
            self.server.traffic.unread += 1
            return
        self.host.transport.write(line.encode("ascii") + b"\n")


def _keep_alive(sock: socket.socket) -> None:
    """A host whose machine died without a word frees its device within ten seconds."""
    sock.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
    for name, value in (("TCP_KEEPIDLE", 4), ("TCP_KEEPINTVL", 2), ("TCP_KEEPCNT", 3)):
        if hasattr(socket, name):  # not everywhere
            sock.setsockopt(socket.IPPROTO_TCP, getattr(socket, name), value)


@dataclass(order=True)
class _Outgoing:
    """A reply on its way to the host."""

    time_s: float
    order: int
    listener: _Listener = field(compare=False)
    port: Port = field(compare=False)
    reply: Reply = field(compare=False)


@dataclass(frozen=True)
class ServerSettings:
    """How a twin is served."""

    speed: float = 1.0
    """Seconds of the twin in a second."""
    seed: int = 0
    """Of replies that are lost or late."""
    bootloader: bool = False
    """All positioners begin there, as after power-on."""
    first: bool = False
    """The clock runs before all ordinary programs of the machine."""


class TwinServer:
    """Serves a twin until `close`. `schedule`: faults that begin and end in the twin's time."""

    def __init__(
        self,
        twin: Twin,
        addresses: Sequence[Address],
        *,
        schedule: Iterable[ScheduledFault] = (),
        settings: ServerSettings | None = None,
    ) -> None:
        settings = settings or ServerSettings()
        places = places_of(len(twin.plane), len(addresses))
        self.places = dict(zip(map(int, twin.plane.positioner_id), places, strict=True))
        self.traffic = Traffic()
        self.listeners = [_Listener(self, k, address) for k, address in enumerate(addresses)]
        for listener in self.listeners:
            for port in listener.device.ports.values():
                port.wire = Wire()
        faults = tuple(schedule)
        self._due = sorted(
            [(f.start_s, True, f) for f in faults] + [(f.end_s, False, f) for f in faults],
            key=lambda entry: entry[0],
        )
        self._on_replies: list[ScheduledFault] = []
        self._rng = np.random.default_rng([settings.seed, 0x105E])
        self._heap: list[_Outgoing] = []
        self._order = 0
        self._inbox: list[tuple[int, bytes, int, float]] = []
        self._flush: asyncio.TimerHandle | None = None
        self._schedule_timer: asyncio.TimerHandle | None = None
        self.camera_faults: set[str] = set()
        """Those that are on now."""
        self.happened: list[str] = []
        """What went wrong so far, with the virtual time."""
        if settings.bootloader:
            for i in self.places:
                twin.power_cycle(i, bootloader=True)
        self._twin = twin
        self._speed = settings.speed
        self._first = settings.first
        self.real: RealTimeTwin | None = None

    @property
    def time_s(self) -> float:
        """The twin's time."""
        return self._twin.time_s if self.real is None else self.real.time_s

    async def open(self) -> None:
        """Listens, and starts the clock."""
        loop = asyncio.get_running_loop()
        try:
            for listener in self.listeners:
                await listener.open()
        except BaseException:
            self.close()
            raise
        buses = [bus_of(*place) for place in self.places.values()]
        try:
            self.real = RealTimeTwin(self._twin, self._speed, buses, self._first)
        except BaseException:
            self.close()
            raise
        loop.add_reader(self.real.fileno(), self._take)
        self._follow_schedule()

    def close(self) -> None:
        """Hangs up and stops the clock."""
        for listener in self.listeners:
            listener.close()
        for timer in (self._flush, self._schedule_timer):
            if timer is not None:
                timer.cancel()
        if self.real is not None:
            asyncio.get_running_loop().remove_reader(self.real.fileno())
            self.real.close()

    def report(self) -> dict[str, Any]:
        """Lateness and traffic so far."""
        late = self.real.lateness() if self.real is not None else None
        paced = {} if late is None else asdict(late) | {"share_kept": late.share_kept, "first": self._first}
        return {"time_s": self.time_s, **paced, **asdict(self.traffic), "happened": list(self.happened)}

    def told(self, report: dict[str, Any]) -> str:
        """A `report` of this server as a few lines of text."""
        return counts_text(report) if self.real is None else paced_text(report)

    def look(self) -> Look:
        """What a camera sees now."""
        if self.real is None:
            return Look(self.time_s, TwinScene(self._twin).lit_mm())
        with self.real.held() as twin:
            return Look(twin.time_s, TwinScene(twin).lit_mm())

    def faults(self) -> frozenset[str]:
        """Of the camera, those that are on now."""
        return frozenset(self.camera_faults)

    # from hosts to positioners

    def to_positioners(self, listener: _Listener, port: Port, frame: Frame) -> None:
        """A frame of the host: through the wire's queue to the positioners of this port."""
        self.traffic.frames_in += 1
        now_s = self.time_s
        arrives_s = port.wire.offer(len(frame.data), now_s)
        if arrives_s is None:
            full = not port.wire.cut
            self.traffic.overflowed += full
            port.overrun = port.overrun or full
            return
        if not self._inbox:  # all that one read of the socket brings goes over together
            asyncio.get_running_loop().call_soon(self._post)
        self._inbox.append((frame.id, frame.data, bus_of(listener.number, port.number), arrives_s))

    def _post(self) -> None:
        posted, self._inbox = self._inbox, []
        if self.real is not None:
            self.real.post(posted)

    # from positioners to hosts

    def _take(self) -> None:
        assert self.real is not None
        for reply in self.real.take():
            device, number = self.places[reply.id >> 18]
            listener = self.listeners[device]
            self._send_back(listener, listener.device.ports[number], reply)
        self._write_due()

    def _send_back(self, listener: _Listener, port: Port, reply: Reply) -> None:
        seen_s = port.wire.carry(len(reply.data), reply.time_s)
        if seen_s is None or port.bus_off or not port.running or not port.passes(reply.id):
            return
        delay_s = self._delay_s()
        if delay_s is None:
            self.traffic.lost += 1
            return
        self.traffic.late += delay_s > 0.0
        self._order += 1
        heapq.heappush(self._heap, _Outgoing(seen_s + delay_s, self._order, listener, port, reply))

    def _delay_s(self) -> float | None:
        """Of one reply: None when it is lost."""
        delay_s = 0.0
        for fault in self._on_replies:
            if self._rng.random() < fault.share:
                if fault.kind == ServiceKind.LOST:
                    return None
                delay_s += fault.late_s
        return delay_s

    def _write_due(self) -> None:
        """Writes what has come over the wire by now, and sees to the rest when it is time."""
        if self._flush is not None:
            self._flush.cancel()
            self._flush = None
        now_s = self.time_s
        while self._heap and self._heap[0].time_s <= now_s:
            out = heapq.heappop(self._heap)
            if out.port.running:
                self.traffic.frames_out += 1
                out.listener.write(frame_to_line(out.port.number, Frame(out.reply.id, out.reply.data)))
        if self._heap:
            wait_s = max(self._heap[0].time_s - now_s, 1e-3) / self._speed
            self._flush = asyncio.get_running_loop().call_later(wait_s, self._write_due)

    # what goes wrong

    def _follow_schedule(self) -> None:
        now_s = self.time_s
        while self._due and self._due[0][0] <= now_s:
            _, begins, fault = self._due.pop(0)
            self._apply(fault, begins)
            self.happened.append(f"{now_s:.1f} s: {fault}{'' if begins else ' ends'}")
        if self._due and np.isfinite(self._due[0][0]):
            wait_s = (self._due[0][0] - now_s) / self._speed
            self._schedule_timer = asyncio.get_running_loop().call_later(wait_s, self._follow_schedule)

    def _apply(self, fault: ScheduledFault, begins: bool) -> None:
        if fault.kind in SHARES:
            (self._on_replies.append if begins else self._on_replies.remove)(fault)
        elif fault.kind == ServiceKind.BUS_OFF:
            device = self.listeners[fault.place[0]].device
            port = device.ports[fault.place[1]]
            port.wire.cut = begins
            if begins:
                device.break_down(port)
        elif fault.kind == ServiceKind.CUT:
            self.listeners[fault.place[0]].cut(begins)
        elif fault.kind == ServiceKind.POWER_CUT:
            self._cut_power(fault.positioner_id, begins)
        elif fault.kind in set(CameraFaultKind):
            (self.camera_faults.add if begins else self.camera_faults.discard)(fault.kind)
        else:
            self._break(fault, begins)

    def _break(self, fault: ScheduledFault, begins: bool) -> None:
        assert self.real is not None
        with self.real.held() as twin:
            (twin.inject if begins else twin.clear)(fault.fault)

    def _cut_power(self, positioner_id: int, begins: bool) -> None:
        """Off: the firmware loses its memory; no field, no ears, no voice. On: it starts anew."""
        assert self.real is not None
        with self.real.held() as twin:
            for kind in _NO_POWER:
                (twin.inject if begins else twin.clear)(Fault(kind, positioner_id))
            twin.power_cycle(positioner_id, bootloader=True)


def bus_of(device: int, port: int) -> int:
    """Number of the bus at a port (1 to 4) of a device (from 0)."""
    return device * len(PORTS) + port - 1
