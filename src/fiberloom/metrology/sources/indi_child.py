"""The process that talks to an INDI server for `IndiSource`.

An image comes as text of 4/3 of its size. To read it holds Python's lock for a second or more, and with it
the event loop that listens to the bus; here it holds up nothing.
"""

from __future__ import annotations

import asyncio
import importlib
import os
import shutil
import signal
import threading
import zlib
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from fiberloom.blocking import finish
from fiberloom.metrology.sources.errors import CameraAborted, CameraError, CameraRefused, ImageBroken

POLL_S = 0.02
BLOB = "CCD1"
"""The property, and its member, in which drivers send the image of the first chip."""
GIVE_UP_S = 1.0
"""What telling the camera to give up may take."""
_SETTLE_S = 1.0
"""So long a driver may take to define what it has; one that reconnects defines it twice."""


@dataclass(frozen=True)
class IndiOrder:
    """One exposure."""

    number: int
    camera: str
    """As messages name it."""
    host: str
    port: int
    device: str
    exposure_s: float
    folder: Path
    """Where the image is written; removed where the process that ordered it has gone."""


@dataclass(frozen=True)
class IndiWord:
    """What is said about the order `number`: what it is at, or its end: an image or an error."""

    number: int
    doing: str = ""
    image: Path | None = None
    """A file as the driver sent it."""
    error: str = ""
    """Name of the CameraError."""
    text: str = ""


def main(fd: int) -> None:
    """Serves the pipe `fd` until it ends: an order begins an exposure, None gives it up."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches both; the other one says what to do
    with suppress(KeyboardInterrupt):
        finish(_serve(Connection(fd)))


async def _serve(connection: Connection) -> None:
    loop = asyncio.get_running_loop()
    orders: asyncio.Queue[IndiOrder | None] = asyncio.Queue()

    def tell(order: IndiOrder | None) -> None:
        loop.call_soon_threadsafe(orders.put_nowait, order)

    threading.Thread(target=_listen, args=(connection, tell), daemon=True).start()
    running: asyncio.Task[None] | None = None
    while True:
        order = await orders.get()
        if running is not None:
            running.cancel()
            await asyncio.wait([running])
        if order is not None:
            running = asyncio.create_task(_carry_out(order, connection))


def _listen(connection: Connection, tell: Callable[[IndiOrder | None], None]) -> None:
    """Hands orders on; where the pipe ends, the process that gave them has gone."""
    folder: Path | None = None
    with suppress(EOFError, OSError):
        while True:
            order: IndiOrder | None = connection.recv()
            folder = order.folder if order else folder
            tell(order)
    if folder is not None:
        shutil.rmtree(folder, ignore_errors=True)
    os._exit(0)


async def _carry_out(order: IndiOrder, connection: Connection) -> None:
    def say(**words: Any) -> None:
        with suppress(OSError):  # the process that asked has gone
            connection.send(IndiWord(order.number, **words))

    try:
        data, kind = await _exposed(order, lambda doing: say(doing=doing))
        say(image=write_blob(order, data, kind))
    except asyncio.CancelledError:
        say(error=CameraAborted.__name__, text=f"{order.camera}: the exposure was given up")
    except CameraError as error:
        say(error=type(error).__name__, text=str(error))
    except Exception as error:  # of the packages, or of a disk that is full
        what = f"{type(error).__name__}: {error}"
        say(error=CameraRefused.__name__, text=f"{order.camera}: no image could be read ({what})")


async def _exposed(order: IndiOrder, doing: Callable[[str], None]) -> tuple[bytes, str]:
    """The image as the driver sends it: its bytes, and their format."""
    talk = _Talk(order, doing)
    running = asyncio.create_task(talk.client.asyncrun())
    try:
        return await talk.expose(order.exposure_s)
    except (CameraError, asyncio.CancelledError):
        await talk.give_up()
        raise
    finally:
        talk.client.shutdown()
        running.cancel()
        with suppress(asyncio.CancelledError):
            await running


def write_blob(order: IndiOrder, data: bytes, kind: str) -> Path:
    """A file with the bytes of a driver, unpacked where their `kind` says that they are packed.

    Raises ImageBroken where they cannot be unpacked.
    """
    if kind.endswith(".z"):
        try:
            data = zlib.decompress(data)
        except zlib.error as error:
            raise ImageBroken(f"{order.camera}: an image that cannot be unpacked: {error}") from None
    path = order.folder / f"image_{order.number}.fits"
    path.write_bytes(data)
    return path


class _Talk:
    """One conversation with the server, within one event loop."""

    def __init__(self, order: IndiOrder, doing: Callable[[str], None]) -> None:
        base = importlib.import_module("indipyclient").IPyClient
        talk = self

        class _IndiEvents(base):  # type: ignore[misc, valid-type]  # of a package without types
            """Hands events on."""

            async def rxevent(self, event: Any) -> None:
                talk.heard(event)

            async def warning(self, message: str) -> None:
                """Not onto the screen: what matters here ends in an error."""

        self.client: Any = _IndiEvents(order.host, order.port)
        self.client.set_vector_timeouts(timeout_enable=False)
        self._order, self._doing = order, doing
        self._image: tuple[bytes, str] | None = None
        self._failed = ""
        self._exposing = False

    def heard(self, event: Any) -> None:
        """An event of the server."""
        if getattr(event, "devicename", None) != self._order.device:
            return
        kind, vector = event.eventtype, getattr(event, "vectorname", "")
        if kind == "SetBLOB" and vector == BLOB and self._exposing:
            member = BLOB if BLOB in event else next(iter(event))
            self._image = event[member], event.sizeformat[member][1]
        elif vector == "CCD_EXPOSURE" and self._exposing and getattr(event, "state", "") == "Alert":
            self._failed = self._last_message() or "the exposure failed"

    async def expose(self, exposure_s: float) -> tuple[bytes, str]:
        """Connects the camera, sets the whole frame, exposes."""
        name = self._order.device
        await self._until(lambda: name in self.client, f"looking for the camera {name}")
        await self._until(lambda: self._has("CONNECTION"), "connecting")
        if self._value("CONNECTION", "CONNECT") != "On":
            await self._set("CONNECTION", {"CONNECT": "On", "DISCONNECT": "Off"})
        await self._until(lambda: self._value("CONNECTION", "CONNECT") == "On", "connecting the camera")
        await self._until(lambda: self._has("CCD_EXPOSURE") and self._has(BLOB), "asking what the camera has")
        await self._whole_frame()
        # without the name of the property some servers send nothing
        await self.client.send_enableBLOB("Also", name)
        await self.client.send_enableBLOB("Also", name, BLOB)
        self._exposing = True
        await self._set("CCD_EXPOSURE", {"CCD_EXPOSURE_VALUE": exposure_s})
        await self._until(lambda: self._image is not None, "exposing")
        assert self._image is not None
        return self._image

    async def give_up(self) -> None:
        """So that the camera is free for the next exposure."""
        with suppress(Exception):
            await asyncio.wait_for(self._set("CCD_ABORT_EXPOSURE", {"ABORT": "On"}), GIVE_UP_S)

    async def _whole_frame(self) -> None:
        """No binning, no part of the frame, plain FITS, as far as the driver has these."""
        settled_s = asyncio.get_running_loop().time() + _SETTLE_S
        while not self._has("CCD_INFO") and asyncio.get_running_loop().time() < settled_s:
            await asyncio.sleep(POLL_S)
        if self._has("CCD_BINNING"):
            await self._set("CCD_BINNING", {"HOR_BIN": 1, "VER_BIN": 1})
        width, height = (self._value("CCD_INFO", key) for key in ("CCD_MAX_X", "CCD_MAX_Y"))
        if self._has("CCD_FRAME") and width and height:
            await self._set("CCD_FRAME", {"X": 0, "Y": 0, "WIDTH": float(width), "HEIGHT": float(height)})
        if self._has("UPLOAD_MODE"):
            modes = dict.fromkeys(self.client[self._order.device]["UPLOAD_MODE"], "Off")
            await self._set("UPLOAD_MODE", modes | {"UPLOAD_CLIENT": "On"})

    async def _until(self, condition: Callable[[], bool], doing: str) -> None:
        self._doing(doing)
        while not condition():
            if self._failed:
                raise CameraRefused(f"{self._order.camera}: {self._failed}")
            await asyncio.sleep(POLL_S)

    def _has(self, vector: str) -> bool:
        device = self.client.get(self._order.device, {})
        return vector in device and bool(device[vector].enable)

    def _value(self, vector: str, member: str) -> Any:
        device = self.client.get(self._order.device, {})
        return device[vector].get(member) if vector in device else None

    async def _set(self, vector: str, members: dict[str, Any]) -> None:
        await self.client.send_newVector(self._order.device, vector, members=members)

    def _last_message(self) -> str:
        device = self.client.get(self._order.device)
        messages = getattr(device, "messages", None)
        return str(messages[0][1]) if messages else ""
