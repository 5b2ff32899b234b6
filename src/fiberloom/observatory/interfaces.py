"""Both interfaces beside each other, for as long as a block lasts."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator
from dataclasses import dataclass

from fiberloom.observatory.epics import EpicsIoc
from fiberloom.observatory.network import Endpoint, need
from fiberloom.observatory.opcua import opcua_server
from fiberloom.observatory.port import ArrayPort


@dataclass(frozen=True)
class Interfaces:
    """Which interfaces are wanted, and where."""

    opcua: Endpoint | None = None
    prefix: str = ""
    """Of EPICS records."""
    epics: Endpoint | None = None

    def require(self) -> None:
        """InputError where a package is missing, or a port is in use: told before anything is begun."""
        if self.opcua is not None:
            need("asyncua", "opcua")
            self.opcua.require_free()
        if self.epics is not None:
            need("softioc", "epics")

    def told(self) -> list[str]:
        """What clients need, in words."""
        said = [] if self.opcua is None else [f"OPC UA: opc.tcp://{self.opcua}/fiberloom/"]
        return said + ([f"EPICS_CA_ADDR_LIST={self.epics}: {self.prefix}:STATE, ..."] if self.epics else [])

    @contextlib.asynccontextmanager
    async def shown(self, array: ArrayPort) -> AsyncIterator[None]:
        """Shows an `array` while the block lasts."""
        async with contextlib.AsyncExitStack() as stack:
            if self.opcua is not None:
                await stack.enter_async_context(opcua_server(array, self.opcua))
            if self.epics is not None:
                ioc = asyncio.create_task(EpicsIoc(array, self.prefix, self.epics).run())
                stack.callback(ioc.cancel)
            yield
