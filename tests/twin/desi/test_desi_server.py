"""DESI's positioners on a TCP port: the host's own client moves them through real sockets."""

import asyncio

import numpy as np
import pytest

import fiberloom as fl
from fiberloom.bus.cannet import CanNetTransport
from fiberloom.bus.motion import MotionWatch
from fiberloom.drive.desi.drive import DesiDrive
from fiberloom.drive.desi.frames import POSITIONERS, DesiCommand, DesiFrame, positioner_of
from fiberloom.drive.port import Wanted
from fiberloom.errors import InputError
from fiberloom.twin.desi import DesiTwin
from fiberloom.twin.desi.server import DesiServer
from fiberloom.twin.server.address import Address

N = 12
PLANE = fl.FocalPlane.of("desi", seed=0, n=N)


def with_server(scenario):
    """The outcome of `scenario(drive, server)` on a served twin."""

    async def run():
        server = DesiServer(DesiTwin(PLANE, seed=0), Address("127.0.0.1", 0), speed=10.0)
        await server.open()
        try:
            bus = await CanNetTransport.open([str(server.address)], whose=positioner_of)
            drive = DesiDrive(PLANE, bus)
            try:
                await drive.connect()
                return await scenario(drive, server)
            finally:
                await drive.close()
        finally:
            server.close()

    return asyncio.run(run())


def test_a_move_goes_through_real_sockets():
    async def scenario(drive, server):
        goal = PLANE.park_deg - np.where(np.arange(N)[:, None] < 3, [20.0, 10.0], 0.0)
        programme = await drive.prepare(Wanted(PLANE, PLANE.park_deg, goal, np.full(N, 3.0)))
        results = await drive.run(programme, MotionWatch(), print)
        return results, drive.ids, drive.maps.believed_deg, server.twin.truth(), server.report()

    results, ids, believed, truth, report = with_server(scenario)
    assert ids == sorted(PLANE.positioner_id.tolist())
    assert len(results) == 3
    assert all(result.ok for result in results.values())
    np.testing.assert_allclose(believed[:3], PLANE.park_deg[:3] - [20.0, 10.0], atol=1e-3)
    assert np.abs(truth - believed).max() < 2.0
    assert report["clients"] == 1
    assert report["contacts"] == 0


def test_each_positioner_is_asked_on_its_own_port_once_it_has_answered():
    async def scenario(drive, server):
        before = server.traffic["frames_in"]
        await drive._told(DesiCommand.VERSION, drive.ids)
        alone = server.traffic["frames_in"] - before
        await drive.transport.send([DesiFrame.of(POSITIONERS, DesiCommand.STAY_ALIVE)])
        await asyncio.sleep(0.2)
        return alone, server.traffic["frames_in"] - before - alone

    alone, broadcast = with_server(scenario)
    assert alone == N
    assert broadcast == 4


def test_a_second_host_is_hung_up_on():
    async def scenario(drive, server):
        with pytest.raises(InputError, match="no answer"):
            await CanNetTransport.open([str(server.address)])
        return server.traffic["refused_clients"]

    assert with_server(scenario) == 1


def test_an_address_that_is_taken_is_told():
    async def scenario(drive, server):
        with pytest.raises(InputError, match="choose another address"):
            await DesiServer(DesiTwin(PLANE, seed=0), server.address).open()

    with_server(scenario)
