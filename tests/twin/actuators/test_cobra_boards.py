"""Boards of the twin and the client of the FPGA, over real sockets and in virtual time."""

import asyncio
import sys
from pathlib import Path

import numpy as np
import pytest

from fiberloom.drive.pfs.client import Ended, FpgaClient, Orders
from fiberloom.drive.pfs.frames import RUN_ARM, Arm, BoardReply, Code, RunCommand, arm_flags, encode
from fiberloom.drive.pfs.numbering import plugs_of
from fiberloom.drive.pfs.streams import over_tcp, tcp_address
from fiberloom.errors import InputError
from fiberloom.twin.actuators import PiezoErrors, drawn_maps
from fiberloom.twin.cobras.array import CobraArray
from fiberloom.twin.cobras.boards import step_durations_s
from fiberloom.twin.cobras.server import BoardServer
from fiberloom.twin.cobras.streams import VirtualBoards

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
from support.cobras import pfs_plane

N = 114
PERFECT = PiezoErrors(0.0, 0.0, 0.0, 3.0, 0.0, 0.0, 0.9, 0.0, 0.0, 0.0, 0.0)


def array_of(n=N, errors=PERFECT):
    return CobraArray(pfs_plane(n), drawn_maps(n, 1), errors, seed=2)


def orders_of(n=N, theta=100, phi=50, sleeps=None):
    steps = np.column_stack([np.full(n, theta), np.full(n, phi)])
    return Orders(np.arange(1, n + 1), steps, np.tile([44.0, 22.0], (n, 1)), sleeps)


def test_a_run_moves_cobras_and_takes_its_time():
    async def go():
        array = array_of()
        owner = VirtualBoards(array)
        client = FpgaClient(owner.connector())
        result = await client.run(orders_of())
        return array, owner, result

    array, _, result = asyncio.run(go())
    assert result.ids(Ended.DONE) == list(range(1, N + 1))
    # 100 steps of 16 groups x 156 us
    assert result.took_s == pytest.approx(100 * 2.496e-3, abs=0.01)
    told = array.motors.maps.way_deg(np.zeros(2 * N), np.tile([100.0, 50.0], N))
    np.testing.assert_allclose(array.angle_deg.ravel(), told, atol=1e-9)


def test_sleeps_come_before_steps():
    async def go():
        array = array_of()
        owner = VirtualBoards(array)
        sleeps = np.column_stack([np.full(N, 200), np.zeros(N, dtype=int)])
        client = FpgaClient(owner.connector())
        await client.run(orders_of(sleeps=sleeps))
        return array, owner.now_s

    array, now_s = asyncio.run(go())
    begun_s = array._moments_s[0]
    half = array.angle_at_deg(begun_s + 0.44)  # 176 steps
    assert np.all(half[:, 0] == 0.0)
    np.testing.assert_allclose(half[:, 1], array.angle_deg[:, 1], atol=1e-9)
    later = array.angle_at_deg(begun_s + 0.62)
    assert np.all((later[:, 0] > 0.0) & (later[:, 0] < array.angle_deg[:, 0]))
    assert now_s > 0.74


def test_a_step_lasts_as_long_as_the_groups_of_a_board_pulse():
    flags = arm_flags(*plugs_of(np.array([1, 3, 5])), int(Arm.THETA_ON))
    arms = np.array([(f, us, 1, 0, 0, 0, 0) for f, us in zip(flags, (100, 300, 200), strict=True)],
                    dtype=RUN_ARM)  # fmt: skip
    took_s = step_durations_s(arms, 156)
    # plugs 1 and 2 share a group, plug 3 is in the next
    assert took_s[0] == pytest.approx(1e-6 * (300 + 200 + 14 * 156))
    assert took_s[1] == pytest.approx(1e-6 * 16 * 156)


def replies_to(data, unpowered=frozenset()):
    async def go():
        owner = VirtualBoards(array_of(), set(unpowered))
        stream = await owner.connector()()
        await stream.write(data)
        out = []
        try:
            while True:
                out.append(BoardReply.of(await stream.read(6, 30.0)))
        except TimeoutError:
            return out

    return asyncio.run(go())


def test_a_bad_command_gets_one_reply_and_moves_nothing():
    good = encode(RunCommand(orders_of(3).records(), 5000, 156, 9))
    assert [r.code for r in replies_to(good)] == [Code.OK, Code.OK]
    assert replies_to(good[:-1] + bytes([good[-1] ^ 1])) == [BoardReply(1, 9, Code.CHECKSUM)]


def test_a_run_longer_than_its_time_is_said_so():
    data = encode(RunCommand(orders_of(3, theta=2000).records(), 1000, 156, 1))
    assert [r.code for r in replies_to(data)] == [Code.OK, Code.TIMEOUT]


def test_boards_without_power_do_not_move_their_cobras():
    async def go():
        array = array_of()
        owner = VirtualBoards(array, {3})
        client = FpgaClient(owner.connector())
        boards = await client.boards()
        result = await client.run(orders_of())
        return array, boards, result

    array, boards, result = asyncio.run(go())
    assert boards == [2, 14, 14, 14, 14, 14]  # the chain ends at the one that is dead
    dead = result.ids(Ended.UNPOWERED)
    assert dead == list(range(58, 115))
    moved = array.angle_deg[:, 0] > 0.0
    np.testing.assert_array_equal(moved, np.arange(1, N + 1) < 58)


def test_power_off_stops_motors_where_they_are():
    async def go():
        array = array_of()
        owner = VirtualBoards(array)
        stream = await owner.connector()()
        await stream.write(encode(RunCommand(orders_of(theta=1000).records(), 5000, 156, 1)))
        await stream.sleep(1.25)
        client = FpgaClient(owner.connector())
        await client.power(on=0)
        first = array.angle_deg.copy()
        await client.sleep(5.0)
        return array, first

    array, first = asyncio.run(go())
    np.testing.assert_allclose(array.angle_deg, first, atol=1e-9)
    told = array.motors.maps.way_deg(np.zeros(2 * N), np.tile([500.0, 50.0], N))
    np.testing.assert_allclose(first[:, 0], told[0::2], rtol=0.02)


def test_a_cut_connection_is_made_anew_and_the_run_is_not_repeated():
    async def go():
        array = array_of()
        owner = VirtualBoards(array)
        client = FpgaClient(owner.connector())
        await client.open()
        stream, write = owner.open, owner.open.write

        async def write_and_cut(data):
            await write(data)
            if data[0] == 1:
                owner.cut()

        stream.write = write_and_cut
        result = await client.run(orders_of())
        again = await client.run(orders_of(theta=0, phi=10))
        return owner, client, result, again

    owner, client, result, again = asyncio.run(go())
    assert result.ids(Ended.UNKNOWN) == list(range(1, N + 1))
    assert client.reconnected == 1
    assert owner.boards.runs == 2
    assert again.ids(Ended.DONE) == list(range(1, N + 1))


def test_nobody_there_is_one_line():
    async def go():
        owner = VirtualBoards(array_of())
        owner.listening = False
        await FpgaClient(owner.connector(), tries=1).open()

    with pytest.raises(InputError, match="check its address and power"):
        asyncio.run(go())


@pytest.mark.parametrize(
    ("steps", "pulse_us", "text"),
    [
        ([[1, 70_000]], [[44.0, 22.0]], "cobra 1, phi: 70000 steps; at most 65535"),
        ([[1, 1]], [[0.0, 22.0]], "cobra 1, theta: 0 us; pulses have 1 to 140 us"),
        ([[1, -1]], [[44.0, 141.0]], "cobra 1, phi: 141 us"),
    ],
)
def test_what_a_board_would_refuse_is_refused_by_name(steps, pulse_us, text):
    with pytest.raises(InputError, match=text):
        Orders(np.array([1]), np.array(steps), np.array(pulse_us)).records()


def test_an_unfinished_command_is_answered_when_nothing_more_comes():
    async def go():
        owner = VirtualBoards(array_of())
        stream = await owner.connector()()
        data = encode(RunCommand(orders_of(3).records(), 5000, 156, 7))
        await stream.write(data[:20])
        await stream.sleep(2.0)
        await stream.write(b"")
        return BoardReply.of(await stream.read(6, 1.0))

    assert asyncio.run(go()) == BoardReply(1, 7, Code.EMPTY)


def test_over_real_sockets():
    async def go():
        array = array_of()
        server = BoardServer(array, {10}, speed=20.0)
        port = await server.listen(port=0)
        client = FpgaClient(over_tcp("127.0.0.1", port))
        version, boards = await client.version(), await client.boards()
        result = await client.run(orders_of())
        await client.set_periods(np.array([5]), np.array([[250, 155]]))
        state = await client.housekeeping(1)
        with pytest.raises(InputError, match="board 12 was answered by 'timeout'"):
            await client.housekeeping(12)
        await server.cut()
        again = await client.boards()
        await client.close()
        await server.close()
        return array, version, boards, result, state, again, client

    array, version, boards, result, state, again, client = asyncio.run(go())
    assert version == (2, 0)
    assert boards == again == [9, 14, 14, 14, 14, 14]
    assert result.ids(Ended.DONE) == list(range(1, N + 1))
    assert state.periods[2].tolist() == [250, 155]
    assert client.reconnected == 1
    told = array.motors.maps.way_deg(np.zeros(2 * N), np.tile([100.0, 50.0], N))
    np.testing.assert_allclose(array.angle_deg.ravel(), told, atol=1e-9)


def test_addresses():
    assert tcp_address("fpga") == ("fpga", 4001)
    assert tcp_address("fpga:4002") == ("fpga", 4002)
    with pytest.raises(InputError, match="expected HOST"):
        tcp_address("fpga:port")
