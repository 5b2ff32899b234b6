"""The stream: one WebSocket a client, events as JSON and pictures as bytes."""

from __future__ import annotations

import asyncio
import contextlib

from starlette.websockets import WebSocket, WebSocketDisconnect

from fiberloom.service.hub import Hub, StreamClient
from fiberloom.service.live import Live
from fiberloom.service.metrics import Metrics

PICTURE_S = 0.1
"""Between two pictures, at least."""
TRY_LATER = 1013


async def serve_stream(socket: WebSocket, hub: Hub, live: Live) -> None:
    """Serves one client until it leaves; what it sends is not read as anything.

    `socket`: of the client, not yet accepted; `hub`: of events; `live`: its first picture.
    """
    client = hub.join()
    await socket.accept()
    if client is None:
        await socket.close(TRY_LATER, "too many clients")
        return
    client.show(live.frame(0)[1])
    sending = asyncio.create_task(_send(socket, client))
    try:
        await _until_left(socket)
    finally:
        hub.leave(client)
        sending.cancel()


async def _send(socket: WebSocket, client: StreamClient) -> None:
    with contextlib.suppress(WebSocketDisconnect, RuntimeError, OSError):  # a client that leaves is no error
        while True:
            for message in await client.next():
                if isinstance(message, bytes):
                    await socket.send_bytes(message)
                else:
                    await socket.send_text(message)


async def _until_left(socket: WebSocket) -> None:
    while (await socket.receive())["type"] != "websocket.disconnect":
        pass


async def show_pictures(hub: Hub, live: Live, metrics: Metrics) -> None:
    """Shows every change to all clients, at most ten a second; measures how late its own loop is."""
    loop, number, shown = asyncio.get_running_loop(), 0, 0
    while True:
        begun_s = loop.time()
        await asyncio.sleep(PICTURE_S)
        metrics.lag_s.set(max(loop.time() - begun_s - PICTURE_S, 0.0))
        if not len(hub):
            continue
        with contextlib.suppress(ConnectionError):  # a bus that is gone has no clock
            changed, picture = live.frame(number + 1)
            if changed == -1 or changed != shown:
                number, shown = number + 1, changed
                hub.show(picture)
