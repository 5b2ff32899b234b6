"""`fiberloom twin`: positioners on CAN@net TCP ports, in real time."""

from __future__ import annotations

import asyncio
import os
import signal
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

import typer

from fiberloom.cli.options import ErrorsOptions, JsonOptions, PlaneOptions
from fiberloom.errors import InputError
from fiberloom.wholefile import write_whole

if TYPE_CHECKING:
    from fiberloom.twin.cobras.served import ServedCobras
    from fiberloom.twin.server.address import Address
    from fiberloom.twin.server.camera.process import CameraProcess
    from fiberloom.twin.server.can_units import CanUnitsServer
    from fiberloom.twin.server.server import TwinServer
    from fiberloom.twin.steppers.served import GatewayServer, RadioServer

    Served: TypeAlias = TwinServer | CanUnitsServer | ServedCobras | GatewayServer | RadioServer


@dataclass(frozen=True, kw_only=True)
class TwinOptions(ErrorsOptions, PlaneOptions, JsonOptions):
    """Of `fiberloom twin`."""

    listen: Annotated[str, typer.Option(help="HOST:PORT of the first device.")] = "127.0.0.1:19228"
    camera_listen: Annotated[
        str | None, typer.Option(help="HOST:PORT of an Alpaca camera that looks at the positioners.")
    ] = None
    camera_discovery: Annotated[
        int | None,
        typer.Option(
            min=1, max=65535, help="UDP port at which that camera answers Alpaca discovery; 32227 by custom."
        ),
    ] = None
    camera_indi: Annotated[
        str | None, typer.Option(help="HOST:PORT of the same camera by INDI; needs the packages for it.")
    ] = None
    camera_folder: Annotated[
        Path | None, typer.Option(help="Folder into which a camera writes FITS files when triggered.")
    ] = None
    camera_every_s: Annotated[
        float,
        typer.Option(
            "--camera-every", min=0.0, help="Seconds between images in that folder; 0: when triggered."
        ),
    ] = 0.0
    devices: Annotated[
        int | None, typer.Option(min=1, max=64, help="CAN@net devices; default: one for 84 positioners.")
    ] = None
    faults: Annotated[
        str,
        typer.Option(help="Faults: KIND=COUNT[@START][+DURATION],... e.g. lying=2,lost=0.01,powercut=1@30."),
    ] = ""
    speed: Annotated[float, typer.Option(help="Virtual seconds a second; 1 is real time.")] = 1.0
    neighbours: Annotated[bool, typer.Option(help="Arms touch, or pass through each other.")] = True
    bootloader: Annotated[
        bool, typer.Option("--bootloader", help="Begin as after power-on: ten seconds in the bootloader.")
    ] = False
    first: Annotated[
        bool, typer.Option("--first", help="Real-time priority for the clock; the system must allow it.")
    ] = False
    maps: Annotated[
        Path | None, typer.Option(help="PFS: motor maps of the cobras (npz); drawn where left out.")
    ] = None
    write_maps: Annotated[
        Path | None, typer.Option(help="PFS: write these maps for hosts, which name them by --calibration.")
    ] = None
    jaeger_config: Annotated[
        Path | None, typer.Option(help="Write the configuration that jaeger needs for these devices.")
    ] = None
    report_every_s: Annotated[
        float,
        typer.Option(
            "--report-every", min=0.0, help="Seconds between reports of lateness; 0: at the end only."
        ),
    ] = 0.0
    stop_after_s: Annotated[
        float | None,
        typer.Option("--stop-after", min=0.0, help="Seconds until it stops; default: Ctrl-C, SIGTERM."),
    ] = None

    @property
    def has_camera(self) -> bool:
        """Is there a camera that looks?"""
        return not (self.camera_listen is None and self.camera_indi is None and self.camera_folder is None)


def twin(options: TwinOptions) -> None:
    """Serve positioners on CAN@net TCP ports in real time, for jaeger or any other host."""
    from fiberloom.twin.errors.switches import check_switches
    from fiberloom.twin.faults.grammar import parse_faults
    from fiberloom.twin.faults.kinds import SEEN, SERVED
    from fiberloom.twin.server.address import address_of, addresses_of

    parse_faults(options.faults, SEEN if options.has_camera else SERVED)
    check_switches(options.errors)
    addresses_of(options.listen, 1)
    if options.camera_listen is not None:
        address_of(options.camera_listen, "--camera-listen")
    elif options.camera_discovery is not None:
        raise InputError("--camera-discovery: goes with --camera-listen, the camera that is to be found")
    if options.camera_indi is not None:
        from fiberloom.twin.server.camera.indi import check_packages

        address_of(options.camera_indi, "--camera-indi")
        check_packages()
    options.check_plane()
    from fiberloom.twin.server.server import device_count

    plane = options.plane()
    protocol = plane.instrument.drive.protocol
    serve = _OTHERS.get(protocol)
    count = 1 if serve else options.devices or device_count(len(plane))
    addresses = addresses_of(options.listen, count)
    _warn_of_the_network(options, addresses)
    server = serve(options, plane, addresses[0]) if serve else _server(options, plane, addresses)
    camera = _camera(options, plane, server) if options.has_camera else None
    if options.jaeger_config is not None:
        from fiberloom.twin.server.jaeger import jaeger_config

        folder = options.jaeger_config.resolve().parent
        folder.mkdir(parents=True, exist_ok=True)
        write_whole(options.jaeger_config, jaeger_config(addresses, folder))
    where = _WHERE.get(protocol, "").format(n=len(plane), address=addresses[0])
    greeting = f"{where}; Ctrl-C ends" if where else _greeting(len(plane), addresses)
    report = asyncio.run(_serve(server, camera, options, greeting))
    if options.as_json:
        options.print_json(report)
    else:
        typer.echo(server.told(report))


def _warn_of_the_network(options: TwinOptions, addresses: list[Address]) -> None:
    """Neither CAN@net nor the cameras' protocols know passwords."""
    from fiberloom.twin.server.address import address_of, reachable_from_outside

    doors = [address_of(text) for text in (options.camera_listen, options.camera_indi) if text]
    if outside := reachable_from_outside([*addresses, *doors]):
        text = f"{outside[0]} can be reached from other machines, without a password, and arms moved by them"
        typer.echo(f"fiberloom: warning: {text}; use 127.0.0.1, or a network of its own", err=True)


def _server(options: TwinOptions, plane: Any, addresses: list[Address]) -> TwinServer:
    from fiberloom.twin import Twin, draw_units
    from fiberloom.twin.bench import check_bench
    from fiberloom.twin.errors.sizes import TwinErrors
    from fiberloom.twin.faults.grammar import parse_faults
    from fiberloom.twin.faults.schedule import schedule_faults
    from fiberloom.twin.hardware import power_up, tell_temperature
    from fiberloom.twin.server.device import PORTS
    from fiberloom.twin.server.server import ServerSettings, TwinServer

    check_bench(plane.instrument)
    places = [(device, port) for device in range(len(addresses)) for port in PORTS]
    ids = [int(i) for i in plane.positioner_id]
    schedule = schedule_faults(parse_faults(options.faults), ids, places, options.seed)
    errors = TwinErrors.of(plane.instrument, options.errors)
    units = draw_units(plane, options.seed, errors=errors)
    # one thread: ticks are short, and the other core is left to the host
    made = Twin(plane, units, seed=options.seed, threads=1, neighbours=options.neighbours)
    tell_temperature(made, errors, options.seed)
    power_up(made, errors, options.seed)
    settings = ServerSettings(options.speed, options.seed, options.bootloader, options.first)
    return TwinServer(made, addresses, schedule=schedule, settings=settings)


def _refuse_sdssv_options(options: TwinOptions) -> None:
    """InputError for an option that other motors do not have."""
    for name in ("devices", "bootloader", "first", "jaeger_config"):
        if getattr(options, name):
            raise InputError(f"--{name.replace('_', '-')}: goes with SDSS-V's positioners; leave it out")


def _desi_server(options: TwinOptions, plane: Any, address: Address) -> CanUnitsServer:
    """Another kind of motors behind one device; what is SDSS-V's alone is refused."""
    from fiberloom.twin.desi.server import DesiServer
    from fiberloom.twin.desi.source import DesiSource

    _refuse_sdssv_options(options)
    source = DesiSource(plane, options.seed, "noise", options.faults, options.errors)
    return DesiServer(source.twin, address, schedule=source.schedule, speed=options.speed, seed=options.seed)


def _cobras(options: TwinOptions, plane: Any, address: Address) -> ServedCobras:
    """PFS: one FPGA in front of all cobras."""
    from fiberloom.drive.piezo import read_summary_maps, write_summary_maps
    from fiberloom.twin.cobras.served import ServedCobras
    from fiberloom.twin.cobras.source import CobraSource

    _refuse_sdssv_options(options)
    maps = options.maps and read_summary_maps(options.maps, plane.positioner_id)
    source = CobraSource(plane, options.seed, "noise", options.faults, options.errors or "none", maps or None)
    if options.write_maps is not None:
        write_summary_maps(options.write_maps, source.known_maps, plane.positioner_id)
    return ServedCobras(source.array, address, options.speed)


def _steppers(options: TwinOptions, plane: Any, address: Address) -> Served:
    """MOONS behind three gateways, MEGARA at the ports of a CAN@net device, LAMOST over the air."""
    from fiberloom.twin.faults.clock import FaultClock
    from fiberloom.twin.server.can_units import CanUnitsServer
    from fiberloom.twin.steppers.kinds import KINDS
    from fiberloom.twin.steppers.megara import MegaraBus
    from fiberloom.twin.steppers.moons import MoonsBus
    from fiberloom.twin.steppers.served import GatewayServer, RadioServer, RobotUnits
    from fiberloom.twin.steppers.source import StepperSource

    _refuse_sdssv_options(options)
    protocol = plane.instrument.drive.protocol
    wrong = options.faults, options.errors or "none"
    source = StepperSource(plane, KINDS[protocol], options.seed, "noise", *wrong)
    bus, faults = source.bus, FaultClock(source.bus, source.schedule, options.seed)
    if isinstance(bus, MoonsBus):
        return GatewayServer(bus, address, faults, options.speed)
    if not isinstance(bus, MegaraBus):
        raise InputError(f"{plane.instrument.name}: its twin is not served")
    if protocol == "lamost":
        return RadioServer(bus, address, faults, options.speed)
    return CanUnitsServer(RobotUnits(bus), address, faults, options.speed)


_OTHERS: dict[str, Callable[..., Served]] = {
    "desi": _desi_server,
    "pfs": _cobras,
    "lamost": _steppers,
    "megara": _steppers,
    "moons": _steppers,
}
"""By protocol; left out: SDSS-V's."""
_WHERE = {
    "pfs": "{n} cobras: fpga://{address}",
    "lamost": "{n} units: radio://{address}",
    "megara": "{n} robots: cannet://{address}, a bus at each of four CAN ports",
    "moons": "{n} units: gateways://{address}, three ports in a row",
}
"""What a host is to name, where it is not a row of CAN@net devices."""


def _camera(options: TwinOptions, plane: Any, server: Served) -> CameraProcess:
    from fiberloom.twin.errors.sizes import TwinErrors
    from fiberloom.twin.server.address import address_of
    from fiberloom.twin.server.camera.process import CameraDoors, CameraProcess

    alpaca, indi = (
        None if text is None else address_of(text) for text in (options.camera_listen, options.camera_indi)
    )
    folder = options.camera_folder and options.camera_folder.resolve()
    doors = CameraDoors(alpaca, folder, options.camera_every_s, indi, options.camera_discovery)
    errors = TwinErrors.of(plane.instrument, options.errors)
    return CameraProcess(plane, server, seed=options.seed, speed=options.speed, doors=doors, errors=errors)


async def _serve(
    server: Served, camera: CameraProcess | None, options: TwinOptions, greeting: str
) -> dict[str, Any]:
    stop = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, stop.set)
    await server.open()
    try:
        if camera is not None:
            await camera.open()
            greeting += f"\n{camera.doors}"
        if not options.as_json:
            typer.echo(greeting)
        await _wait(server, options, stop)
        images = {} if camera is None else {"looks": camera.looks}
        return server.report() | images | {"load_average_1min": os.getloadavg()[0]}
    finally:
        server.close()
        if camera is not None:
            camera.close()


async def _wait(server: Served, options: TwinOptions, stop: asyncio.Event) -> None:
    """Waits for the stop or the end of the time; prints reports in between."""
    loop = asyncio.get_running_loop()
    end = None if options.stop_after_s is None else loop.time() + options.stop_after_s
    while not stop.is_set():
        left = None if end is None else max(end - loop.time(), 0.0)
        wait = min((t for t in (options.report_every_s or None, left) if t is not None), default=None)
        try:
            await asyncio.wait_for(stop.wait(), wait)
        except TimeoutError:
            if end is not None and loop.time() >= end:
                return
            typer.echo(server.told(server.report()), err=True)


def _greeting(count: int, addresses: list[Address]) -> str:
    from fiberloom.twin.server.device import PORTS

    first, last = addresses[0], addresses[-1]
    where = f"{first}" if len(addresses) == 1 else f"{first} to {last}"
    devices = "1 device" if len(addresses) == 1 else f"{len(addresses)} devices"
    return f"{count} positioners on {devices} with {len(PORTS)} CAN ports each: {where}; Ctrl-C ends"
