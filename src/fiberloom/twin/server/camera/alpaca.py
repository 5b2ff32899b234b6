"""The twin's camera as ASCOM Alpaca serves one: ICameraV3, images as ImageBytes or JSON, management."""

from __future__ import annotations

import itertools
import json
import math
import sys
import threading
from collections.abc import Callable, Mapping
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, ClassVar
from urllib.parse import parse_qsl, urlsplit

from fiberloom.metrology.images import CameraImage, utc_text
from fiberloom.metrology.sources import imagebytes
from fiberloom.twin.faults.kinds import CameraFaultKind
from fiberloom.twin.server.camera.exposing import ExposureError, ShutterState, TwinShutter
from fiberloom.version import __version__

NOT_IMPLEMENTED, INVALID_VALUE, NOT_CONNECTED, INVALID_OPERATION = 0x400, 0x401, 0x407, 0x40B
BODY_BYTES = 1 << 16
LONGEST_S = 3600.0
_NAME = "fiberloom twin"

_Form = Mapping[str, str]


class AscomError(Exception):
    """An error as Alpaca numbers them; sent with HTTP 200."""

    def __init__(self, number: int, text: str) -> None:
        super().__init__(text)
        self.number = number


class BadCall(Exception):
    """A request that is none of the interface: HTTP 400."""


class AlpacaDevice:
    """Members of ICameraV3 of one shutter. No sockets."""

    def __init__(self, shutter: TwinShutter) -> None:
        self.shutter = shutter
        self.connected = False
        model = shutter.camera.model
        detector, geometry = model.detector, model.optics.geometry
        self.size_px = geometry.width_px, geometry.height_px
        top_adu = detector.bias_adu + detector.full_well_e / detector.gain_e_adu
        self.values: dict[str, Any] = {
            "description": "Camera of a fiberloom twin", "driverinfo": "fiberloom twin",
            "driverversion": __version__, "interfaceversion": 3, "name": _NAME, "supportedactions": [],
            "binx": 1, "biny": 1, "maxbinx": 1, "maxbiny": 1, "startx": 0, "starty": 0,
            "cameraxsize": self.size_px[0], "cameraysize": self.size_px[1],
            "numx": self.size_px[0], "numy": self.size_px[1],
            "canabortexposure": True, "canstopexposure": False, "canasymmetricbin": False,
            "canfastreadout": False, "cangetcoolerpower": False, "canpulseguide": False,
            "cansetccdtemperature": False, "hasshutter": False, "ispulseguiding": False,
            "electronsperadu": detector.gain_e_adu * model.average, "fullwellcapacity": detector.full_well_e,
            "maxadu": int(min(top_adu, 65535.0)), "exposuremin": 0.0, "exposuremax": LONGEST_S,
            "exposureresolution": 0.0, "pixelsizex": 9.0, "pixelsizey": 9.0, "readoutmode": 0,
            "readoutmodes": ["whole frame"], "sensorname": "twin", "sensortype": 0,
        }  # fmt: skip
        self._asked: dict[str, Callable[[], Any]] = {
            "connected": lambda: self.connected,
            "camerastate": lambda: int(shutter.state),
            "imageready": lambda: shutter.image is not None,
            "percentcompleted": lambda: 100 if shutter.state is ShutterState.IDLE else 0,
            "lastexposurestarttime": lambda: utc_text(self._image().begun_utc_s or 0.0),
            "lastexposureduration": lambda: self._image().exposure_s,
        }
        self._told: dict[str, Callable[[_Form], None]] = {
            "connected": self._connect,
            "startexposure": self._start,
            "abortexposure": lambda form: shutter.give_up(),
        }

    def get(self, member: str) -> Any:
        """Value of a property. Raises AscomError, BadCall, ExposureError."""
        if member == "connected":
            return self.connected
        self._check(member)
        if member in self.values:
            return self.values[member]
        if member in self._asked:
            return self._asked[member]()
        raise AscomError(NOT_IMPLEMENTED, f"{member} is not in this camera")

    def put(self, member: str, form: _Form) -> None:
        """Sets a property or calls a method. Raises likewise."""
        if member != "connected":
            self._check(member)
        if member in self._told:
            self._told[member](form)
        elif member in _WHOLE_FRAME:
            self._keep(member, form)
        else:
            raise AscomError(NOT_IMPLEMENTED, f"{member} is not in this camera")

    def image(self) -> CameraImage:
        """The pixels. Raises likewise."""
        self._check("imagearray")
        return self._image()

    def _check(self, member: str) -> None:
        if member not in MEMBERS:
            raise BadCall(f"no member {member} in ICameraV3")
        if not self.connected and member not in _UNCONNECTED:
            raise AscomError(NOT_CONNECTED, "not connected")
        if member not in _UNCONNECTED:
            self.shutter.check()

    def _image(self) -> CameraImage:
        image = self.shutter.image
        if image is None:
            raise AscomError(INVALID_OPERATION, "no image is ready")
        return image

    def _connect(self, form: _Form) -> None:
        self.connected = _truth(form, "Connected")

    def _start(self, form: _Form) -> None:
        duration_s = _number(form, "Duration")
        _truth(form, "Light")
        if not 0.0 <= duration_s <= LONGEST_S:
            raise AscomError(INVALID_VALUE, f"Duration {duration_s:g}: 0 to {LONGEST_S:g} s")
        self.shutter.start(duration_s)

    def _keep(self, member: str, form: _Form) -> None:
        """The frame is always whole."""
        value = _number(form, _WHOLE_FRAME[member])
        if value != self.values[member]:
            raise AscomError(INVALID_VALUE, f"{_WHOLE_FRAME[member]} {value:g}: only {self.values[member]}")


_WHOLE_FRAME = {
    name.lower(): name for name in ("BinX", "BinY", "StartX", "StartY", "NumX", "NumY", "ReadoutMode")
}
_UNCONNECTED = frozenset(
    {
        "connected",
        "description",
        "driverinfo",
        "driverversion",
        "interfaceversion",
        "name",
        "supportedactions",
    }
)
_LACKING = (
    "action bayeroffsetx bayeroffsety ccdtemperature commandblind commandbool commandstring cooleron "
    "coolerpower fastreadout gain gainmax gainmin gains heatsinktemperature imagearray imagearrayvariant "
    "offset offsetmax offsetmin offsets pulseguide setccdtemperature stopexposure subexposureduration"
)
_MEMBERS = (
    "abortexposure binx biny camerastate cameraxsize cameraysize canabortexposure canasymmetricbin "
    "canfastreadout cangetcoolerpower canpulseguide cansetccdtemperature canstopexposure electronsperadu "
    "exposuremax exposuremin exposureresolution fullwellcapacity hasshutter imageready ispulseguiding "
    "lastexposureduration lastexposurestarttime maxadu maxbinx maxbiny numx numy percentcompleted "
    "pixelsizex pixelsizey readoutmode readoutmodes sensorname sensortype startexposure startx starty"
)
MEMBERS = frozenset(f"{_MEMBERS} {_LACKING}".split()) | _UNCONNECTED
"""Of the interface, whether this camera has them or not."""


def _number(form: _Form, key: str) -> float:
    try:
        number = float(form[key])
    except KeyError:
        raise BadCall(f"{key} is missing") from None
    except ValueError:
        raise BadCall(f"{key} {form[key]!r} is not a number") from None
    if not math.isfinite(number):
        raise BadCall(f"{key} {form[key]!r} is not a number")
    return number


def _truth(form: _Form, key: str) -> bool:
    value = form.get(key, "").lower()
    if value not in ("true", "false"):
        raise BadCall(f"{key} {value!r}: True or False")
    return value == "true"


def _transaction(parameters: _Form) -> int:
    text = parameters.get("clienttransactionid", "0")
    return int(text) if text.isdecimal() and int(text) < 1 << 31 else 0


class _Handler(BaseHTTPRequestHandler):
    """One connection of a host."""

    protocol_version = "HTTP/1.1"
    server_version = f"fiberloom/{__version__}"
    timeout = 60
    disable_nagle_algorithm = True
    device: ClassVar[AlpacaDevice]
    transactions: ClassVar[itertools.count[int]]

    def do_GET(self) -> None:
        parts = urlsplit(self.path)
        query = {key.lower(): value for key, value in parse_qsl(parts.query)}
        self._serve(parts.path, lambda member: self.device.get(member), query)

    def do_PUT(self) -> None:
        length = self.headers.get("Content-Length", "0")
        if not length.isdecimal() or int(length) > BODY_BYTES:
            self.close_connection = True
            self._send(413, "text/plain", b"too long")
            return
        body = self.rfile.read(int(length)).decode("utf-8", "replace")
        form = dict(parse_qsl(body))
        plain = {key.lower(): value for key, value in form.items()}
        self._serve(urlsplit(self.path).path, lambda member: self.device.put(member, form), plain)

    def _serve(self, path: str, act: Callable[[str], Any], parameters: _Form) -> None:
        client, number = _transaction(parameters), next(self.transactions)
        words = path.strip("/").split("/")
        try:
            if words[0] == "management":
                self._answer(client, number, _management(words[1:]))
            elif words[:4] == ["api", "v1", "camera", "0"] and len(words) == 5:
                if words[4] in ("imagearray", "imagearrayvariant") and self.command == "GET":
                    self._send_image(client, number)
                else:
                    self._answer(client, number, act(words[4]))
            elif words[0] == "setup":
                self._send(200, "text/plain", b"The camera of a twin: options of `fiberloom twin` set it up.")
            else:
                raise BadCall(f"{path}: there is /api/v1/camera/0 alone")
        except AscomError as error:
            self._answer(client, number, None, error)
        except BadCall as error:
            self._send(400, "text/plain", str(error).encode())
        except ExposureError as error:
            self._send(500, "text/plain", str(error).encode())

    def _answer(self, client: int, number: int, value: Any, error: AscomError | None = None) -> None:
        said = {
            "ClientTransactionID": client,
            "ServerTransactionID": number,
            "ErrorNumber": error.number if error else 0,
            "ErrorMessage": str(error) if error else "",
        }
        if value is not None:
            said["Value"] = value
        self._send(200, "application/json", json.dumps(said).encode())

    def _send_image(self, client: int, number: int) -> None:
        binary = imagebytes.CONTENT_TYPE in self.headers.get("Accept", "").lower()
        pixels = self.device.image().array()  # an error goes as JSON: alpyca reads no other
        if binary:
            self._send(200, imagebytes.CONTENT_TYPE, *imagebytes.pack(pixels, client, number))
        else:
            whole = pixels.dtype.kind == "u"
            said = {
                "Type": imagebytes.INT32 if whole else imagebytes.DOUBLE, "Rank": 2,
                "Value": pixels.T.tolist(), "ClientTransactionID": client, "ServerTransactionID": number,
                "ErrorNumber": 0, "ErrorMessage": "",
            }  # fmt: skip
            self._send(200, "application/json", json.dumps(said).encode())

    def _send(self, status: int, kind: str, *parts: bytes | memoryview) -> None:
        length = sum(len(part) for part in parts)
        self.send_response(status)
        self.send_header("Content-Type", kind)
        self.send_header("Content-Length", str(length))
        self.end_headers()
        if len(parts) > 1 and CameraFaultKind.HALF in self.device.shutter.faults():
            self.wfile.write(parts[0])
            self.wfile.write(parts[1][: length // 2])
            self.close_connection = True
            return
        for part in parts:
            self.wfile.write(part)

    def log_message(self, format: str, *args: Any) -> None:
        """Nothing: the twin reports at its end."""


def _management(words: list[str]) -> Any:
    match words:
        case ["apiversions"]:
            return [1]
        case ["v1", "description"]:
            return {
                "ServerName": _NAME,
                "Manufacturer": "fiberloom",
                "ManufacturerVersion": __version__,
                "Location": "",
            }
        case ["v1", "configureddevices"]:
            about = {"DeviceName": _NAME, "DeviceType": "Camera", "DeviceNumber": 0}
            return [about | {"UniqueID": "fiberloom-twin-camera-0"}]
    raise BadCall(f"/management/{'/'.join(words)}: no such page")


class _Server(ThreadingHTTPServer):
    """Says nothing of a client that goes away before it has its answer: it may have been killed."""

    def handle_error(self, request: Any, client_address: Any) -> None:
        if not isinstance(sys.exception(), ConnectionError):
            super().handle_error(request, client_address)


class AlpacaServer:
    """Serves a shutter at `host` and `port` until `close`; port 0: one that the system chooses."""

    def __init__(self, shutter: TwinShutter, host: str, port: int) -> None:
        own = {"device": AlpacaDevice(shutter), "transactions": itertools.count(1)}
        handler = type("AlpacaHandler", (_Handler,), own)
        self._server = _Server((host, port), handler)
        self._server.daemon_threads = True
        self.port = int(self._server.server_address[1])
        self._thread = threading.Thread(target=self._server.serve_forever, args=(0.1,), daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Listens no longer."""
        self._server.shutdown()
        self._server.server_close()
        self._thread.join()
