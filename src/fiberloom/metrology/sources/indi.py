"""A camera by INDI, with `indipyclient`: whatever driver an `indiserver` runs."""

from __future__ import annotations

import asyncio
import importlib
import socket
import tempfile
import zlib
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

from fiberloom.blocking import finish
from fiberloom.errors import InputError
from fiberloom.metrology.images import CameraImage
from fiberloom.metrology.sources.deadline import Deadline
from fiberloom.metrology.sources.errors import (
    CameraError,
    CameraRefused,
    CameraSilent,
    ImageBroken,
)
from fiberloom.metrology.sources.fits import FitsForeign, FitsIncomplete, check_complete
from fiberloom.metrology.sources.folder import image_in_memory
from fiberloom.metrology.sources.remote import ExposureSettings, RemoteSource

POLL_S = 0.02
BLOB = "CCD1"
"""The property, and its member, in which drivers send the image of the first chip."""
_CONNECT_S = 5.0
_SETTLE_S = 1.0
"""So long a driver may take to define what it has; one that reconnects defines it twice."""


class IndiSource(RemoteSource):
    """The camera `name` at the server `host` and `port`; see `RemoteSource`."""

    def __init__(self, host: str, port: int, name: str, settings: ExposureSettings) -> None:
        super().__init__(f"indi://{host}:{port}/{name}", settings)
        self.host, self.port, self.device = host, port, name

    def _take(self, deadline: Deadline) -> CameraImage:
        deadline.doing = "connecting"
        try:
            socket.create_connection((self.host, self.port), min(_CONNECT_S, deadline.left_s())).close()
        except OSError as error:
            raise CameraSilent(
                f"{self.name}: no connection ({error}); is indiserver running, and is this its address?"
            ) from None
        data, kind = finish(self._exposed(deadline))
        return self._image(data, kind)

    async def _exposed(self, deadline: Deadline) -> tuple[bytes, str]:
        """The image as the driver sends it: its bytes, and their format."""
        talk = _Talk(self, deadline)
        running = asyncio.create_task(talk.client.asyncrun())
        try:
            return await talk.expose(self.settings.exposure_s)
        except CameraError:
            await talk.give_up()
            raise
        finally:
            talk.client.shutdown()
            running.cancel()
            with suppress(asyncio.CancelledError):
                await running

    def _image(self, data: bytes, kind: str) -> CameraImage:
        if kind.endswith(".z"):
            try:
                data = zlib.decompress(data)
            except zlib.error as error:
                raise ImageBroken(f"{self.name}: an image that cannot be unpacked: {error}") from None
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder) / "image.fits"
            path.write_bytes(data)
            try:
                check_complete(path)
                return image_in_memory(path)
            except (FitsIncomplete, FitsForeign, InputError) as error:
                raise ImageBroken(
                    f"{self.name}: no whole image in FITS ({error}); take another one"
                ) from None


class _Talk:
    """One conversation with the server, within one event loop."""

    def __init__(self, source: IndiSource, deadline: Deadline) -> None:
        base = importlib.import_module("indipyclient").IPyClient
        talk = self

        class _IndiEvents(base):  # type: ignore[misc, valid-type]  # of a package without types
            """Hands events on."""

            async def rxevent(self, event: Any) -> None:
                talk.heard(event)

            async def warning(self, message: str) -> None:
                """Not onto the screen: what matters here ends in an error."""

        self.client: Any = _IndiEvents(source.host, source.port)
        self.client.set_vector_timeouts(timeout_enable=False)
        self._source, self._deadline = source, deadline
        self._image: tuple[bytes, str] | None = None
        self._failed = ""
        self._exposing = False

    def heard(self, event: Any) -> None:
        """An event of the server."""
        if getattr(event, "devicename", None) != self._source.device:
            return
        kind, vector = event.eventtype, getattr(event, "vectorname", "")
        if kind == "SetBLOB" and vector == BLOB and self._exposing:
            member = BLOB if BLOB in event else next(iter(event))
            self._image = event[member], event.sizeformat[member][1]
        elif vector == "CCD_EXPOSURE" and self._exposing and getattr(event, "state", "") == "Alert":
            self._failed = self._last_message() or "the exposure failed"

    async def expose(self, exposure_s: float) -> tuple[bytes, str]:
        """Connects the camera, sets the whole frame, exposes."""
        name = self._source.device
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
            await asyncio.wait_for(self._set("CCD_ABORT_EXPOSURE", {"ABORT": "On"}), 1.0)

    async def _whole_frame(self) -> None:
        """No binning, no part of the frame, plain FITS, as far as the driver has these."""
        settled_s = asyncio.get_running_loop().time() + _SETTLE_S
        while not self._has("CCD_INFO") and asyncio.get_running_loop().time() < settled_s:
            await self._pause()
        if self._has("CCD_BINNING"):
            await self._set("CCD_BINNING", {"HOR_BIN": 1, "VER_BIN": 1})
        width, height = (self._value("CCD_INFO", key) for key in ("CCD_MAX_X", "CCD_MAX_Y"))
        if self._has("CCD_FRAME") and width and height:
            await self._set("CCD_FRAME", {"X": 0, "Y": 0, "WIDTH": float(width), "HEIGHT": float(height)})
        if self._has("UPLOAD_MODE"):
            modes = dict.fromkeys(self.client[self._source.device]["UPLOAD_MODE"], "Off")
            await self._set("UPLOAD_MODE", modes | {"UPLOAD_CLIENT": "On"})

    async def _until(self, condition: Callable[[], bool], doing: str) -> None:
        self._deadline.doing = doing
        while not condition():
            if self._failed:
                raise CameraRefused(f"{self._source.name}: {self._failed}")
            await self._pause()

    async def _pause(self) -> None:
        self._deadline.check()
        await asyncio.sleep(POLL_S)

    def _has(self, vector: str) -> bool:
        device = self.client.get(self._source.device, {})
        return vector in device and bool(device[vector].enable)

    def _value(self, vector: str, member: str) -> Any:
        device = self.client.get(self._source.device, {})
        return device[vector].get(member) if vector in device else None

    async def _set(self, vector: str, members: dict[str, Any]) -> None:
        await self.client.send_newVector(self._source.device, vector, members=members)

    def _last_message(self) -> str:
        device = self.client.get(self._source.device)
        messages = getattr(device, "messages", None)
        return str(messages[0][1]) if messages else ""
