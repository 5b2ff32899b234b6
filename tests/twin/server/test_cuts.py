"""A gateway is cut in the middle of a motion, in real time: none is stopped, all arrive."""

import asyncio

import numpy as np
import pytest

from fiberloom.bus import CanNetTransport, Client, DeviationKind, MotionWatch, Outcome, WireTrajectory
from fiberloom.errors import InputError
from fiberloom.instruments import generate, load_instrument
from fiberloom.twin import Twin, draw_units
from fiberloom.twin.faults.grammar import parse_faults
from fiberloom.twin.faults.schedule import schedule_faults
from fiberloom.twin.server.address import Address
from fiberloom.twin.server.server import TwinServer, places_of

PLANE = generate(load_instrument("sdssv"), seed=8, n_positioners=6)
UNITS = draw_units(PLANE, seed=2)
IDS = [int(i) for i in PLANE.positioner_id]
PLACES = places_of(6, 2)
BEHIND_FIRST = [i for i, (device, _) in zip(IDS, PLACES, strict=True) if device == 0]


def trajectory():
    time_s = np.linspace(0.2, 5.0, 6)
    return WireTrajectory.from_deg(time_s, np.linspace(10.0, 40.0, 6), np.linspace(170.0, 140.0, 6))


async def cut_in_motion(server, for_s):
    while np.abs(truth(server)[:, 0] - 10.0).max() < 3.0:
        await asyncio.sleep(0.02)
    server.listeners[0].cut(True)
    await asyncio.sleep(for_s)
    server.listeners[0].cut(False)


def truth(server):
    with server.real.held() as twin:
        return twin.truth()


async def moved(watch, for_s):
    twin = Twin(PLANE, UNITS, seed=1, threads=1, neighbours=False)
    server = TwinServer(twin, [Address("127.0.0.1", 0), Address("127.0.0.1", 0)])
    await server.open()
    transport = await CanNetTransport.open([str(listener.address) for listener in server.listeners])
    client = Client(transport)
    try:
        await client.discover()
        saboteur = asyncio.create_task(cut_in_motion(server, for_s))
        results = await client.run_trajectories({i: trajectory() for i in IDS}, watch=watch)
        await saboteur
        return results, truth(server), [link.up for link in transport.links]
    finally:
        await client.close()
        server.close()


@pytest.mark.parametrize("for_s", [1.2, 6.0])
def test_a_cut_gateway_stops_none_and_its_positioners_arrive(for_s):
    """Back before the planned end of five seconds, and after it."""
    watch = MotionWatch()
    results, angles, up = asyncio.run(asyncio.wait_for(moved(watch, for_s), 90.0))
    assert {r.outcome for r in results.values()} == {Outcome.DONE}
    assert {d.kind for d in watch.deviations} == {DeviationKind.LINK_DOWN}
    assert {d.positioner for d in watch.deviations} == set(BEHIND_FIRST)
    assert np.abs(angles - [40.0, 140.0]).max() < 1.0
    assert up == [True, True]


def test_cuts_are_drawn_among_gateways_or_named():
    def read(text):
        return schedule_faults(parse_faults(text), IDS, PLACES, 0)

    assert sorted(f.place for f in read("cut=2@3+5")) == [(0, 0), (1, 0)]
    (named,) = read("cut=#2@3+5")
    assert (named.place, named.start_s, named.end_s, str(named)) == ((1, 0), 3.0, 8.0, "cut gateway 2")
    for text in ("cut=3", "cut=#3", "cut=#2,cut=#2"):
        with pytest.raises(InputError, match=r"^--faults cut"):
            read(text)


def test_the_schedule_cuts_and_takes_the_host_again():
    async def run():
        twin = Twin(PLANE, UNITS, seed=1, threads=1, neighbours=False)
        schedule = schedule_faults(parse_faults("cut=#1@1+1"), IDS, PLACES, 0)
        addresses = [Address("127.0.0.1", 0), Address("127.0.0.1", 0)]
        server = TwinServer(twin, addresses, schedule=schedule)
        await server.open()
        transport = await CanNetTransport.open([str(listener.address) for listener in server.listeners])
        for up in (True, False, True):
            while transport.links[0].up != up:
                await asyncio.sleep(0.02)
        # the cut's end is told by the schedule's own turn, which may come after the host is back
        while len(server.happened) < 2:
            await asyncio.sleep(0.02)
        await transport.close()
        server.close()
        return server.happened

    happened = asyncio.run(asyncio.wait_for(run(), 60.0))
    assert [text.split(": ")[1] for text in happened] == ["cut gateway 1", "cut gateway 1 ends"]
