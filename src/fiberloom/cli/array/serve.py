"""`fiberloom serve`: the live page of an array, and its commands over HTTP."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from fiberloom.cli.array.options import BusOptions, array_book, operator
from fiberloom.cli.observe import FaultsOption, FieldCameraOption, MapsOption
from fiberloom.cli.options import ErrorsOptions, PlaneOptions, require_file
from fiberloom.errors import InputError

if TYPE_CHECKING:
    from fiberloom.field import Field
    from fiberloom.service.guard.wall import Gate
    from fiberloom.service.web.server import Listening
    from fiberloom.store.arrays import ArrayBook

TWIN = "twin:"


@dataclass(frozen=True, kw_only=True)
class ServeOptions(BusOptions, ErrorsOptions, PlaneOptions):
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
    from fiberloom.service.alarms.send import AlarmSender, by_command, by_webhook
    from fiberloom.service.array import ServedArray
    from fiberloom.service.hub import Hub
    from fiberloom.service.logs import end_log, log_to
    from fiberloom.service.web.app import application
    from fiberloom.service.web.server import serve as run
    from fiberloom.service.web.target_root import TargetRoot

    at, gate = listening(options)
    ways = [by_webhook(options.alarm_webhook)] if options.alarm_webhook else []
    ways += [by_command(options.alarm_command)] if options.alarm_command else []
    sock = at.bound()
    field, book = served_field(options)
    array = ServedArray(field, book, options.bus or TWIN, options.out, Hub())
    sender, log = AlarmSender(ways), log_to(options.out / "serve.log")
    array.sender = sender.send
    app = application(array, gate, TargetRoot(options.targets or options.out / "targets"))
    typer.echo(f"{at.url}  ({len(field.plane)} positioners; Ctrl-C ends)")
    try:
        run(app, array, at, sock)
    finally:
        sender.close()
        end_log(log)
        book.store.close()


def check(options: ServeOptions) -> None:
    """Raises InputError for bad options that can be found without a slow import."""
    from fiberloom.twin.errors.switches import check_switches

    options.check_plane()
    check_switches(options.errors)
    require_file(options.calibration, "make one with 'fiberloom calibrate transmission'")
    for name in ("tls_cert", "tls_key"):
        require_file(getattr(options, name), "make one with openssl, or ask the observatory's")
    if (options.tls_cert is None) != (options.tls_key is None):
        raise InputError("--tls-cert and --tls-key go together")
    if options.bus is not None and not options.bus.startswith(TWIN) and options.camera is None:
        raise InputError("--bus: name the camera too, e.g. --camera alpaca://10.1.10.40:11111/0")


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


def served_field(options: ServeOptions) -> tuple[Field, ArrayBook]:
    """The field that is served, and what the store keeps of it: a twin's is in the folder of the service."""
    from fiberloom.connect import open_hardware
    from fiberloom.field import Field
    from fiberloom.service.pace import PacedSource
    from fiberloom.store.place import STORE

    options.out.mkdir(parents=True, exist_ok=True)
    plane, bus = options.plane(), options.bus or TWIN
    wrong = {"faults": options.faults, "errors": options.errors}
    source: Any = open_hardware(plane, bus, options.camera or "image", seed=options.seed, **wrong)
    store = options.store
    if bus.startswith(TWIN):
        source, store = PacedSource(source, options.speed), store or str(options.out / STORE)
    return Field(plane, source, options.seed, options.calibration), array_book(bus, store)
