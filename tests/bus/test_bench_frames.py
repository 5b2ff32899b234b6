"""Commands of the bench and values that no frame holds: refused before anything is sent."""

import asyncio

import numpy as np
import pytest

from fiberloom.bus.client import Client
from fiberloom.bus.protocol import COMMANDS, Command
from fiberloom.bus.trace import push, read_trace, start_trace
from fiberloom.errors import InputError
from fiberloom.instruments import generate
from fiberloom.twin import Twin, TwinTransport, draw_units


@pytest.fixture
def client(sdssv):
    plane = generate(sdssv, seed=0, n_positioners=2)
    return Client(TwinTransport(Twin(plane, draw_units(plane, 0), seed=0)))


@pytest.mark.parametrize("period_s", [0.0, 1e-4, 40.0])
def test_a_trace_has_whole_ticks_between_its_samples(client, period_s):
    with pytest.raises(InputError, match=f"trace: a sample every {period_s} s; 0.0005 to 32.7675 s are"):
        asyncio.run(start_trace(client, [1], period_s))


@pytest.mark.parametrize(
    ("voltages", "times_s", "words"),
    [
        ((1.01, 0.0), (0.1, 0.1), r"voltages \(1.01, 0.0\) must be shares of the full one, -1 to 1"),
        ((0.0, -2.0), (0.1, 0.1), "must be shares of the full one, -1 to 1"),
        ((0.1, 0.1), (0.1, 0.2), "torque step: 0.3 s; 0.2 s in all at most"),
    ],
)
def test_a_push_has_limits(client, voltages, times_s, words):
    with pytest.raises(InputError, match=words):
        asyncio.run(push(client, [1], 0, voltages, times_s))


def test_values_that_do_not_fit_a_frame_are_named():
    spec = COMMANDS[Command.GO_TO_ABSOLUTE_POSITION]
    with pytest.raises(InputError, match=r"GO_TO_ABSOLUTE_POSITION: values \(2147483648, 0\) do not fit"):
        spec.pack(2**31, 0)
    with pytest.raises(InputError, match="do not fit the payload 'ii'"):
        spec.pack(1)
    assert COMMANDS[Command.GET_STATUS].unpack(b"\x01") is None


def test_a_move_is_no_broadcast_and_a_third_axis_is_none(client):
    with pytest.raises(ValueError, match="GO_TO_ABSOLUTE_POSITION cannot be broadcast"):
        asyncio.run(client.broadcast(Command.GO_TO_ABSOLUTE_POSITION))
    with pytest.raises(ValueError, match="axis 'gamma': 'alpha', 'beta', or None for both"):
        asyncio.run(client.home([1], "gamma"))


def test_a_trace_that_was_not_recorded_is_empty(client):
    async def scenario():
        await client.discover()
        return await read_trace(client, client.ids, 0)

    trace = asyncio.run(scenario())
    assert trace.motor_deg.shape == (2, 0)
    np.testing.assert_array_equal(trace.rotor_deg, trace.motor_deg - trace.zero_deg[:, None])
