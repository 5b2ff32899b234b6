"""Frames that carry MEGARA's messages: CAN, identifier = robot x 4 + rotor, data of at most 8 bytes.

[A] All of it is our own: what is below the programme of moves is not public. Identifier 0 is for all robots,
rotor 0 for both rotors of one. Numbers are big-endian.
"""

from __future__ import annotations

from collections.abc import Mapping
from enum import IntEnum
from typing import NamedTuple

from fiberloom.drive.megara.programme import MOST_STEPS
from fiberloom.errors import InputError

MOST_ROBOT = 2**14 - 1
"""Identifiers of 16 bits; those of CAN's 11 bits, which MEGARA has, go up to 511."""
_GOAL_BYTES, _STATE_BYTES, _NUMBER_BYTES = 5, 6, 5


class MegaraCommand(IntEnum):
    """First byte of the data."""

    GOAL = 1
    """And i32 steps from home."""
    START = 2
    """All that have a goal go together."""
    HOME = 3
    """Search of the home switch."""
    STATE = 4
    """Asks; the answer has a `RotorState` and i32 steps as counted."""
    STOP = 5
    """Stands still, and drops a goal that it has."""
    IDENTIFY = 6
    """Asks; the answer has the i32 number of the robot itself, whatever place it is plugged in."""
    SLIP = 7
    """Asks; the answer has i32 steps as counted when the home switch was met last."""


class RotorState(IntEnum):
    """Of a rotor, in the answer to STATE."""

    UNKNOWN = 0
    """Power came on; not homed since."""
    STILL = 1
    MOVING = 2
    NO_SWITCH = 3
    """The search has ended without its switch."""


class MegaraFrame(NamedTuple):
    """One frame."""

    identifier: int
    data: bytes

    @classmethod
    def of(cls, robot: int, rotor: int, command: MegaraCommand, data: bytes = b"") -> MegaraFrame:
        """A frame to or from a rotor.

        `robot`: its number, 0: all; `rotor`: 1 or 2, 0: both; `command`, and at most 7 bytes of `data`.
        InputError for one that does not fit.
        """
        if not 0 <= robot <= MOST_ROBOT or rotor not in (0, 1, 2):
            raise InputError(f"megara: robot {robot}, rotor {rotor}; 0 to {MOST_ROBOT} and 0 to 2 fit")
        if len(data) > 7:
            raise InputError(f"megara: robot {robot}: {len(data)} bytes; at most 7 fit")
        return cls(robot << 2 | rotor, bytes([command]) + data)

    @property
    def robot(self) -> int:
        """Whose it is; 0: all."""
        return robot_of(self.identifier)

    @property
    def rotor(self) -> int:
        """1 or 2; 0: both."""
        return self.identifier & 3


def robot_of(identifier: int) -> int:
    """The robot of an identifier; 0: all."""
    return identifier >> 2


class ToldState(NamedTuple):
    """What a rotor answers."""

    state: RotorState
    steps: int
    """As counted from home: it does not know of steps that it lost."""


def goal_frames(group: Mapping[int, tuple[int, int]]) -> list[MegaraFrame]:
    """One message for each rotor of a group: its goal in steps."""
    return [
        MegaraFrame.of(robot, rotor, MegaraCommand.GOAL, _steps(steps))
        for robot, goals in group.items()
        for rotor, steps in enumerate(goals, 1)
    ]


def state_frame(robot: int, rotor: int, told: ToldState) -> MegaraFrame:
    """The answer to STATE of a `rotor` of a `robot`."""
    return MegaraFrame.of(robot, rotor, MegaraCommand.STATE, bytes([told.state]) + _steps(told.steps))


def _steps(steps: int) -> bytes:
    if abs(steps) > MOST_STEPS:
        raise InputError(f"megara: {steps} steps; 31 bits fit")
    return steps.to_bytes(4, "big", signed=True)


def number_frame(robot: int, rotor: int, command: MegaraCommand, number: int) -> MegaraFrame:
    """The answer to IDENTIFY or SLIP, the `command`, of a `rotor` of a `robot`: a `number`."""
    return MegaraFrame.of(robot, rotor, command, _steps(number))


def decode_number(frame: MegaraFrame) -> int:
    """The number in an answer to IDENTIFY or SLIP; InputError where it is none."""
    asked = command_of(frame) in (MegaraCommand.IDENTIFY, MegaraCommand.SLIP)
    if not asked or len(frame.data) != _NUMBER_BYTES:
        raise InputError(
            f"megara: robot {frame.robot}: {frame.data.hex()} is no number of {_NUMBER_BYTES} bytes"
        )
    return int.from_bytes(frame.data[1:], "big", signed=True)


def command_of(frame: MegaraFrame) -> MegaraCommand:
    """What a frame asks; InputError for one that is none of ours."""
    if not 0 <= frame.identifier < 2**16 or frame.rotor == 3 or not 0 < len(frame.data) <= 8:
        raise InputError(
            f"megara: identifier {frame.identifier:#x}, {len(frame.data)} bytes: no frame of ours"
        )
    if frame.data[0] not in MegaraCommand.__members__.values():
        raise InputError(f"megara: robot {frame.robot}: command {frame.data[0]} is not known")
    return MegaraCommand(frame.data[0])


def decode_goal(frame: MegaraFrame) -> int:
    """The steps of a GOAL; InputError where it is none."""
    if command_of(frame) is not MegaraCommand.GOAL or len(frame.data) != _GOAL_BYTES:
        raise InputError(f"megara: robot {frame.robot}: {frame.data.hex()} is no goal of {_GOAL_BYTES} bytes")
    return int.from_bytes(frame.data[1:], "big", signed=True)


def decode_state(frame: MegaraFrame) -> ToldState:
    """What a rotor has answered; InputError where that is no answer."""
    data = frame.data
    told = command_of(frame) is MegaraCommand.STATE and len(data) == _STATE_BYTES
    if not told or data[1] not in RotorState.__members__.values():
        raise InputError(f"megara: robot {frame.robot}: {data.hex()} is no state of {_STATE_BYTES} bytes")
    return ToldState(RotorState(data[1]), int.from_bytes(data[2:], "big", signed=True))
