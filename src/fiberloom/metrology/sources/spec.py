"""A camera by its address: `--camera URL`.

    alpaca://HOST[:PORT][/NUMBER]?exposure=5
    folder:PATH?trigger=COMMAND&exposure=5
    indi://HOST[:PORT]/NAME?exposure=5
    aravis:NAME?exposure=5

Parameters of every camera: `exposure`, `deadline`, `clock` (seconds), `retries`, `gain` (electrons per unit),
`saturation` (units). Values are percent-encoded where they hold `&`, `%` or `#`.
"""

from __future__ import annotations

import importlib
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Any
from urllib.parse import unquote

from fiberloom.errors import InputError
from fiberloom.files import tcp_port
from fiberloom.instruments import FocalPlane
from fiberloom.metrology.acquisition import CameraGeometry
from fiberloom.metrology.cameras import check_fiducials, image_camera_of, view_of
from fiberloom.metrology.pipeline import ImageCamera
from fiberloom.metrology.sources.remote import ExposureSettings, RemoteSource

FORMS = (
    "alpaca://HOST:PORT/NUMBER",
    "folder:PATH?trigger=COMMAND",
    "indi://HOST:PORT/NAME",
    "aravis:NAME",
)
_PORTS = {"alpaca": 11111, "indi": 7624}
_NUMBERS = {
    "exposure": "exposure_s",
    "deadline": "deadline_s",
    "clock": "clock_s",
    "gain": "gain_e_adu",
    "saturation": "saturation_adu",
}
_OWN = {"folder": ("trigger", "pattern")}
"""Further parameters of one kind of camera."""


@dataclass(frozen=True)
class CameraSpec:
    """A parsed address; `open_source` and `open_camera` open it."""

    scheme: str
    place: str
    """Host and port, or a path, or a name."""
    name: str = ""
    """Of the camera at that host."""
    told: Mapping[str, Any] = field(default_factory=dict)
    """Fields of ExposureSettings."""
    own: Mapping[str, str] = field(default_factory=dict)
    """Parameters of this kind of camera alone."""

    @classmethod
    def parse(cls, text: str) -> CameraSpec:
        """Reads an address. Raises InputError that says what is wrong."""
        address, _, query = text.partition("?")
        scheme, colon, rest = address.partition(":")
        if not colon or scheme not in _KINDS:
            raise InputError(f"camera '{text}': write {', '.join(FORMS)}")
        place, name = rest, ""
        if scheme in _PORTS:
            if not rest.startswith("//"):
                raise InputError(f"camera '{text}': write {scheme}://HOST:PORT/...")
            place, _, name = rest[2:].partition("/")
        if not place or (scheme == "indi" and not name):
            form = next(form for form in FORMS if form.startswith(scheme))
            raise InputError(f"camera '{text}': write {form}")
        told, own = _parameters(text, scheme, query)
        return cls(scheme, unquote(place), unquote(name), told, own)

    @property
    def host(self) -> tuple[str, int]:
        """Host and port number."""
        host, colon, told = self.place.rpartition(":")
        if not colon:
            return self.place, _PORTS[self.scheme]
        if not host or (port := tcp_port(told)) is None:
            raise InputError(f"camera {self.scheme}://{self.place}: the port is a number, 1 to 65535")
        return host, port


def _parameters(text: str, scheme: str, query: str) -> tuple[dict[str, Any], dict[str, str]]:
    told: dict[str, Any] = {}
    own: dict[str, str] = {}
    for part in filter(None, query.split("&")):
        key, _, value = part.partition("=")
        value = unquote(value)
        if key in _OWN.get(scheme, ()):
            own[key] = value
        elif key == "retries":
            told[key] = int(_number(text, key, value, whole=True))
        elif key in _NUMBERS:
            told[_NUMBERS[key]] = _number(text, key, value)
        else:
            known = ", ".join((*_NUMBERS, "retries", *_OWN.get(scheme, ())))
            raise InputError(f"camera '{text}': no parameter {key}; there are {known}")
    return told, own


def _number(text: str, key: str, value: str, whole: bool = False) -> float:
    try:
        number = float(value)
    except ValueError:
        number = math.nan
    if not 0.0 <= number < 1e9 or (whole and number != int(number)):
        raise InputError(f"camera '{text}': {key}={value} is no {'count' if whole else 'number from 0 on'}")
    return number


def open_source(spec: CameraSpec, settings: ExposureSettings | None = None) -> RemoteSource:
    """The camera of an address; what its text says comes before `settings`.

    Nothing is asked of the camera yet. Raises InputError where a package for it is missing.
    """
    settings = replace(settings or ExposureSettings(), **dict(spec.told))
    return _KINDS[spec.scheme](spec, settings)


def open_camera(spec: CameraSpec, plane: FocalPlane, geometry: CameraGeometry | None = None) -> ImageCamera:
    """The camera of an address, which measures the positioners of `plane`.

    `geometry`: its nominal one, the instrument's when left out. Exposure and size of the image are
    those of the instrument's camera unless told.
    """
    check_fiducials(plane)
    nominal = geometry or view_of(plane)[0]
    camera = plane.instrument.camera
    size_px = nominal.width_px, nominal.height_px
    usual = ExposureSettings(size_px=size_px)
    if camera is not None:
        usual = replace(usual, exposure_s=camera.exposure_s)
    return image_camera_of(open_source(spec, usual), plane, geometry)


def _alpaca(spec: CameraSpec, settings: ExposureSettings) -> RemoteSource:
    from fiberloom.metrology.sources.alpaca import AlpacaSource

    number = spec.name or "0"
    if not number.isdecimal():
        raise InputError(f"camera alpaca://{spec.place}/{number}: the camera is a number, as in /0")
    return AlpacaSource(*spec.host, int(number), settings)


def _folder(spec: CameraSpec, settings: ExposureSettings) -> RemoteSource:
    from fiberloom.metrology.sources.folder import FolderSource

    return FolderSource(spec.place, settings, **dict(spec.own))


def _indi(spec: CameraSpec, settings: ExposureSettings) -> RemoteSource:
    require("indipyclient", "pip install 'fiberloom[cameras]'", "INDI")
    from fiberloom.metrology.sources.indi import IndiSource

    return IndiSource(*spec.host, spec.name, settings)


def _aravis(spec: CameraSpec, settings: ExposureSettings) -> RemoteSource:
    require("gi", "apt-get install python3-gi gir1.2-aravis-0.8", "GenICam")
    from fiberloom.metrology.sources.aravis import AravisSource

    return AravisSource(spec.place, settings)


def require(module: str, how: str, what: str) -> None:
    """Refuses where a package is missing: `module`, `how` to install it, for `what` it is needed."""
    try:
        importlib.import_module(module)
    except ImportError:
        raise InputError(f"a camera by {what} needs the package {module}, which is missing: {how}") from None


_KINDS: dict[str, Callable[[CameraSpec, ExposureSettings], RemoteSource]] = {
    "alpaca": _alpaca,
    "folder": _folder,
    "indi": _indi,
    "aravis": _aravis,
}
