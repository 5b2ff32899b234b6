"""What an NT 420 says to a host: lines, ports, filters, and the wire behind them."""

import random
import re
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fiberloom.bus.identifier import encode
from fiberloom.bus.protocol import frame_s
from fiberloom.bus.transport import Frame
from fiberloom.twin.server.device import LINE_BYTES, Device, LineReader
from fiberloom.twin.server.wire import DEAD_FRAME_S, Wire

ANSWER = re.compile(
    r"R ok|R ERR \d{1,2} [ -~]+|R CAN@net NT 420|R V[\d.]+|R CAN CAN CAN CAN"
    r"|R CAN [1-4] [B-][E-][O-][T-][I-] \d{1,3}|E [1-4] (BUSOFF|ERRORWARNING SET)"
)
OPEN = ("STOP", "INIT STD 1000", "FILTER CLEAR", "FILTER ADD EXT 00000000 00000000", "START")


class Talk:
    """A device, what it said, and the frames it passed on."""

    def __init__(self):
        self.now_s = 0.0
        self.said, self.frames = [], []
        self.device = Device(lambda port, frame: self.frames.append((port.number, frame)), lambda: self.now_s)
        self.device.say = self.said.append

    def ask(self, line):
        before = len(self.said)
        self.device.take(line.encode() + b"\n")
        return self.said[before:]

    def open(self, ports=(1, 2, 3, 4)):
        return [self.ask(f"CAN {n} {line}") for line in OPEN for n in ports]


def test_the_conversation_of_jaeger():
    talk = Talk()
    assert talk.open() == [["R ok"]] * 20
    assert talk.ask("DEV IDENTIFY") == ["R CAN@net NT 420"]
    assert talk.ask("DEV VERSION") == ["R V6.00.04"]
    assert talk.ask("CAN 3 STATUS") == ["R CAN 3 ----- 100"]
    assert talk.ask("M 3 CED 00040C10 01 FF") == []
    assert talk.frames == [(3, Frame(encode(1, 3, 1), b"\x01\xff"))]
    assert talk.ask("CAN 3 STOP") == ["R ok"]
    assert talk.ask("CAN 3 STATUS") == ["R CAN 3 ----I 100"]
    assert talk.ask("M 3 CED 00040C10") == []  # a stopped port discards
    assert len(talk.frames) == 1


@pytest.mark.parametrize(
    ("line", "number"),
    [
        ("HELLO", 0),
        ("M", 0),
        ("M 1 CER 00040C10 dlc=05", 0),
        ("M 1 FED 00040C10 01", 0),
        ("CAN", 16),
        ("CAN 1", 16),
        ("CAN 1 DANCE", 16),
        ("CAN 5 START", 12),
        ("CAN x START", 12),
        ("CAN 2 START", 10),  # not initialised
        ("CAN 2 STATUS", 10),
        ("CAN 1 INIT STD 1000", 10),  # runs
        ("CAN 2 INIT STD 250", 1),
        ("CAN 2 INIT AUTO 5", 11),
        ("CAN 1 FILTER", 14),
        ("CAN 1 FILTER ADD EXT 0", 14),
        ("CAN 1 FILTER ADD FOO 0 0", 9),
        ("CAN 1 FILTER ADD EXT 20000000 0", 7),
        ("CAN 1 FILTER ADD STD 800 0", 7),
        ("CAN 1 FILTER ADD EXT zz 0", 7),
        ("DEV", 17),
        ("DEV RESTART", 0),
        ("CYC INIT 1", 27),
        ("M 1 CED " + "0" * 300, 0),
    ],
)
def test_what_makes_no_sense_is_refused_with_the_number_of_the_manual(line, number):
    talk = Talk()
    talk.open(ports=(1,))
    (answer,) = talk.ask(line)
    assert answer.startswith(f"R ERR {number} "), answer
    assert ANSWER.fullmatch(answer)
    assert talk.frames == []
    assert talk.ask("CAN 1 STATUS") == ["R CAN 1 ----- 100"]  # nothing has changed


def test_case_and_line_ends_do_not_matter():
    talk = Talk()
    talk.device.take(b"dev identify\rDEV IDENTIFY\r\n\n\nDev Identify\n")
    assert talk.said == ["R CAN@net NT 420"] * 3


def test_filters_let_through_what_they_name():
    talk = Talk()
    for line in ("INIT STD 1000", "FILTER CLEAR", "START"):
        talk.ask(f"CAN 1 {line}")
    port = talk.device.ports[1]
    assert not port.passes(0x1234)  # a cleared list passes nothing
    talk.ask("CAN 1 FILTER ADD STD 0 0")
    assert not port.passes(0x1234)  # that one is for standard frames
    talk.ask("CAN 1 FILTER ADD EXT 10003344 1F00FFFF")
    assert port.passes(0x10AB3344)
    assert not port.passes(0x11AB3344)
    talk.ask("CAN 1 FILTER ADD EXT 00000000 00000000")
    assert port.passes(0x11AB3344)


def test_a_wrong_bit_rate_takes_the_port_off_the_bus():
    talk = Talk()
    for line in ("INIT STD 500", "START"):
        talk.ask(f"CAN 1 {line}")
    assert talk.ask("M 1 CED 00040C10") == ["E 1 ERRORWARNING SET", "E 1 BUSOFF"]
    assert talk.frames == []
    assert talk.ask("CAN 1 STATUS") == ["R CAN 1 BE--- 100"]
    talk.open(ports=(1,))  # a new beginning
    assert talk.ask("M 1 CED 00040C10") == []
    assert len(talk.frames) == 1


# lines at random: the device says what is legal, and stays what it was

VERBS = st.sampled_from(["CAN", "DEV", "M", "CYC", "FILTER", "ADD", "CLEAR", "IDENTIFY", "START", "STOP"])
NOUNS = st.sampled_from(["1", "2", "4", "5", "STATUS", "INIT", "STD", "EXT", "1000", "250", "CED", "FED"])
ODD = st.sampled_from(["00040C10", "FFFFFFFF", "0", "dlc=05", "-1", "0x1", "é", "ok", "CSD"])
WORDS = VERBS | NOUNS | ODD
LINES = st.one_of(
    st.lists(WORDS, max_size=7).map(" ".join),
    st.text(max_size=60),
    st.text("0123456789ABCDEF ", max_size=30).map("M 1 CED {}".format),
)


@given(st.lists(LINES, max_size=20))
def test_any_lines_get_legal_answers_and_only_legal_frames(lines):
    talk = Talk()
    talk.open(ports=(1, 3))
    talk.device.take("\n".join(lines).encode("utf-8", "replace") + b"\n")
    assert all(ANSWER.fullmatch(said) for said in talk.said), talk.said
    assert all(0 <= frame.id < 1 << 29 and len(frame.data) <= 8 for _, frame in talk.frames)
    assert talk.ask("DEV IDENTIFY") == ["R CAN@net NT 420"]


@given(st.binary(max_size=400), st.lists(st.integers(0, 400), max_size=6))
def test_any_bytes_are_cut_into_the_same_lines_however_they_come(data, cuts):
    data += b"\nDEV VERSION\n"
    edges = [0, *sorted(min(c, len(data)) for c in cuts), len(data)]
    reader = LineReader()
    pieces = [line for a, b in pairwise(edges) for line in reader.feed(data[a:b])]
    assert pieces == list(LineReader().feed(data))
    assert pieces[-1] == "DEV VERSION"


def test_a_huge_line_costs_nothing_and_is_one_refusal():
    talk = Talk()
    for _ in range(100):
        talk.device.take(b"x" * 10_000)
    assert talk.said == []
    assert len(talk.device._reader._rest) <= LINE_BYTES
    assert talk.ask("")[0].startswith("R ERR 0 line too long")
    assert talk.ask("DEV VERSION") == ["R V6.00.04"]


# the wire


def test_a_queue_of_100_behind_the_frame_on_the_wire():
    wire = Wire()
    arrivals = [wire.offer(8, 1.0) for _ in range(150)]
    taken = [a for a in arrivals if a is not None]
    assert len(taken) == 101
    assert wire.overflows == 49
    # one after the other, at 1 Mbit/s: 0.13 ms and some stuffing each
    assert taken[-1] - 1.0 == pytest.approx(101 * frame_s(8))
    assert 1.3e-4 < frame_s(8) < 1.6e-4
    assert wire.queued(1.0 + 50.5 * frame_s(8)) == 50
    assert wire.offer(0, 1.0 + 50.5 * frame_s(8)) is not None


def test_both_directions_share_the_wire():
    wire = Wire()
    first = wire.offer(8, 0.0)
    answer = wire.carry(4, first)
    assert answer == pytest.approx(frame_s(8) + frame_s(4))
    assert wire.offer(0, 0.0) == pytest.approx(answer + frame_s(0))


def test_on_a_cut_wire_frames_leave_the_queue_one_in_10_ms_and_arrive_nowhere():
    wire = Wire()
    wire.cut = True
    assert [wire.offer(8, 0.0) for _ in range(50)] == [None] * 50
    assert wire.overflows == 0
    assert wire.queued(10.5 * DEAD_FRAME_S) == 39
    assert wire.carry(8, 0.0) is None


GOOD_LINES = (
    b"CAN 1 START\n",
    b"M 1 CED 00040C10 01 02\n",
    b"CAN 3 FILTER ADD EXT 10003344 1F00FFFF\n",
    b"DEV IDENTIFY\r\n",
    b"CAN 2 INIT STD 1000\n",
    b"CAN 4 STATUS\r",
    b"M 4 CED 1FFFFFFF 00 11 22 33 44 55 66 77\n",
)


def mutated(rng, line):
    """A good line with some bytes changed, doubled, lost or put in."""
    line = bytearray(line)
    for _ in range(rng.randrange(5)):
        at = rng.randrange(len(line) + 1)
        match rng.randrange(4):
            case 0:
                line[at:at] = bytes([rng.randrange(256)])
            case 1:
                del line[at : at + rng.randrange(4)]
            case 2:
                line[at : at + 1] = bytes([rng.randrange(256)])
            case _:
                line[at:at] = rng.choice(GOOD_LINES)[: rng.randrange(20)]
    return bytes(line)


def test_twenty_thousand_mutated_lines():
    rng, talk = random.Random(0), Talk()
    talk.open()
    for _ in range(20_000):
        talk.device.take(mutated(rng, rng.choice(GOOD_LINES)))
    assert all(ANSWER.fullmatch(said) for said in talk.said)
    assert all(0 <= frame.id < 1 << 29 and len(frame.data) <= 8 for _, frame in talk.frames)
    assert len(talk.frames) > 1000  # they do not all end at the first letter
    talk.device.take(b"\n")
    assert talk.ask("DEV VERSION") == ["R V6.00.04"]
