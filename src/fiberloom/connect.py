"""Hardware by its address: a bus and a camera outside of this process, or the twin inside of it.

The one place that knows both. It is above `operation`, which is not to know the twin, and loads the twin for
an address that names it only.
"""

from __future__ import annotations

import os
from typing import TYPE_CHECKING, Any

from fiberloom.bus.spec import CANNET, BusSpec
from fiberloom.bus.transport import Transport
from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane
from fiberloom.operation.source import FPGA, OpenedArray, Source

if TYPE_CHECKING:
    from fiberloom.metrology import Camera
    from fiberloom.operation.outside.steppers import OpenedSteppers

TWIN = "twin:"
NO_CAMERA = "none"


def open_hardware(
    plane: FocalPlane,
    bus: str | Transport,
    camera: Any,
    *,
    seed: int = 0,
    faults: str = "",
    errors: str = "",
) -> Source:
    """Bus and camera by their addresses; nothing is connected before something moves.

    Parameters
    ----------
    plane : FocalPlane
        The layout of the array.
    bus : str or Transport
        `twin:`, `cannet://HOST[:PORT][,HOST...]`, `socketcan:can0[,can1]`, `slcan:/dev/ttyUSB0`, or any
        `INTERFACE:CHANNEL` of python-can; `fpga://HOST[:PORT]` for the boards of PFS,
        `gateways://HOST[:PORT]` for MOONS, `radio://HOST[:PORT]` for LAMOST; or an open transport, which
        stays open.
    camera : str or Camera
        `twin:image` or `twin:noise` with the bus `twin:`; else `alpaca://HOST:PORT/N?exposure=S`,
        `folder:PATH?trigger=CMD`, `indi://HOST:PORT/NAME`, `aravis:NAME`; `none` for an instrument that no
        camera looks at; or an object with `measure(expected_mm) -> Measurement`.
    seed : int
        Of the twin's units and noise.
    faults : str
        What goes wrong in the twin.
    errors : str
        What is off its tables in the twin: "none" where left out, "all", or terms with factors.

    Returns
    -------
    Source
        What an observation, a calibration and a session open.

    Raises
    ------
    InputError
        An address that cannot be read, a camera that does not go with the bus, faults without a twin.
    """
    if isinstance(bus, str) and bus.startswith(TWIN):
        name = str(camera).removeprefix(TWIN) or "image"
        return twin_source(plane, seed, name, faults, errors or "none")
    for option, text in (("--faults", faults), ("--errors", errors)):
        if text:
            raise InputError(f"{option} goes with the twin; one on the network takes them when it is started")
    kind = _steppers(plane.instrument.drive.protocol)
    if kind is not None:
        _check_steppers(plane, bus, kind)
    address = camera if isinstance(camera, str) else ""
    seen = _camera(plane, camera) if isinstance(camera, str) else camera
    if kind is not None:
        return kind(plane, bus.removeprefix(kind.at) if isinstance(bus, str) else bus, seen, address)
    from fiberloom.operation.outside.opened import OpenedCobras, OpenedDesi

    if isinstance(bus, str) and bus.startswith(FPGA):
        return OpenedCobras(plane, bus.removeprefix(FPGA), seen, address)
    found = OpenedArray.of(bus, seen, address)
    if plane.instrument.drive.protocol == "desi":
        return OpenedDesi(plane, found.bus, found.camera, address)
    return found


def twin_source(plane: FocalPlane, seed: int, camera: str, faults: str, errors: str = "none") -> Source:
    """The twin of a `plane`, with the motors and the boards of its instrument.

    `seed` of units and noise; `camera`: noise or image; `faults` and `errors`: what goes wrong, and what is
    off its tables. InputError where the twin does not have such motors, or does not know one of these.
    """
    # a real array needs no line of the twin
    from fiberloom.twin.motors.arrays import source_of

    return source_of(plane, seed, camera, faults, errors)


def _steppers(protocol: str) -> type[OpenedSteppers] | None:
    """What opens an array of steppers with this protocol; None: it has other motors."""
    # motors of all kinds take a while to load, and an array has those of one
    from fiberloom.operation.outside.steppers import STEPPERS

    return STEPPERS.get(protocol)


def _port_of(interface: str) -> int | None:
    """TCP port of a kind of bus where an address names none; None: it has no such port."""
    from fiberloom.bus.cannet import TCP_PORT
    from fiberloom.drive.lamost.coordinators import RADIO_PORT
    from fiberloom.drive.moons.tcp import FIRST_PORT
    from fiberloom.drive.pfs.frames import TCP_PORT as FPGA_PORT

    return {CANNET: TCP_PORT, "fpga": FPGA_PORT, "gateways": FIRST_PORT, "radio": RADIO_PORT}.get(interface)


def _check_steppers(plane: FocalPlane, bus: str | Transport, kind: type[OpenedSteppers]) -> None:
    """InputError for a bus that these units do not hang at."""
    if kind.at and not (isinstance(bus, str) and bus.startswith(kind.at)):
        raise InputError(
            f"--bus {bus}: units of {plane.instrument.name} are behind {kind.at}HOST[:PORT]; "
            f"docs/instruments/{plane.instrument.drive.protocol}.md"
        )


def _camera(plane: FocalPlane, address: str) -> Camera:
    if address == NO_CAMERA:
        return _no_camera(plane)
    if address.startswith(TWIN) or address in ("image", "noise"):
        raise InputError(
            f"--camera {address}: the camera of the twin inside of this process; with a bus outside name a "
            "camera there, e.g. alpaca://HOST:PORT/0"
        )
    from fiberloom.metrology.sources.spec import CameraSpec, open_camera

    return open_camera(CameraSpec.parse(address), plane)


def _no_camera(plane: FocalPlane) -> Camera:
    """InputError for an instrument whose camera decides something."""
    if plane.instrument.metrology.present:
        raise InputError(
            f"--camera {NO_CAMERA}: {plane.instrument.name} is corrected by its camera; name that"
        )
    from fiberloom.metrology.camera import NoCamera

    return NoCamera(len(plane))


def array_address(bus: str) -> str:
    """The name of an array in the store: the address of its bus, written in one way.

    A twin inside of this process is an array of this process alone.
    """
    if bus.startswith(TWIN):
        return f"{TWIN}{os.getpid()}"
    spec = BusSpec.parse(bus)
    if (port := _port_of(spec.interface)) is None:
        return f"{spec.interface}:{','.join(sorted(spec.channels))}"
    hosts = (host.lower() if ":" in host else f"{host.lower()}:{port}" for host in spec.channels)
    return f"{spec.interface}:{'//' if spec.interface == CANNET else ''}{','.join(sorted(hosts))}"


def is_shared(bus: str) -> bool:
    """Whether a second process may talk on the bus: sockets on CAN, not a gateway or a serial line."""
    return not bus.startswith(TWIN) and BusSpec.parse(bus).interface in ("socketcan", "udp_multicast")
