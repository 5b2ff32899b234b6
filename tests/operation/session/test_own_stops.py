"""`fiberloom stop` where no process has the array: each instrument hears its own stop."""

import asyncio
from contextlib import asynccontextmanager

import numpy as np
import pytest
from typer.testing import CliRunner

import fiberloom as fl
from fiberloom.cli.app import app
from fiberloom.cli.array.site import Site
from fiberloom.drive.desi.frames import POSITIONERS, DesiCommand, DesiFrame, Motor, TableRow, table_frames
from fiberloom.drive.megara.frames import MegaraCommand, MegaraFrame, goal_frames
from fiberloom.drive.moons.frames import MoonsCommand, UnitPlace, command_frame, packed
from fiberloom.drive.moons.maker import leg_of
from fiberloom.drive.moons.waveform import waveform
from fiberloom.drive.pfs.frames import Power
from fiberloom.drive.piezo import MotorMaps
from fiberloom.errors import InputError
from fiberloom.operation.outside.stops import _told, own_stop
from fiberloom.operation.session.states import SessionState
from fiberloom.operation.session.stopping import Stopper
from fiberloom.store import Store
from fiberloom.store.arrays import ArrayBook
from fiberloom.twin.cobras.array import CobraArray
from fiberloom.twin.cobras.server import BoardServer
from fiberloom.twin.desi import DesiTwin
from fiberloom.twin.desi.server import DesiServer
from fiberloom.twin.faults.clock import FaultClock
from fiberloom.twin.server.address import Address
from fiberloom.twin.steppers.array import StepperArray
from fiberloom.twin.steppers.kinds import KINDS
from support.served_steppers import SERVERS, address_of, free_ports

N = 4
WAVE = waveform(np.array([0.0, 0.125]), np.array([0, 15000]), 0)


def turned(name):
    """Units of steppers at home that have just been told to turn alpha, some s."""
    plane = fl.FocalPlane.of(name, seed=0, n=N)
    bus, ids = KINDS[name].bus(StepperArray(plane, seed=0, contacts=False)), plane.positioner_id.tolist()
    link = KINDS[name].link(bus, FaultClock(bus, (), 0))
    asyncio.run(link.home(ids))
    if name != "moons":
        bus.send([*goal_frames(dict.fromkeys(ids, (15000, 0))), MegaraFrame.of(0, 0, MegaraCommand.START)])
        return bus
    waves = np.zeros((WAVE.size, N, 2), dtype=np.int64)
    waves[..., 0] = WAVE[:, None]
    asyncio.run(link.stop())
    asyncio.run(link._load(ids, leg_of(np.arange(N), bus.array.counts, waves)))
    for number in ids:
        frame = command_frame(UnitPlace.of(number), 1, MoonsCommand.EXECUTE)
        bus.take(UnitPlace.of(number).gateway, packed(frame))
    return bus


@asynccontextmanager
async def served(name, bus):
    server = SERVERS[name](bus, Address("127.0.0.1", free_ports()), FaultClock(bus, (), 0))
    await server.open()
    try:
        yield server
    finally:
        server.close()


def moving(bus):
    return [bool((bus.busy_until_s[row] > bus.time_s).any()) for row in range(N)]


@pytest.mark.parametrize("name", ["moons", "lamost", "megara"])
def test_steppers_stop_and_say_so(name):
    bus = turned(name)

    async def scenario():
        async with served(name, bus) as server:
            await asyncio.sleep(0.3)
            before = moving(bus)
            return before, await own_stop(address_of(name, server), name)(), moving(bus)

    before, halted, after = asyncio.run(scenario())
    assert before == [True] * N
    assert after == [False] * N
    assert halted == (True, f"{N} positioners have answered", True)


def test_desi_stops_and_says_so():
    plane = fl.FocalPlane.of("desi", seed=0, n=N)
    twin, row = DesiTwin(plane, seed=0), TableRow(Motor(200000, cruise=True), Motor(0), last=True)
    for number in plane.positioner_id.tolist():
        twin.send(table_frames(number, [row]))
    twin.send([DesiFrame.of(POSITIONERS, DesiCommand.RUN, b"\x01")])

    async def scenario():
        server = DesiServer(twin, Address("127.0.0.1", 0))
        await server.open()
        try:
            await asyncio.sleep(0.1)
            before = [one.moving for one in twin.controllers.values()]
            return before, await own_stop(f"cannet://{server.address}", "desi")()
        finally:
            server.close()

    before, halted = asyncio.run(scenario())
    assert all(before)
    assert not any(one.moving for one in twin.controllers.values())
    assert halted == (True, f"{N} positioners have answered", True)


def test_the_power_of_cobras_is_cut_and_given_back(monkeypatch):
    heard = []

    async def scenario():
        maps = MotorMaps(np.full((2 * N, 2, 112), 0.07), 400.0 / 112, np.full((2 * N, 2), 40.0))
        server = BoardServer(CobraArray(fl.FocalPlane.of("pfs", seed=0, n=N), maps))
        power = type(server.boards)._power
        monkeypatch.setattr(
            type(server.boards),
            "_power",
            lambda boards, command: heard.append(command) or power(boards, command),
        )
        port = await server.listen(port=0)
        try:
            return await own_stop(f"fpga://127.0.0.1:{port}", "sdssv")()
        finally:
            await server.close()

    halted = asyncio.run(scenario())
    assert [isinstance(one, Power) for one in heard] == [True, True]
    assert heard[0].on == 0 != heard[1].on
    assert halted.stopped
    assert "search their stops" in halted.text


def test_a_gateway_that_is_away_is_named_and_the_array_does_not_count_as_stopped():
    bus = turned("moons")
    away = next(iter({0, 1, 2} - {UnitPlace.of(number).gateway for number in bus.row_of}))

    async def scenario():
        async with served("moons", bus) as server:
            server._servers[away].close()
            return await own_stop(address_of("moons", server), "moons")(), moving(bus), server.address.port

    halted, after, port = asyncio.run(scenario())
    assert after == [False] * N
    assert not halted.stopped
    assert f"{N} positioners have answered; 127.0.0.1:{port + away}: down" in halted.text


@pytest.mark.parametrize("bus", ["gateways://127.0.0.1:{}", "radio://127.0.0.1:{}", "fpga://127.0.0.1:{}"])
def test_where_nothing_listens_it_says_where(bus, tmp_path):
    address = bus.format(free_ports())
    with Store.open(tmp_path / "arrays.sqlite") as store:
        report = asyncio.run(Stopper(ArrayBook(store, address), own_stop(address, ""), False, "ann").stop())
    assert not report.stopped
    assert "no connection" in report.text
    assert "python-can" not in report.text


@pytest.mark.parametrize("protocol", ["none", "moons"])
def test_an_instrument_without_a_stop_is_told_in_one_line_and_sent_nothing(protocol, tmp_path):
    with Store.open(tmp_path / "arrays.sqlite") as store:
        book = ArrayBook(store, "socketcan:can0")
        report = asyncio.run(Stopper(book, own_stop(book.address, protocol), True, "ann").stop())
        assert book.state().state != SessionState.STOPPED
    assert (report.stopped, report.by) == (False, "")
    assert report.text.startswith(f"nothing is sent to socketcan:can0: motors of the protocol '{protocol}'")
    assert "\n" not in report.text


@pytest.mark.parametrize("bus", ["gateways://:1", "radio://host:0", "fpga://host:70000", "can0"])
def test_an_address_that_is_none_is_an_error(bus):
    with pytest.raises(InputError):
        own_stop(bus, "moons")


def test_a_stop_with_units_that_move_or_are_silent_has_not_stopped_the_array():
    assert _told([1, 2], moving=[2]) == (False, "2 positioners have answered; still moving: 2", True)
    assert _told([1], silent=np.array([7])) == (False, "1 positioners have answered; no answer from 7", True)
    assert _told([], hint="; ask") == (False, "0 positioners have answered; ask", True)


def test_the_command_takes_the_instrument_from_its_option_or_the_site(tmp_path):
    words = [
        "stop",
        "--bus",
        "socketcan:can0",
        "--instrument",
        "lamost",
        "--store",
        tmp_path / "arrays.sqlite",
    ]
    done = CliRunner().invoke(app, list(map(str, words)))
    assert done.exit_code == 1
    assert "nothing is sent to socketcan:can0" in " ".join(done.output.split())
    assert Site(bus="socketcan:can0", instrument="desi").defaults()["stop"]["instrument"] == "desi"
