"""Links break and come back: what is behind them is disconnected meanwhile, and the others go on."""

import asyncio
from itertools import islice

import pytest
from fakes import LinkedBus
from test_transports import FakeGateway

from fiberloom.bus import Client, Command, Outcome
from fiberloom.bus.cannet import CanNetTransport
from fiberloom.bus.links import Link, LinkWatch, cut_off, retries_s
from fiberloom.bus.spec import BusSpec
from fiberloom.bus.transport import PythonCanTransport
from fiberloom.errors import InputError

WAIT_S = 10.0
"""A hundred times what is needed."""


def setup(*numbers):
    bus = LinkedBus(numbers)
    client = Client(bus)
    client.ids = list(numbers)
    return bus, client


def test_reconnecting_is_tried_ever_more_rarely():
    assert list(islice(retries_s(), 7)) == [0.5, 1.0, 2.0, 4.0, 8.0, 10.0, 10.0]


def test_the_first_reason_counts_and_coming_up_forgets_it():
    link = Link("a")
    link.goes_down("cut", 3.0)
    link.goes_down("reset", 4.0)
    assert (str(link), link.since_s) == ("a: down, cut", 3.0)
    link.comes_up(5.0)
    assert (str(link), link.since_s, link.reason) == ("a: up", 5.0, "")


def test_a_break_between_two_looks_is_seen():
    bus, _ = setup(1, 2)
    watch = LinkWatch(bus)
    assert watch.changes() == []
    bus.links[0].goes_down("cut", 1.0)
    bus.links[0].comes_up(1.5)
    assert watch.changes() == [bus.links[0]]
    assert watch.changes() == []


def test_unknown_positioners_are_cut_off_when_every_link_is_down():
    bus, _ = setup()
    bus.link_of = lambda positioner: None
    bus.links[0].goes_down("cut", 1.0)
    assert cut_off(bus, [7]) == set()
    bus.links[1].goes_down("cut", 1.0)
    assert cut_off(bus, [7]) == {7}
    assert cut_off(object(), [7]) == set()  # a transport that tells of no links


class CountedLinks(LinkedBus):
    """Counts how often somebody asks for the links."""

    asked = 0

    @property
    def links(self):
        CountedLinks.asked += 1
        return self.known_links

    @links.setter
    def links(self, links):
        self.known_links = links

    def link_of(self, positioner):
        return self.known_links[0 if positioner % 2 else 1]


def test_links_are_looked_at_for_all_positioners_together():
    """Not once for each frame: with 500 positioners that holds up the event loop by some 20 ms."""
    client = Client(CountedLinks(range(1, 51)))
    CountedLinks.asked = 0
    assert asyncio.run(client.command(Command.SET_SPEED, range(1, 51), 1000, 1000)).ok.all()
    assert CountedLinks.asked < 25


def test_what_waits_behind_a_broken_link_ends_at_once_and_the_rest_is_answered():
    bus, client = setup(1, 2)
    bus.change = lambda identifier, frame: [(0.8, frame)]
    bus.cut(1, 0.2)

    async def run():
        cut = asyncio.create_task(client.command(Command.GET_STATUS, [2], timeout_s=50.0))
        kept = await client.command(Command.GET_STATUS, [1], timeout_s=50.0)
        return await cut, kept

    cut, kept = asyncio.run(run())
    assert cut[2].outcome is Outcome.DISCONNECTED
    assert kept[1].ok
    assert bus.time_s < 1.0


def test_nothing_is_sent_to_one_that_is_cut_off():
    bus, client = setup(1, 2)
    bus.links[1].goes_down("cut", 0.0)
    results = asyncio.run(client.positions())
    assert [r.outcome for r in results.values()] == [Outcome.DONE, Outcome.DISCONNECTED]
    assert [i >> 18 for i, _ in bus.sent] == [1]


def test_a_broadcast_does_not_wait_for_what_is_cut_off():
    bus, client = setup(1, 2, 3, 4)
    bus.cut(1, 0.0)

    async def run():
        await client.sleep(0.1)
        return await client.status()

    results = asyncio.run(run())
    assert results.ok_ids == [1, 3]
    assert {r.outcome for r in results.failed.values()} == {Outcome.DISCONNECTED}
    assert bus.time_s < 0.2


def with_two_gateways(scenario):
    async def run():
        async with FakeGateway({1: [1, 2]}) as one, FakeGateway({1: [3]}) as two:
            transport = await CanNetTransport.open([one.address, two.address], ports=(1,))
            client = Client(transport)
            await client.discover()
            try:
                return await asyncio.wait_for(scenario(one, client, transport), WAIT_S)
            finally:
                await client.close()

    return asyncio.run(run())


async def until(done):
    while not done():
        await asyncio.sleep(0.02)


def test_a_gateway_that_is_cut_reconnects_by_itself():
    async def scenario(gateway, client, transport):
        heard = []
        client.on_link(lambda link: heard.append(link.up))
        gateway.hang_up()
        during = await client.wait_until_done([1, 3], timeout_s=5.0)
        await until(lambda: transport.links[0].up)
        return during, await client.positions(), heard, client.exchange.lost, list(gateway.lines)

    during, after, heard, lost, lines = with_two_gateways(scenario)
    assert during[1].outcome is Outcome.DISCONNECTED
    assert during[3].ok  # the other gateway's
    assert after.ok_ids == [1, 2, 3]
    assert heard == [False, True]
    assert lost is None
    assert sum(line.endswith("START") and line.startswith("CAN") for line in lines) == 2  # set up anew


def test_frames_for_a_link_that_is_down_are_dropped_not_kept():
    async def scenario(gateway, client, transport):
        gateway.hang_up()
        await until(lambda: not transport.links[0].up)
        await client.start([1, 2])
        await client.goto([1, 2], 5.0, 5.0)
        await until(lambda: transport.links[0].up)
        await client.positions()
        numbers = [int(line.split()[3], 16) >> 10 & 0xFF for line in gateway.lines if line.startswith("M ")]
        return set(numbers)

    assert with_two_gateways(scenario) == {Command.GET_ID, Command.GET_ACTUAL_POSITION}


def test_a_transport_that_is_closed_is_lost_for_good():
    async def scenario(gateway, client, transport):
        await transport.close()
        return await client.positions(), client.exchange.lost

    results, lost = with_two_gateways(scenario)
    assert {r.outcome for r in results.values()} == {Outcome.DISCONNECTED}
    assert "closed" in lost


@pytest.mark.parametrize(
    ("text", "interface", "channels"),
    [
        ("cannet://10.1.1.1,10.1.1.2:19229", "cannet", ("10.1.1.1", "10.1.1.2:19229")),
        ("socketcan:can0,can1", "socketcan", ("can0", "can1")),
        ("socketcan://can0", "socketcan", ("can0",)),
        ("slcan:/dev/ttyUSB0, /dev/ttyUSB1", "slcan", ("/dev/ttyUSB0", "/dev/ttyUSB1")),
    ],
)
def test_addresses_of_buses(text, interface, channels):
    spec = BusSpec.parse(text)
    assert (spec.interface, spec.channels) == (interface, channels)


@pytest.mark.parametrize("text", ["", "cannet", "cannet://", "10.1.1.1:19228", ":can0", "socketcan:,"])
def test_what_is_no_address_is_refused(text):
    with pytest.raises(InputError, match="expected cannet"):
        BusSpec.parse(text)


def test_a_channel_named_twice_is_refused():
    with pytest.raises(InputError, match="twice"):
        BusSpec.parse("socketcan:can0,can0")


def test_two_can_channels_are_two_links_and_one_that_breaks_is_opened_anew():
    import can

    from fiberloom.bus.identifier import encode

    async def answer(bus, number):
        while True:
            message = await asyncio.to_thread(bus.recv, 0.02)
            if message is not None and message.arbitration_id >> 18 in (0, number):
                command, uid = message.arbitration_id >> 10 & 0xFF, message.arbitration_id >> 4 & 0x3F
                bus.send(can.Message(arbitration_id=encode(number, command, uid), data=bytes(8)))

    async def run():
        others = [can.Bus(interface="virtual", channel=f"fiberloom-{k}") for k in (1, 2)]
        tasks = [asyncio.create_task(answer(bus, number)) for bus, number in zip(others, (7, 8), strict=True)]
        transport = PythonCanTransport.open("virtual", "fiberloom-1", "fiberloom-2")
        client = Client(transport)
        ids = await client.discover()
        where = [transport.link_of(i).name for i in ids]
        broken = transport._channels[0]._bus
        broken.recv = broken.send = lambda *_: (_ for _ in ()).throw(can.CanError("unplugged"))
        await until(lambda: not transport.links[0].up)
        during = await client.positions()
        await until(lambda: transport.links[0].up)
        after = await client.positions()
        for task in tasks:
            task.cancel()
        await client.close()
        for bus in others:
            bus.shutdown()
        return ids, where, during, after

    ids, where, during, after = asyncio.run(asyncio.wait_for(run(), WAIT_S))
    assert ids == [7, 8]
    assert where == ["fiberloom-1", "fiberloom-2"]
    assert during[7].outcome is Outcome.DISCONNECTED
    assert during[8].ok
    assert after.ok.all()
