"""Bytes that were damaged on their way: MOONS' gateways, MEGARA's frames and programmes, LAMOST's packets.

Host and controllers read, refuse by InputError, or pass over; nothing else. What comes whole is heard then.
"""

import numpy as np
import pytest
from mutations import mutated, seed_of

import fiberloom as fl
from fiberloom.drive.lamost.packets import decoded
from fiberloom.drive.lamost.radio import packet_of
from fiberloom.drive.megara import MoveProgramme, read_programme
from fiberloom.drive.megara.frames import (
    MegaraCommand,
    MegaraFrame,
    RotorState,
    ToldState,
    command_of,
    decode_goal,
    decode_number,
    decode_state,
    goal_frames,
    state_frame,
)
from fiberloom.drive.moons.frames import (
    DLE,
    ETX,
    MoonsAnswer,
    MoonsCommand,
    MoonsError,
    MoonsFrame,
    MoonsState,
    PacketReader,
    Segment,
    UnitPlace,
    command_frame,
    decode_answer,
    decode_segment,
    packed,
    segment_data,
)
from fiberloom.errors import InputError
from fiberloom.twin.steppers.array import StepperArray
from fiberloom.twin.steppers.megara import MegaraBus
from fiberloom.twin.steppers.moons import MoonsBus

EACH = 200
MOONS = fl.FocalPlane.of("moons", seed=0, n=3)
MEGARA = fl.FocalPlane.of("megara", seed=0, n=3)


def damaged(name, valid):
    """Mutations of bytes by number: the same each time. A line is not endless: 2000 bytes at most."""
    return (mutated(valid, np.random.default_rng(seed_of(name, k)))[:2000] for k in range(EACH))


def tried(call, *arguments):
    """What a reader makes of it; None: refused, in one line."""
    refused = ""
    try:
        return call(*arguments)
    except InputError as error:
        refused = str(error)
    assert refused
    assert "\n" not in refused
    return None


def answers():
    """A stream as gateways send it."""
    one = MoonsAnswer(7, MoonsCommand.PING, 5, MoonsState.RESTING, MoonsError.NONE, (-9000, 16))
    frames = [MoonsFrame(bus, 1 << 7 | 16, one._replace(sequence=16 * bus).data()) for bus in range(4)]
    return b"".join(map(packed, frames))


def test_a_host_reads_damaged_answers_of_moons_or_passes_over_them():
    whole = packed(MoonsFrame(2, 1 << 7 | 3, MoonsAnswer(1, MoonsCommand.PING, 0, *_GOOD).data()))
    for stream in damaged("moons.answers", answers()):
        reader = PacketReader()
        for frame in reader.feed(stream):
            assert len(frame.data) == 8
            tried(decode_answer, frame)
            tried(decode_segment, frame.data)
        # whatever came before: after the end of a packet the next one is heard
        assert (
            reader.feed(bytes([0, DLE, ETX]) + whole)[-1].data
            == MoonsAnswer(1, MoonsCommand.PING, 0, *_GOOD).data()
        )


_GOOD = (MoonsState.AT_DATUM, MoonsError.NONE, (-10000, 0))


def test_controllers_of_moons_stay_alive_under_damaged_commands():
    """Waveforms, starts, aborts and searches with wrong bytes; then a unit still answers."""
    place = UnitPlace.of(int(MOONS.positioner_id[0]))
    commands = [(MoonsCommand.FIND_DATUM, b"\0"), (MoonsCommand.ENABLE_MOVE, b"")]
    flags = Segment.FIRST | Segment.LAST | Segment.REPLY
    commands += [(MoonsCommand.CONFIG_MOTION, segment_data((62, -62), flags)), (MoonsCommand.EXECUTE, b"")]
    commands += [(MoonsCommand.REVERSE, b""), (MoonsCommand.EXECUTE, b""), (MoonsCommand.FREE_BETA, b"\1")]
    stream = b"".join(packed(command_frame(place, k, *one)) for k, one in enumerate(commands))
    bus = MoonsBus(StepperArray(MOONS, seed=0, contacts=False))
    ping = packed(command_frame(place, 9, MoonsCommand.PING))
    for bytes_ in damaged("moons.commands", stream):
        for _, data in bus.take(place.gateway, bytes_) + bus.run(0.3):
            assert all(decode_answer(frame) for frame in PacketReader().feed(data))
        # the end of a packet that was cut off, then a whole one
        heard = bus.take(place.gateway, bytes([0, DLE, ETX]) + ping)
        assert any(decode_answer(f).sequence == 9 for _, data in heard for f in PacketReader().feed(data))
    low, high = MOONS.instrument.alpha.hard_stop_deg
    assert (bus.array.truth()[:, 0] > low).all()
    assert (bus.array.truth()[:, 0] < high).all()


def frames_of(content):
    """MEGARA's frames: a byte of length, two of identifier, then data; the last may be cut off."""
    at = 0
    while at < len(content):
        size = content[at] % 12
        data = content[at + 3 : at + 3 + size]
        yield MegaraFrame(int.from_bytes(content[at + 1 : at + 3], "big"), data)
        at += 3 + size


def carried(frames):
    return b"".join(bytes([len(f.data)]) + f.identifier.to_bytes(2, "big") + f.data for f in frames)


def test_frames_of_megara_are_read_or_refused_and_robots_go_on_answering():
    robot = int(MEGARA.positioner_id[0])
    frames = [MegaraFrame.of(robot, rotor, MegaraCommand.HOME) for rotor in (1, 2)]
    frames += goal_frames({robot: (1000, -500)})
    frames += [
        MegaraFrame.of(0, 0, MegaraCommand.START),
        state_frame(robot, 1, ToldState(RotorState.STILL, 7)),
    ]
    bus = MegaraBus(StepperArray(MEGARA, seed=0, contacts=False))
    for content in damaged("megara.frames", carried(frames)):
        given = list(frames_of(content))
        for frame in given:
            for read in (command_of, decode_goal, decode_state, decode_number):
                tried(read, frame)
        for reply in bus.send(given):
            command_of(reply)
        bus.run(0.3)
        assert len(bus.send([MegaraFrame.of(robot, 0, MegaraCommand.STATE)])) == 2


def test_packets_of_lamost_are_read_or_refused():
    """One wrong byte is always found: by length or checksum."""
    packet = packet_of(17, b"\x01\x00\x00\x03\xe8")
    for content in damaged("lamost.packet", packet):
        tried(decoded, content)
    for k in range(len(packet)):
        for wrong in (0x01, 0x80):
            one = bytearray(packet)
            one[k] ^= wrong
            assert tried(decoded, bytes(one)) is None
    assert decoded(packet).message == b"\x01\x00\x00\x03\xe8"


@pytest.mark.parametrize("encoding", ["utf-8", "latin-1"])
def test_programmes_of_megara_are_read_or_refused_in_one_line(encoding):
    text = MoveProgramme(({1: (40685, -12), 2: (0, 0)}, {1: (5, -300)})).text()
    assert read_programme(text).ends() == {1: (5, -300), 2: (0, 0)}
    for content in damaged(f"megara.programme.{encoding}", text.encode()):
        tried(read_programme, content.decode(encoding, errors="replace"))
