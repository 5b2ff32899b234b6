"""The 29-bit CAN identifier of the SDSS-V positioner protocol.

`positioner << 18 | command << 10 | uid << 4 | code`: 11 + 8 + 6 + 4 bits. Positioner 0 addresses
all positioners; uid 0 belongs to broadcasts; a request carries code 0.
"""

from __future__ import annotations

from typing import NamedTuple

MAX_POSITIONER = (1 << 11) - 1
MAX_COMMAND = (1 << 8) - 1
MAX_UID = (1 << 6) - 1
MAX_CODE = (1 << 4) - 1
MAX_IDENTIFIER = (1 << 29) - 1

BROADCAST = 0
"""The positioner number that addresses all positioners."""


class Identifier(NamedTuple):
    """The four fields of an identifier."""

    positioner: int
    command: int
    uid: int
    code: int


def _check(name: str, value: int, largest: int) -> None:
    if not 0 <= value <= largest:
        raise ValueError(f"{name} {value} does not fit in the identifier: 0 to {largest}")


def encode(positioner: int, command: int, uid: int = 0, code: int = 0) -> int:
    """Pack `positioner`, `command`, `uid` and response `code` into an identifier; ValueError when one
    is out of its range.
    """
    _check("positioner", positioner, MAX_POSITIONER)
    _check("command", command, MAX_COMMAND)
    _check("uid", uid, MAX_UID)
    _check("code", code, MAX_CODE)
    return positioner << 18 | command << 10 | uid << 4 | code


def decode(identifier: int) -> Identifier:
    """The fields of an identifier; a number of more than 29 bits is a ValueError."""
    _check("identifier", identifier, MAX_IDENTIFIER)
    return Identifier(
        identifier >> 18,
        identifier >> 10 & MAX_COMMAND,
        identifier >> 4 & MAX_UID,
        identifier & MAX_CODE,
    )


def positioner_of(identifier: int) -> int:
    """Whose an identifier is, 0 for all: of SDSS-V's frames. Transports route by it, or by one like it."""
    return identifier >> 18
