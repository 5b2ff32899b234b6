"""The protocol is listed twice, in C for the firmware and in Python for the host: both lists say the same."""

import struct

import pytest

from fiberloom import units
from fiberloom._core import firmware as fw
from fiberloom.bus import Command, Response, Status
from fiberloom.bus.protocol import COMMANDS, CommandFlag

ROWS = {row["name"]: row for row in fw.command_table()}
RAW = {Command.SEND_FIRMWARE_DATA: (1, 8), Command.COLLISION_DETECTED: (0, 8)}
"""Bytes of payloads that the host does not describe by a struct format."""
HOST_ALONE = {"UNKNOWN"}
"""Status bits that no positioner sends: the host's own mark."""


def single_bits():
    """Names and bits of the host's status word, without the masks that join several bits."""
    return {name: s.bit_length() - 1 for name, s in Status.__members__.items() if s.bit_count() == 1}


def test_commands_have_the_same_names_and_numbers():
    assert {name: row["number"] for name, row in ROWS.items()} == {c.name: int(c) for c in Command}
    assert len(fw.command_table()) == len(ROWS) == len(COMMANDS)


@pytest.mark.parametrize("command", list(Command), ids=lambda c: c.name)
def test_payloads_have_the_same_length(command):
    size = struct.calcsize("<" + COMMANDS[command].request)
    assert ROWS[command.name]["length"] == RAW.get(command, (size, size))


def test_the_same_commands_may_be_broadcast():
    firmware = {name for name, row in ROWS.items() if row["broadcast"]}
    assert firmware == {c.name for c, spec in COMMANDS.items() if spec.flags & CommandFlag.BROADCAST}


def test_response_codes_have_the_same_names_and_numbers():
    assert {name: number for number, name in fw.CODES} == {r.name: int(r) for r in Response}
    assert len(fw.CODES) == len({number for number, _ in fw.CODES})


def test_status_bits_have_the_same_names_and_places():
    host = single_bits()
    assert set(host) >= HOST_ALONE
    assert {name: bit for bit, name in fw.STATUS_BITS} == {
        name: bit for name, bit in host.items() if name not in HOST_ALONE
    }
    assert len(fw.STATUS_BITS) == len({bit for bit, _ in fw.STATUS_BITS})


def test_times_on_the_wire_are_ticks_of_the_firmware():
    assert units.TICKS_PER_S == fw.TICK_HZ
