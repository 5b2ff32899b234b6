"""`fiberloom serve`: the live page of an array, and its commands over HTTP."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fiberloom.cli.array.options import BusOptions, array_book, operator
from fiberloom.cli.night import queue_plane
from fiberloom.cli.observe import FaultsOption, FieldCameraOption, MapsOption
from fiberloom.cli.options import DatabaseOptions, ErrorsOptions, PlaneOptions, require_file
from fiberloom.errors import InputError

if TYPE_CHECKING:
    import socket

    from fiberloom.field import Field
    from fiberloom.night.queue import QueueArray
    from fiberloom.observatory.interfaces import Interfaces
    from fiberloom.service.array import ServedArray
    from fiberloom.service.guard.wall import Gate
    from fiberloom.service.night.served_night import ServedNight
    from fiberloom.service.web.server import Listening
    from fiberloom.store.arrays import ArrayBook

TWIN = "twin:"


@dataclass(frozen=True, kw_only=True)
class ServeOptions(BusOptions, DatabaseOptions, ErrorsOptions, PlaneOptions):
    """Of `fiberloom serve`."""

    listen: Annotated[str, typer.Option(help="HOST:PORT; beyond loopback only with tokens and TLS.")] = (
        "127.0.0.1:8080"
    )
    camera: FieldCameraOption = None
    calibration: MapsOption = None
    faults: FaultsOption = ""
    speed: Annotated[
        float,
        typer.Option(min=0.01, max=1000.0, help="Of the twin in this process: virtual seconds a second."),
    ] = 1.0
    night: Annotated[
        Path | None, typer.Option(help="TOML file of a night: it begins at once, on the array that it names.")
    ] = None
    resume: Annotated[
        bool, typer.Option("--resume", help="Go on with the last night of this queue; with --night.")
    ] = False
    exposing_speed: Annotated[
        float,
        typer.Option(min=0.01, max=1000.0, help="As --speed, while a shutter is open or the night waits."),
    ] = 30.0
    opcua: Annotated[str, typer.Option(help="HOST[:PORT]: the array as an OPC UA server too; loopback.")] = ""
    epics: Annotated[str, typer.Option(help="Prefix of records: the array as an EPICS IOC too.")] = ""
    epics_listen: Annotated[str, typer.Option(help="HOST[:PORT] of Channel Access; loopback.")] = "127.0.0.1"
    trusted_network: Annotated[
        bool,
        typer.Option("--trusted-network", help="OPC UA and EPICS may listen beyond loopback: no passwords."),
    ] = False
    out: Annotated[Path, typer.Option(help="Folder of the record, the log and the target lists.")] = Path(
        "runs/serve"
    )
    targets: Annotated[
        Path | None, typer.Option(help="Folder of target lists; default: `targets` below --out.")
    ] = None
    token_file: Annotated[
        Path | None,
        typer.Option(help="Lines of ROLE NAME TOKEN (viewer, operator, engineer); mode 0600."),
    ] = None
    tls_cert: Annotated[Path | None, typer.Option(help="Certificate, PEM.")] = None
    tls_key: Annotated[Path | None, typer.Option(help="Its key, PEM.")] = None
    allow_host: Annotated[
        str, typer.Option(help="Further names by which it is asked, with commas: fps.example.org.")
    ] = ""
    alarm_webhook: Annotated[str, typer.Option(help="Alarms are sent there as JSON by POST.")] = ""
    alarm_command: Annotated[
        str, typer.Option(help="Run for each alarm, with its JSON as input; without a shell.")
    ] = ""


def serve(options: ServeOptions) -> None:
    """Serve one array: a live page, commands by HTTP, its motion as a stream.

    On the twin inside of this process unless --bus names an array. Ctrl-C stops what moves, then the service.
    """
    check(options)
    _need_packages()
    at, gate = listening(options)
    shown = interfaces(options)
    with at.bound() as sock:
        _serve(options, at, gate, shown, sock)


def _serve(options: ServeOptions, at: Listening, gate: Gate, shown: Interfaces, sock: socket.socket) -> None:
    from fiberloom.service.alarms.send import AlarmSender, by_command, by_webhook
    from fiberloom.service.array import ServedArray
    from fiberloom.service.hub import Hub
    from fiberloom.service.logs import end_log, log_to
    from fiberloom.service.web.app import application
    from fiberloom.service.web.server import serve as run
    from fiberloom.service.web.target_root import TargetRoot

    ways = [by_webhook(options.alarm_webhook)] if options.alarm_webhook else []
    ways += [by_command(options.alarm_command)] if options.alarm_command else []
    field, book, bus = served_field(options)
    array = ServedArray(field, book, bus, options.out, Hub(), options.database)
    night = served_night(options, array)
    sender, log = AlarmSender(ways), log_to(options.out / "serve.log")
    array.sender = sender.send
    root = TargetRoot(options.targets or options.out / "targets")
    app = application(array, gate, root, night, shown)
    typer.echo(f"{at.url}  ({len(field.plane)} positioners; Ctrl-C ends)")
    for line in shown.told():
        typer.echo(line)
    try:
        run(app, array, at, sock, lambda: begin(options, array, night))
    finally:
        if night is not None:
            night.close()
        sender.close()
        end_log(log)
        book.store.close()


def begin(options: ServeOptions, array: ServedArray, night: ServedNight | None) -> None:
    """Begins to serve the array, and its night."""
    from fiberloom.service.array import Author

    array.begin(calibrate=night is None)
    if night is not None:
        night.start()
        night.begin(Author(operator(), "engineer"), options.resume)


def interfaces(options: ServeOptions) -> Interfaces:
    """Of an observatory. InputError where an address cannot be, or a package is missing."""
    from fiberloom.observatory.epics import DEFAULT_PORT as CA_PORT
    from fiberloom.observatory.interfaces import Interfaces
    from fiberloom.observatory.network import Endpoint
    from fiberloom.observatory.opcua import DEFAULT_PORT

    opcua = Endpoint.parse(options.opcua, DEFAULT_PORT, options.trusted_network) if options.opcua else None
    epics = Endpoint.parse(options.epics_listen, CA_PORT, options.trusted_network) if options.epics else None
    wanted = Interfaces(opcua, options.epics, epics)
    wanted.require()
    return wanted


def served_night(options: ServeOptions, array: ServedArray) -> ServedNight | None:
    """The night that --night names; None: there is none."""
    if options.night is None:
        return None
    from fiberloom.service.night.served_night import NightPace, ServedNight
    from fiberloom.service.pace import PacedSource

    source = array.field.source
    if not isinstance(source, PacedSource):
        return ServedNight(array, options.night)
    pace = NightPace(source, options.speed, options.exposing_speed)
    return ServedNight(array, options.night, pace)


def check(options: ServeOptions) -> None:
    """Raises InputError for bad options that can be found without a slow import."""
    from fiberloom.twin.errors.switches import check_switches

    options.check_plane()
    options.check_database()
    check_switches(options.errors)
    require_file(options.calibration, "make one with 'fiberloom calibrate transmission'")
    for name in ("tls_cert", "tls_key"):
        require_file(getattr(options, name), "make one with openssl, or ask the observatory's")
    if (options.tls_cert is None) != (options.tls_key is None):
        raise InputError("--tls-cert and --tls-key go together")
    _check_night(options)
    if options.bus is not None and not options.bus.startswith(TWIN) and options.camera is None:
        raise InputError("--bus: name the camera too, e.g. --camera alpaca://10.1.10.40:11111/0")


def _check_night(options: ServeOptions) -> None:
    require_file(options.night, "write one as examples/night.toml")
    if options.resume and options.night is None:
        raise InputError("--resume goes with --night: which queue?")
    for name, default in (("instrument", "sdssv"), ("layout", None), ("positioners", None), ("seed", 0)):
        if options.night is not None and getattr(options, name) != default:
            raise InputError(f"--{name}: with --night the [array] of the queue says which positioners")


def _need_packages() -> None:
    """Raises InputError where the extra is not installed."""
    import importlib.util

    missing = [n for n in ("fastapi", "uvicorn", "websockets", "prometheus_client")
               if importlib.util.find_spec(n) is None]  # fmt: skip
    if missing:
        raise InputError(f"serve: {', '.join(missing)} is not installed; pip install 'fiberloom[serve]'")


def listening(options: Any) -> tuple[Listening, Gate]:
    """Where to listen, and the gate. InputError beyond loopback without tokens or without TLS."""
    from fiberloom.service.guard.tokens import Identity, Role, TokenFile
    from fiberloom.service.guard.wall import Gate, hosts_of, is_loopback
    from fiberloom.service.web.server import Listening

    host, port = Listening.parse(options.listen)
    at = Listening(host, port, options.tls_cert, options.tls_key)
    tokens = None if options.token_file is None else TokenFile.read(options.token_file)
    if not is_loopback(host):
        if tokens is None:
            raise InputError(f"--listen {options.listen}: beyond loopback only with --token-file")
        if at.certificate is None:
            raise InputError(f"--listen {options.listen}: beyond loopback only with --tls-cert and --tls-key")
    further = [name.strip() for name in options.allow_host.split(",") if name.strip()]
    local = Identity(operator(), Role.ENGINEER)
    return at, Gate(hosts_of(host, port, further), at.scheme, tokens, local)


def served_field(options: ServeOptions) -> tuple[Field, ArrayBook, str]:
    """The field that is served, what the store keeps of it, and its bus.

    A twin's store is that of the record: in the folder of the service, or the database. With a night its
    queue says which array, where nothing was typed.
    """
    from fiberloom.connect import open_hardware
    from fiberloom.field import Field
    from fiberloom.service.pace import paced
    from fiberloom.store import Store
    from fiberloom.store.place import STORE

    options.out.mkdir(parents=True, exist_ok=True)
    asked = _queued(options)
    plane, bus = (options.plane() if asked is None else queue_plane(asked)), options.bus or TWIN
    wrong = {"faults": options.faults, "errors": options.errors}
    camera, calibration, seed, store = options.camera, options.calibration, options.seed, options.store
    if asked is not None:
        bus, camera, seed = options.bus or asked.bus or TWIN, camera or asked.camera, asked.seed
        calibration = calibration or asked.calibration
        wrong = {"faults": options.faults or asked.faults, "errors": options.errors or asked.errors}
    source: Any = open_hardware(plane, bus, camera or "image", seed=seed, **wrong)
    if bus.startswith(TWIN):
        record = options.database or str(options.out / STORE)
        source, store = paced(source, options.speed), store or record
    elif options.database:
        Store.open(options.database).close()  # one that cannot be opened is told at once
    return Field(plane, source, seed, calibration), array_book(bus, store), bus


def _queued(options: ServeOptions) -> QueueArray | None:
    """Which array the queue of the night names; None without a night."""
    if options.night is None:
        return None
    from fiberloom.night.queue import read_queue

    return read_queue(options.night).array
