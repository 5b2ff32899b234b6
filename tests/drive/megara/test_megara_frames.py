"""Frames of MEGARA's messages: golden bytes, there and back, any bytes."""

import contextlib

import pytest
from hypothesis import given
from hypothesis import strategies as st

from fiberloom.drive.megara import MegaraCommand, MegaraFrame, decode_goal, decode_state, goal_frames
from fiberloom.drive.megara.frames import (
    RotorState,
    ToldState,
    command_of,
    decode_number,
    number_frame,
    state_frame,
)
from fiberloom.errors import InputError

steps = st.integers(-(2**31) + 1, 2**31 - 1)


def test_golden_bytes():
    first, second = goal_frames({92: (40685, -1159)})
    assert (first.identifier, first.data.hex()) == (0x171, "0100009eed")
    assert (second.identifier, second.data.hex()) == (0x172, "01fffffb79")
    assert MegaraFrame.of(0, 0, MegaraCommand.START) == (0, b"\x02")
    told = state_frame(5, 2, ToldState(RotorState.MOVING, -3))
    assert (told.identifier, told.data.hex()) == (0x16, "0402fffffffd")
    named = number_frame(92, 0, MegaraCommand.IDENTIFY, 92)
    assert (named.identifier, named.data.hex()) == (0x170, "060000005c")
    slip = number_frame(92, 1, MegaraCommand.SLIP, -40)
    assert (slip.identifier, slip.data.hex(), decode_number(slip)) == (0x171, "07ffffffd8", -40)


@given(st.integers(1, 511), steps, steps, st.sampled_from(RotorState))
def test_there_and_back(robot, r1, r2, state):
    frames = goal_frames({robot: (r1, r2)})
    assert [(f.robot, f.rotor, decode_goal(f)) for f in frames] == [(robot, 1, r1), (robot, 2, r2)]
    assert decode_state(state_frame(robot, 1, ToldState(state, r1))) == (state, r1)


@given(st.integers(-1, 2**16 + 3), st.binary(max_size=9))
def test_any_bytes_are_read_or_refused(identifier, data):
    for decode in (command_of, decode_goal, decode_state, decode_number):
        with contextlib.suppress(InputError):
            decode(MegaraFrame(identifier, data))


@pytest.mark.parametrize(
    ("decode", "frame", "match"),
    [
        (command_of, MegaraFrame(7, b"\x01"), "no frame of ours"),
        (command_of, MegaraFrame(5, b"\x09"), "robot 1: command 9"),
        (decode_goal, MegaraFrame(5, b"\x01\x00"), "no goal of 5 bytes"),
        (decode_state, MegaraFrame(5, b"\x04\x09\x00\x00\x00\x00"), "no state of 6 bytes"),
        (decode_number, MegaraFrame(5, b"\x07\x00"), "no number of 5 bytes"),
    ],
)
def test_what_contradicts_itself_is_refused(decode, frame, match):
    with pytest.raises(InputError, match=match):
        decode(frame)


@pytest.mark.parametrize(("robot", "rotor"), [(16384, 1), (-1, 1), (1, 3)])
def test_robots_and_rotors_that_do_not_fit_are_refused(robot, rotor):
    with pytest.raises(InputError, match="0 to 16383 and 0 to 2 fit"):
        MegaraFrame.of(robot, rotor, MegaraCommand.GOAL)


def test_steps_that_do_not_fit_are_refused():
    with pytest.raises(InputError, match="31 bits fit"):
        goal_frames({1: (2**31, 0)})
