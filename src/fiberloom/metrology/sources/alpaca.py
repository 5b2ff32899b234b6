"""A camera by ASCOM Alpaca: HTTP with JSON, and ImageBytes for the pixels (JSON where it lacks them)."""

from __future__ import annotations

import json
import socket
import time
from collections.abc import Mapping
from contextlib import closing, suppress
from dataclasses import dataclass
from typing import Any

import numpy as np

from fiberloom.metrology.images import CameraImage, utc_s_of
from fiberloom.metrology.sources import imagebytes
from fiberloom.metrology.sources.deadline import Deadline
from fiberloom.metrology.sources.errors import CameraError, CameraRefused, CameraSilent, ImageBroken
from fiberloom.metrology.sources.http import CameraHttp
from fiberloom.metrology.sources.remote import ExposureSettings, RemoteSource
from fiberloom.typing import Array

PORT = 11111
"""Where Alpaca servers listen by custom."""
DISCOVERY_PORT, DISCOVERY_QUESTION, DISCOVERY_KEY = 32227, b"alpacadiscovery1", "AlpacaPort"
"""Servers answer the question, sent to all by UDP, with the port at which they listen."""
_EVERYWHERE = ("255.255.255.255", "127.255.255.255")
_DISCOVERY_S = 0.5
_DISCOVERY_BYTES = 4096
NOT_IMPLEMENTED = 0x400
POLL_S, _SLOW_POLL_S, _POLL_SHARE = 0.05, 0.5, 0.02
"""How often it is asked whether the image is ready: a share of the exposure, between these."""
_LAST_WORD_S = 1.0
"""What telling the camera to give up may take."""
_JSON_BYTES_PX = 24
"""Of one pixel as text, at most."""
_FAILED = 5
"""CameraState: error."""
_CLIENT = "1886"


class _NotThere(CameraRefused):
    """A member of the interface that this camera does not have."""


class AlpacaCalls:
    """Members of one Alpaca camera over one connection."""

    def __init__(self, http: CameraHttp, device: int) -> None:
        self._http, self._path = http, f"/api/v1/camera/{device}"
        self._transaction = 0

    def get(self, member: str) -> Any:
        """Value of a property."""
        _, data = self._http.get(f"{self._path}/{member}", self._numbers())
        return self._answer(member, data).get("Value")

    def known(self, member: str, otherwise: Any) -> Any:
        """Value of a property, or `otherwise` where the camera does not have it."""
        try:
            return self.get(member)
        except _NotThere:
            return otherwise

    def put(self, member: str, **form: str) -> None:
        """Sets a property, or calls a method."""
        self._answer(member, self._http.put(f"{self._path}/{member}", form | self._numbers()))

    def image(self, n_pixels: int) -> Array:
        """The image, of at most `n_pixels`."""
        kind, data = self._http.get(
            f"{self._path}/imagearray",
            self._numbers(),
            accept=f"{imagebytes.CONTENT_TYPE}, application/json;q=0.5",
            limit=_JSON_BYTES_PX * n_pixels + (1 << 21),
        )
        if imagebytes.CONTENT_TYPE in kind.lower():
            return imagebytes.unpack(data, self._http.camera)
        return self._pixels_of_json(self._answer("imagearray", data))

    def _pixels_of_json(self, answer: Mapping[str, Any]) -> Array:
        try:
            columns = np.array(answer.get("Value"))
        except ValueError:  # rows of unlike lengths
            columns = np.zeros(0)
        if columns.ndim != 2 or not columns.size or columns.dtype.kind not in "iuf":
            raise ImageBroken(f"{self._http.camera}: JSON that is no image in grey of two dimensions")
        return imagebytes.plain_pixels(columns.T)

    def _numbers(self) -> dict[str, str]:
        self._transaction += 1
        return {"ClientID": _CLIENT, "ClientTransactionID": str(self._transaction)}

    def _answer(self, member: str, data: memoryview) -> dict[str, Any]:
        camera = self._http.camera
        try:
            answer = json.loads(bytes(data))
            number = int(answer["ErrorNumber"])
        except (ValueError, KeyError, TypeError):
            raise CameraRefused(f"{camera}: its answer to {member} is not of Alpaca; is it one?") from None
        if number:
            kind = _NotThere if number == NOT_IMPLEMENTED else CameraRefused
            text = answer.get("ErrorMessage") or "without a word"
            raise kind(f"{camera}: error 0x{number & 0xFFFFFFFF:X} at {member}: {text}")
        return dict(answer)


@dataclass(frozen=True)
class AlpacaCamera:
    """What a camera says of itself."""

    width_px: int
    height_px: int
    saturation_adu: float
    gain_e_adu: float


class AlpacaSource(RemoteSource):
    """A camera number `device` at `host` and `port`; see `RemoteSource`."""

    def __init__(self, host: str, port: int, device: int, settings: ExposureSettings) -> None:
        super().__init__(f"alpaca://{host}:{port}/{device}", settings)
        self.host, self.port, self.device = host, port, device
        self._about: AlpacaCamera | None = None
        self._others: str | None = None

    def _take(self, deadline: Deadline) -> CameraImage:
        http = CameraHttp(self.host, self.port, deadline)
        try:
            with closing(http):
                return self._exposed(AlpacaCalls(http, self.device), deadline)
        except CameraError as error:
            self._about = None  # asked anew next time: it may be another camera by then
            if http.reached:
                self._give_up()
            elif isinstance(error, CameraSilent):
                raise CameraSilent(f"{error}{self._where_else()}") from None
            raise

    def _exposed(self, camera: AlpacaCalls, deadline: Deadline) -> CameraImage:
        deadline.doing = "connecting"
        about = self._about = self._about or self._prepared(camera)
        deadline.doing = "exposing"
        camera.put("startexposure", Duration=f"{self.settings.exposure_s:.10g}", Light="True")
        self._wait_ready(camera, deadline)
        deadline.doing = "reading the image"
        begun, lasted_s = self._stamp(camera)
        pixels = camera.image(about.width_px * about.height_px)
        return CameraImage(
            pixels,
            gain_e_adu=about.gain_e_adu,
            saturation_adu=about.saturation_adu,
            exposure_s=lasted_s,
            time_s=begun or 0.0,
            begun_utc_s=begun,
            header={"INSTRUME": self.name},
        )

    def _prepared(self, camera: AlpacaCalls) -> AlpacaCamera:
        """Connected, the whole frame without binning."""
        camera.put("connected", Connected="True")
        if camera.known("sensortype", 0) not in (0, None):
            raise CameraRefused(f"{self.name}: a colour camera; images in grey are needed")
        width, height = _count(camera.get("cameraxsize")), _count(camera.get("cameraysize"))
        if not width or not height:
            raise CameraRefused(f"{self.name}: says that it has {width} x {height} px")
        whole = {"BinX": 1, "BinY": 1, "StartX": 0, "StartY": 0, "NumX": width, "NumY": height}
        for key, value in whole.items():
            with suppress(_NotThere):
                camera.put(key.lower(), **{key: str(value)})
        return AlpacaCamera(
            width,
            height,
            _positive(camera.known("maxadu", None), np.inf),
            _positive(camera.known("electronsperadu", None), 1.0),
        )

    def _wait_ready(self, camera: AlpacaCalls, deadline: Deadline) -> None:
        # asked all the time: a twin's seconds may be shorter
        poll_s = min(max(self.settings.exposure_s * _POLL_SHARE, POLL_S), _SLOW_POLL_S)
        while camera.get("imageready") is not True:
            if camera.known("camerastate", 0) == _FAILED:
                raise CameraRefused(f"{self.name}: its state is error; look at its program")
            deadline.wait(poll_s)

    def _stamp(self, camera: AlpacaCalls) -> tuple[float | None, float]:
        """When the exposure began (UTC s), where the camera tells; how long it lasted."""
        text = camera.known("lastexposurestarttime", None)
        lasted = camera.known("lastexposureduration", None)
        return utc_s_of(str(text)) if text else None, _positive(lasted, self.settings.exposure_s)

    def _where_else(self) -> str:
        """Servers that answer, for one who may have the wrong address; searched for once."""
        if self._others is None:
            found = ", ".join(f"alpaca://{place}" for place in alpaca_servers())
            self._others = f" Alpaca servers that answer: {found}" if found else ""
        return self._others

    def _give_up(self) -> None:
        """So that the camera is free for the next exposure, if it hears."""
        last = Deadline(self.name, _LAST_WORD_S)
        with suppress(CameraError), closing(CameraHttp(self.host, self.port, last)) as http:
            AlpacaCalls(http, self.device).put("abortexposure")
        last.close()


def alpaca_servers() -> list[str]:
    """Alpaca servers of the local network that say where they are, as HOST:PORT; takes half a second."""
    found: set[str] = set()
    end_s = time.monotonic() + _DISCOVERY_S
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as asking:
        asking.setsockopt(socket.SOL_SOCKET, socket.SO_BROADCAST, 1)
        for place in _EVERYWHERE:
            with suppress(OSError):  # no such network
                asking.sendto(DISCOVERY_QUESTION, (place, DISCOVERY_PORT))
        while (left_s := end_s - time.monotonic()) > 0.0:
            asking.settimeout(left_s)
            with suppress(OSError, ValueError, KeyError, TypeError):  # silence, or no answer of Alpaca
                said, (host, _) = asking.recvfrom(_DISCOVERY_BYTES)
                found.add(f"{host}:{int(json.loads(said)[DISCOVERY_KEY])}")
    return sorted(found)


def _count(value: object) -> int:
    return value if isinstance(value, int) and not isinstance(value, bool) and value > 0 else 0


def _positive(value: object, otherwise: float) -> float:
    number = isinstance(value, int | float) and not isinstance(value, bool) and 0 < value < np.inf
    return float(value) if number else otherwise  # type: ignore[arg-type]
