"""An independent client of OPC UA reads the state, sees an alarm and stops a motion, over loopback."""

import asyncio
import contextlib
import importlib
import queue
import socket
import threading

import numpy as np
import pytest
from observed import BUS, PLANE, free_port, observed

from fiberloom.errors import InputError
from fiberloom.observatory.network import Endpoint
from fiberloom.observatory.opcua import NAME, NAMESPACE, opcua_server

asyncua = pytest.importorskip("asyncua", reason="pip install 'fiberloom[opcua]': OPC UA")


class Changes:
    """Handler of a subscription: what came, in order."""

    def __init__(self):
        self.values, self.events = [], []

    def datachange_notification(self, node, value, data):
        self.values.append(value)

    def event_notification(self, event):
        self.events.append((event.Severity, event.Message.Text))

    async def until(self, value, events=0, within_s=30.0):
        """Waits for a last value, and so many events."""
        async with asyncio.timeout(within_s):
            while self.values[-1:] != [value] or len(self.events) < events:
                await asyncio.sleep(0.02)


class Client:
    """The object of the array, as a client browses it."""

    def __init__(self, client, index, node):
        self.client, self.index, self.node = client, index, node

    async def read(self, name):
        return await (await self.node.get_child(f"{self.index}:{name}")).read_value()

    async def call(self, name, *given):
        return await self.node.call_method(f"{self.index}:{name}", *given)

    async def until(self, name, wanted, within_s=60.0):
        async with asyncio.timeout(within_s):
            while (found := await self.read(name)) != wanted:
                await asyncio.sleep(0.02)
        return found

    async def follow(self, *names):
        """Values and alarms from now on."""
        seen = Changes()
        subscription = await self.client.create_subscription(50, seen)
        nodes = [await self.node.get_child(f"{self.index}:{name}") for name in names]
        await subscription.subscribe_data_change(nodes)
        await subscription.subscribe_events(self.node)
        return seen


class Current:
    """The array of the test that runs: to make a server takes seconds, so all have one."""

    array = None

    def __getattr__(self, name):
        return lambda *given: getattr(self.array, name)(*given)


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    """The array that is shown, and the URL, of a server in a thread."""
    current, urls, over = Current(), queue.Queue(), threading.Event()
    current.array, _ = observed(tmp_path_factory.mktemp("first"))

    async def serve():
        async with opcua_server(current, Endpoint("127.0.0.1", free_port())) as url:
            urls.put(url)
            await asyncio.to_thread(over.wait)

    thread = threading.Thread(target=asyncio.run, args=(serve(),), daemon=True)
    thread.start()
    yield current, urls.get(timeout=120.0)
    over.set()
    thread.join()


@pytest.fixture
def array(tmp_path, server):
    made, _ = observed(tmp_path)
    server[0].array = made
    yield made
    made.close()


@contextlib.asynccontextmanager
async def client_of(server):
    async with asyncua.Client(server[1]) as client:
        index = await client.get_namespace_index(NAMESPACE)
        found = Client(client, index, await client.nodes.objects.get_child(f"{index}:{NAME}"))
        await found.until("State", "off")
        yield found


def test_a_client_reads_the_state_and_stops_a_motion(array, server):
    held = array.field.source
    held.slow.set()

    async def night():
        async with client_of(server) as client:
            assert await client.read("State") == "off"
            assert (await client.read("Address"), await client.read("Positioners")) == (BUS, 7)
            beat = await client.read("Heartbeat")
            await client.until("Heartbeat", beat + 2)
            seen = await client.follow("State")
            assert await client.call("Park", "ann") == [True, "park has begun"]
            await client.until("Command", "park of ann")
            await client.until("State", "moving")
            refused = await client.call("Home", "bob")
            assert not refused[0]
            assert "park of ann runs since" in refused[1]
            assert await client.call("Stop", "bob") == [True, "park has ended; the array is stopped"]
            still_mm = held.twin.fibre_xy("metrology")
            await client.until("State", "stopped")
            assert await client.read("Text") == "stopped by bob"
            await seen.until("stopped")
            assert [v for v in seen.values if v in ("moving", "stopped")] == ["moving", "stopped"]
            held.twin.run(1.0)
            assert np.abs(held.twin.fibre_xy("metrology") - still_mm).max() < 1e-3
            assert np.hypot(*(still_mm - PLANE.forward(*PLANE.park_deg.T)).T).max() > 1.0
            held.slow.clear()
            assert (await client.call("Configure", "ann", "list.csv"))[0]
            await client.until("Command", "")
            await client.until("State", "idle")

    asyncio.run(night())


def test_a_client_sees_an_alarm_come_and_go(array, server):
    async def night():
        array.book.exclude([4], "ann", "beta slips")
        async with client_of(server) as client:
            seen = await client.follow("AlarmSeverity")
            await client.until("Excluded", [4])
            assert await client.read("Alarms") == []
            array.book.note_stopped("collision of positioners 3, 4", "locked")
            await client.until("AlarmSeverity", 900)
            assert "collision of positioners 3, 4" in (await client.read("Alarms"))[0]
            accepted, text = await client.call("Park", "ann")
            assert not accepted
            assert "fiberloom recover" in text
            array.book.note_stopped("", "idle")
            await client.until("AlarmSeverity", 0)
            assert await client.read("Alarms") == []
            await seen.until(0, events=1)
            assert seen.values == [0, 900, 0]
            ((severity, message),) = seen.events
            assert (severity, "collision of positioners 3, 4" in message) == (900, True)

    asyncio.run(night())


def test_clients_may_not_write_what_is_shown(array, server):
    async def night():
        async with client_of(server) as client:
            node = await client.node.get_child(f"{client.index}:State")
            with pytest.raises(asyncua.ua.UaStatusCodeError):
                await node.write_value("parked")
            assert await client.read("State") == "off"

    asyncio.run(night())


def test_a_port_in_use_is_told(array):
    with socket.socket() as taken:
        taken.bind(("127.0.0.1", 0))
        taken.listen()
        endpoint = Endpoint("127.0.0.1", taken.getsockname()[1])

        async def night():
            async with opcua_server(array, endpoint):
                pass

        with pytest.raises(InputError, match=rf"{endpoint}: Address already in use; choose another port"):
            asyncio.run(night())


def test_without_the_extra_it_says_what_to_install(array, monkeypatch):
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)

    async def night():
        async with opcua_server(array, Endpoint("127.0.0.1", 4840)):
            pass

    with pytest.raises(InputError, match=r"asyncua is not installed: pip install 'fiberloom\[opcua\]'"):
        asyncio.run(night())
