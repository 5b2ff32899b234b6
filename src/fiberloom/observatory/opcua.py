"""An array as an OPC UA server (`pip install 'fiberloom[opcua]'`): variables, events of alarms, methods.

Commands are methods with `who` as first argument; each answers whether it was accepted, and why not.
Variables change within PERIOD_S of what they show.
"""

from __future__ import annotations

import asyncio
import contextlib
import itertools
from collections.abc import AsyncIterator, Callable
from typing import TYPE_CHECKING, Any

from fiberloom.errors import InputError
from fiberloom.observatory.network import Endpoint, need
from fiberloom.observatory.port import BEATS, COMMANDS, PERIOD_S, ArrayPort, ArrayView
from fiberloom.store.service.alarms import Severity

if TYPE_CHECKING:
    from asyncua import Server

NAMESPACE = "urn:fiberloom:array"
NAME = "Array"
DEFAULT_PORT = 4840

OPCUA_SEVERITY = {
    None: 0,
    Severity.ADVICE: 100,
    Severity.MINOR: 300,
    Severity.MAJOR: 600,
    Severity.CRITICAL: 900,
}
"""OPC UA Part 5 (10000-5, 6.4.2): 1 to 1000; low below 334, medium to 666, high above."""


@contextlib.asynccontextmanager
async def opcua_server(array: ArrayPort, endpoint: Endpoint) -> AsyncIterator[str]:
    """Serves an array while the block lasts; its URL. `endpoint`: where to listen.

    InputError where the extra is missing, or the port is in use.
    """
    need("asyncua", "opcua")
    endpoint.require_free()
    server = await _server_at(endpoint)
    shown = await _Shown.on(server, array)
    await server.start()
    follower = asyncio.create_task(shown.follow())
    try:
        yield server.endpoint.geturl()
    finally:
        follower.cancel()
        with contextlib.suppress(asyncio.CancelledError):
            await follower
        await server.stop()


async def _server_at(endpoint: Endpoint) -> Server:
    from asyncua import Server, ua

    server = Server()
    await server.init()
    server.set_endpoint(f"opc.tcp://{endpoint}/fiberloom/")
    server.set_server_name("fiberloom")
    server.set_security_policy([ua.SecurityPolicyType.NoSecurity])
    server.set_identity_tokens([ua.AnonymousIdentityToken])
    return server


def _values(view: ArrayView) -> dict[str, Any]:
    """Of each variable, by its name."""
    return {
        "Address": view.address,
        "State": view.state,
        "Text": view.text,
        "Owner": view.owner,
        "Command": view.command,
        "Positioners": view.positioners,
        "Excluded": list(view.excluded),
        "Alarms": [str(alarm) for alarm in view.alarms],
        "AlarmSeverity": OPCUA_SEVERITY[view.severity],
    }


class _Shown:
    """The object of the array in the address space."""

    def __init__(self, array: ArrayPort, nodes: dict[str, Any], alarm_event: Any) -> None:
        self._array, self._nodes, self._alarm_event = array, nodes, alarm_event
        self._view: ArrayView | None = None

    @classmethod
    async def on(cls, server: Server, array: ArrayPort) -> _Shown:
        from asyncua import ua

        index = await server.register_namespace(NAMESPACE)
        node = await server.nodes.objects.add_object(index, NAME)
        view = await asyncio.to_thread(array.view)
        nodes = {}
        for name, value in _values(view).items():
            kind = ua.VariantType.Int32 if isinstance(value, int) or name == "Excluded" else None
            kind = kind or ua.VariantType.String
            nodes[name] = await node.add_variable(index, name, value, kind)
        for command in COMMANDS:
            await _add_method(node, index, command, getattr(array, command), ["Who"])
        await _add_method(node, index, "configure", array.configure, ["Who", "Targets"])
        nodes["Heartbeat"] = await node.add_variable(index, "Heartbeat", 0, ua.VariantType.Int32)
        event = await server.get_event_generator(emitting_node=node)
        return cls(array, nodes, event)

    async def follow(self) -> None:
        """Shows what changes, until it is cancelled."""
        for beat in itertools.count():
            view = await asyncio.to_thread(self._array.view)
            await self._show(view)
            await self._write("Heartbeat", beat % BEATS)
            await asyncio.sleep(PERIOD_S)

    async def _write(self, name: str, value: Any) -> None:
        node = self._nodes[name]
        await node.write_value(value, await node.read_data_type_as_variant_type())

    async def _show(self, view: ArrayView) -> None:
        before = {} if self._view is None else _values(self._view)
        for name, value in _values(view).items():
            if value != before.get(name):
                await self._write(name, value)
        known = set() if self._view is None else set(self._view.alarms)
        self._view = view
        for alarm in view.alarms:
            if alarm not in known:
                self._alarm_event.event.Severity = OPCUA_SEVERITY[alarm.severity]
                await self._alarm_event.trigger(message=str(alarm))


async def _add_method(node: Any, index: int, name: str, call: Callable[..., str], asked: list[str]) -> None:
    """A method of the object, with strings as input: whether it was accepted, and what there is to say."""
    from asyncua import ua

    async def method(_parent: Any, *given: Any) -> list[Any]:
        try:
            accepted, text = True, await asyncio.to_thread(call, *(str(v.Value or "") for v in given))
        except InputError as error:
            accepted, text = False, str(error)
        return [ua.Variant(accepted), ua.Variant(text)]

    inputs = [_argument(ua, name, ua.ObjectIds.String) for name in asked]
    outputs = [
        _argument(ua, "Accepted", ua.ObjectIds.Boolean),
        _argument(ua, "Said", ua.ObjectIds.String),
    ]
    await node.add_method(index, name.capitalize(), method, inputs, outputs)


def _argument(ua: Any, name: str, kind: int) -> Any:
    argument = ua.Argument()
    argument.Name, argument.DataType, argument.ValueRank = name, ua.NodeId(kind), -1
    return argument
