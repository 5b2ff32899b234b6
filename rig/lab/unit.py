"""One positioner on a rig, spoken to as a host would: frames in, frames out, time passes.

The rig runs on the host or on the emulated target; the client cannot tell which, and
everything that was said is kept, so that two runs can be compared to the last bit.
"""

from __future__ import annotations

import os
import select
import struct
import subprocess
from dataclasses import dataclass, field

import numpy as np

from fiberloom._core import firmware as fw
from fiberloom.instruments import generate, load_instrument
from fiberloom.twin import draw_units
from fiberloom.twin.units import FIRMWARE_DTYPE, Units, plain

NUMBER = 5
"""The rig's positioner."""
COUNTS_PER_DEG = 2**30 / 360
TICKS_PER_S = fw.TICK_HZ
SILENCE_S = 300.0
"""A rig that says nothing for so long has died; no command takes a tenth of it."""
PARAMETERS = list(FIRMWARE_DTYPE.names or ())
SEED = 4


def drawn() -> Units:
    """A unit of the twin: backlash, non-linear gear, hall sensors and cogging of its own."""
    return draw_units(generate(load_instrument("sdssv"), seed=0, n_positioners=1), SEED)


@dataclass
class Truth:
    """What `look` says. Angles in rad, momentum in Nms, position in 2^30 per output turn."""

    theta_rad: list[float] = field(default_factory=list)
    gear_rad: list[float] = field(default_factory=list)
    output_rad: list[float] = field(default_factory=list)
    position_cnt: list[int] = field(default_factory=list)
    params: list[dict[str, float]] = field(default_factory=list)
    status: int = 0

    def position_deg(self, axis: int) -> float:
        """What the firmware reports."""
        return self.position_cnt[axis] / COUNTS_PER_DEG


@dataclass(frozen=True)
class Cost:
    """Instructions: calls, mean and most of one call (the latter as counted: within 40); bytes of stack."""

    calls: int
    mean: float
    most: int
    deepest: int


def _double(bits: str) -> float:
    return float(struct.unpack("<d", struct.pack("<Q", int(bits, 16)))[0])


def _single(bits: str) -> float:
    return float(struct.unpack("<f", struct.pack("<I", int(bits, 16)))[0])


class Unit:
    """A rig and the positioner in it; `said` is the whole conversation but for costs."""

    def __init__(self, command: list[str]) -> None:
        self._process = subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
        self._text = b""
        self._uid = 0
        self.said: list[str] = []
        self.unsolicited: list[int] = []
        self.look_deep = False

    def close(self) -> None:
        """Ends the rig; a rig that ends badly is an error."""
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.close()
        code = self._process.wait(timeout=60)
        self._process.stdout.close()
        if code != 0:
            raise RuntimeError(f"the rig ended with code {code}")

    def kill(self) -> None:
        """After a failure."""
        self._process.kill()
        self._process.wait()
        for pipe in (self._process.stdin, self._process.stdout):
            if pipe is not None:
                pipe.close()

    # -- lines ---------------------------------------------------------------------------------------

    def _line(self) -> str:
        assert self._process.stdout is not None
        out = self._process.stdout.fileno()
        while b"\n" not in self._text:
            ready, _, _ = select.select([out], [], [], SILENCE_S)
            piece = os.read(out, 65536) if ready else b""
            if not piece:
                raise RuntimeError("the rig has died" if ready else "the rig does not answer")
            self._text += piece
        line, _, self._text = self._text.partition(b"\n")
        return line.decode("ascii")

    def _answer(self, asked: str) -> list[str]:
        lines = []
        while (line := self._line()) != ".":
            if line.startswith("?"):
                raise AssertionError(f"{asked}: {line[2:]}")
            lines.append(line)
        return lines

    def tell(self, *lines: str, keep: bool = True) -> list[str]:
        """Commands of the rig, all at once; their answers one after the other."""
        assert self._process.stdin is not None
        self._process.stdin.write("".join(f"{line}\n" for line in lines).encode("ascii"))
        self._process.stdin.flush()
        answers = []
        for line in lines:
            answers += self._answer(line)
        if keep:
            self.said += [f"> {line}" for line in lines] + answers
        return answers

    # -- the unit ------------------------------------------------------------------------------------

    def begin(self, units: Units, start_deg: tuple[float, float], *, known: bool = True) -> None:
        """Makes the first of the units, its arms at these output angles, and switches it on."""
        lines = []
        for axis in (0, 1):
            for verb, row, form in (
                ("plant", plain(units.plant)[0, axis], "<d"),
                ("gear", plain(units.gear)[0, axis], "<d"),
                ("param", plain(units.firmware, np.float32)[0, axis], "<f"),
            ):
                lines += [f"{verb} {axis} {i} {_bits(value, form)}" for i, value in enumerate(row)]
            lines.append(f"start {axis} {_bits(np.deg2rad(start_deg[axis]), '<d')}")
        for k in range(0, len(lines), 64):
            self.tell(*lines[k : k + 64])
        self.tell(f"begin {SEED}")
        if self.look_deep:
            self.tell("deep 1", keep=False)
        if known:
            self.tell("place")

    def look(self) -> Truth:
        """The truth, as far as a test may know it."""
        truth = Truth()
        for line in self.tell("look"):
            word = line.split()
            if word[0] == "axis":
                truth.theta_rad.append(_double(word[2]))
                truth.gear_rad.append(_double(word[4]))
                truth.output_rad.append(_double(word[5]))
                truth.position_cnt.append(int(word[6]))
            elif word[0] == "params":
                values = [_single(bits) for bits in word[2:]]
                truth.params.append(dict(zip(PARAMETERS, values, strict=True)))
            else:
                truth.status = int(word[3], 16)
        return truth

    def cost(self) -> dict[str, Cost]:
        """Instructions in ticks, frames and power-up since the last time."""
        costs = {}
        for line in self.tell("cost", keep=False):
            _, name, calls, total, most, deepest = line.split()
            costs[name] = Cost(int(calls), int(total) / max(int(calls), 1), int(most), int(deepest))
        return costs

    # -- the bus -------------------------------------------------------------------------------------

    def _frames(self, lines: list[str]) -> list[tuple[int, int, int, bytes]]:
        replies = []
        for line in lines:
            word = line.split()
            sender, command, uid, code = fw.decode_identifier(int(word[2], 16))
            assert (word[0], sender) == ("tx", NUMBER), line
            if command == 18 and uid == 0:
                self.unsolicited.append(int(word[1]))
            else:
                replies.append((command, uid, code, bytes.fromhex(word[3] if len(word) > 3 else "")))
        return replies

    def send(self, identifier: int, data: bytes = b"") -> list[tuple[int, int, int, bytes]]:
        """Any frame; the replies as (command, uid, code, payload)."""
        return self._frames(self.tell(f"send {identifier:08x} {data.hex() or '-'}"))

    def ask(self, command: int, data: bytes = b"", *, to: int = NUMBER) -> tuple[int, bytes]:
        """Code and payload of the one reply."""
        self._uid = self._uid % 63 + 1
        replies = self.send(fw.encode_identifier(to, command, self._uid), data)
        assert [reply[:2] for reply in replies] == [(command, self._uid)], replies
        return replies[0][2], replies[0][3]

    def code(self, command: int, data: bytes = b"", *, to: int = NUMBER) -> int:
        """Code of the one reply."""
        return self.ask(command, data, to=to)[0]

    def status(self) -> int:
        """The status word, 64 bits or the bootloader's 32."""
        return int.from_bytes(self.ask(3)[1], "little")

    def run(self, ticks: int) -> None:
        """Time passes."""
        self._frames(self.tell(f"run {ticks}"))

    def rest(self, limit_s: float = 60.0) -> None:
        """Until the axes rest."""
        self._frames(self.tell(f"rest {round(limit_s * TICKS_PER_S)}"))


def _bits(value: float, form: str) -> str:
    raw = struct.pack(form, value)
    return f"{int.from_bytes(raw, 'little'):0{2 * len(raw)}x}"
