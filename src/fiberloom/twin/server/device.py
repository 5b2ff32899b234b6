"""What a CAN@net NT 420 says: its lines, its ports, its answers. No sockets, no clock of its own.

A line is a command to the device (`CAN 1 START`, `DEV VERSION`) or a frame for a port
(`M 1 CED 00040C10 01 02`). Commands are answered by `R ok`, by what was asked, or by
`R ERR <number> <text>`; frames are not answered. Case does not matter.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field

from fiberloom.bus.cannet import BITRATES_KBIT, line_to_frame
from fiberloom.bus.protocol import BITRATE_KBIT
from fiberloom.bus.transport import Frame
from fiberloom.twin.server.wire import QUEUE_FRAMES, Wire

PORTS = (1, 2, 3, 4)
LINE_BYTES = 256
"""Longer lines are thrown away: the longest frame needs 43."""
FILTERS = 128
"""Places in the filter list of a port (assumed)."""

OK = "R ok"


class Refusal(Exception):
    """An answer `R ERR`; numbers as the device lists them, in our words."""

    def __init__(self, number: int, text: str) -> None:
        super().__init__(f"R ERR {number} {text}")


class LineReader:
    """Cuts a stream of bytes into lines, whatever comes: \\n, \\r or \\r\\n end one."""

    def __init__(self) -> None:
        self._rest = b""
        self._too_long = False

    def feed(self, data: bytes) -> Iterator[str | None]:
        """The lines that are complete, without their ends and never empty; None for one too long."""
        *lines, rest = (self._rest + data.replace(b"\r", b"\n")).split(b"\n")
        for line in lines:
            too_long, self._too_long = self._too_long or len(line) > LINE_BYTES, False
            if too_long:
                yield None
            elif text := line.decode("ascii", "replace").strip():
                yield text
        self._too_long = self._too_long or len(rest) > LINE_BYTES
        self._rest = b"" if self._too_long else rest


@dataclass
class Port:
    """One CAN controller and its wire."""

    number: int
    wire: Wire = field(default_factory=Wire)
    bitrate_kbit: float = 0.0  # 0: not initialised
    running: bool = False
    bus_off: bool = False
    warning: bool = False
    overrun: bool = False
    filters: list[tuple[int, int]] = field(default_factory=list)

    def reset(self) -> None:
        """As after the device has restarted."""
        self.bitrate_kbit, self.running = 0.0, False
        self.filters = []
        self.stop()

    def stop(self) -> None:
        """Off the bus, errors and queue forgotten; bit rate and filters stay."""
        self.running = self.bus_off = self.warning = self.overrun = False
        self.wire.clear()

    def passes(self, identifier: int) -> bool:
        """True when a filter lets an extended frame through to the host."""
        return any((identifier ^ wanted) & mask == 0 for wanted, mask in self.filters)

    def status(self, now_s: float) -> str:
        """`R CAN n BEOTI free`."""
        queued = self.wire.queued(now_s)
        bits = (self.bus_off, self.warning, self.overrun, queued > 0, not self.running)
        letters = "".join(c if on else "-" for c, on in zip("BEOTI", bits, strict=True))
        return f"R CAN {self.number} {letters} {max(QUEUE_FRAMES - queued, 0)}"


class Device:
    """An NT 420 with one host. `on_frame(port, frame)` gets what the host wants on a running port."""

    def __init__(self, on_frame: Callable[[Port, Frame], None], clock: Callable[[], float]) -> None:
        self.ports = {number: Port(number) for number in PORTS}
        self.say: Callable[[str], None] = lambda line: None
        """Where answers and events go."""
        self._on_frame = on_frame
        self._clock = clock
        self._reader = LineReader()

    def restart(self) -> None:
        """The host has gone: ports stop, filters are forgotten."""
        self._reader = LineReader()
        for port in self.ports.values():
            port.reset()

    def take(self, data: bytes) -> None:
        """Bytes from the host."""
        for line in self._reader.feed(data):
            try:
                answer = self._obey(line)
            except Refusal as refusal:
                answer = str(refusal)
            if answer:
                self.say(answer)

    def break_down(self, port: Port) -> None:
        """The controller has counted too many errors: it leaves the bus and says so."""
        if port.bus_off or not port.running:
            return
        port.bus_off = port.warning = True
        self.say(f"E {port.number} ERRORWARNING SET")
        self.say(f"E {port.number} BUSOFF")

    def _obey(self, line: str | None) -> str:
        if line is None:
            raise Refusal(0, "line too long")
        words = line.upper().split()
        match words[0]:
            case "M":
                return self._carry(line)
            case "DEV":
                return _about_device(words[1:])
            case "CAN":
                return self._command(words[1:])
            case "CYC":
                raise Refusal(27, "cyclic messages are not in this device")
        raise Refusal(0, "unknown command")

    def _carry(self, line: str) -> str:
        parsed = line_to_frame(line)
        if parsed is None:
            raise Refusal(0, "not a classic extended data frame")
        port = self.ports[parsed[0]]
        if not port.running:
            return ""
        if port.wire.cut or port.bitrate_kbit != BITRATE_KBIT:
            self.break_down(port)
        if not port.bus_off:
            self._on_frame(port, parsed[1])
        return ""

    def _command(self, words: list[str]) -> str:
        if not words:
            raise Refusal(16, "CAN parameter is missing")
        if words[0] not in map(str, PORTS):
            raise Refusal(12, "invalid port number")
        if len(words) < 2:
            raise Refusal(16, "CAN parameter is missing")
        port, rest = self.ports[int(words[0])], words[2:]
        match words[1]:
            case "STOP":
                port.stop()
            case "RESET":
                port.stop()
            case "INIT":
                _initialise(port, rest)
            case "START":
                if not port.bitrate_kbit:
                    raise Refusal(10, "invalid CAN state: not initialised")
                port.running = True
            case "FILTER":
                _filter(port, rest)
            case "STATUS":
                if not port.bitrate_kbit:
                    raise Refusal(10, "invalid CAN state: not initialised")
                return port.status(self._clock())
            case _:
                raise Refusal(16, "unknown CAN command")
        return OK


def _about_device(words: list[str]) -> str:
    answers = {
        "IDENTIFY": "R CAN@net NT 420",
        "VERSION": "R V6.00.04",
        "PROTOCOL": "R V2.1",
        "INTERFACES": "R CAN CAN CAN CAN",
    }
    if not words:
        raise Refusal(17, "DEV parameter is missing")
    if words[0] not in answers:
        raise Refusal(0, "unknown DEV command")
    return answers[words[0]]


def _initialise(port: Port, words: list[str]) -> None:
    if port.running:
        raise Refusal(10, "invalid CAN state: running")
    if len(words) < 2 or words[0] != "STD":
        raise Refusal(11, "only INIT STD <kbit/s>")
    rates = {f"{rate:g}": float(rate) for rate in BITRATES_KBIT}
    if words[1] not in rates:
        raise Refusal(1, "invalid baudrate")
    port.stop()
    port.bitrate_kbit = rates[words[1]]


def _filter(port: Port, words: list[str]) -> None:
    if words == ["CLEAR"]:
        port.filters = []
        return
    if len(words) != 4 or words[0] != "ADD":
        raise Refusal(14, "filter parameter is missing")
    if words[1] not in ("STD", "EXT"):
        raise Refusal(9, "invalid parameter type")
    limit = 1 << (29 if words[1] == "EXT" else 11)
    try:
        wanted, mask = (int(word, 16) for word in words[2:])
    except ValueError:
        raise Refusal(7, "invalid identifier or mask") from None
    if not (0 <= wanted < limit and 0 <= mask < limit):
        raise Refusal(7, "invalid identifier or mask")
    if len(port.filters) >= FILTERS:
        raise Refusal(4, "filter is full")
    if words[1] == "EXT":  # positioners send nothing else
        port.filters.append((wanted, mask))
