"""`fiberloom twin`: positioners on CAN@net TCP ports, in real time."""

from __future__ import annotations

import asyncio
import json
import os
import signal
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import typer

from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane
from fiberloom.twin import Twin, draw_units
from fiberloom.twin.faults.schedule import troubles_of
from fiberloom.twin.server.device import PORTS
from fiberloom.twin.server.server import Address, TwinServer, addresses_of, device_count


@dataclass(frozen=True)
class ServeRequest:
    """What the command line asked for."""

    listen: str
    devices: int | None = None
    seed: int = 0
    faults: str = ""
    speed: float = 1.0
    neighbours: bool = True
    bootloader: bool = False
    first: bool = False
    report_every_s: float = 0.0
    stop_after_s: float | None = None
    jaeger_config: Path | None = None
    as_json: bool = False


def run_twin(plane: FocalPlane, request: ServeRequest) -> dict[str, Any]:
    """Serves until Ctrl-C, SIGTERM or the time asked for; prints and returns the closing report."""
    addresses = addresses_of(request.listen, request.devices or device_count(len(plane)))
    places = [(device, port) for device in range(len(addresses)) for port in PORTS]
    ids = [int(i) for i in plane.positioner_id]
    troubles = troubles_of(request.faults, ids, places, request.seed)
    units = draw_units(plane, request.seed)
    # one thread: ticks are short, and the other core is the host's
    twin = Twin(plane, units, seed=request.seed, threads=1, neighbours=request.neighbours)
    server = TwinServer(
        twin,
        addresses,
        speed=request.speed,
        troubles=troubles,
        seed=request.seed,
        bootloader=request.bootloader,
        first=request.first,
    )
    if request.jaeger_config is not None:
        folder = request.jaeger_config.resolve().parent
        folder.mkdir(parents=True, exist_ok=True)
        request.jaeger_config.write_text(jaeger_config(addresses, folder))
    report = asyncio.run(_serve(server, request, len(plane), addresses))
    typer.echo(json.dumps(report, indent=2) if request.as_json else _text(report))
    return report


def jaeger_config(addresses: list[Address], folder: Path) -> str:
    """What jaeger needs to know to drive this twin: its JAEGER_<OBSERVATORY>_CONFIG_PATH.

    Logs, trajectories and snapshots go to `folder`.
    """
    if len({a.port for a in addresses}) > 1:
        raise InputError(
            "--jaeger-config: jaeger has one port for all devices; listen at a loopback address, where "
            "devices get 127.0.0.1, 127.0.0.2, ..."
        )
    profile = {
        "interface": "cannet",
        "channels": [a.host for a in addresses],
        "port": addresses[0].port,
        "buses": list(PORTS),
        "bitrate": 1_000_000,
        "timeout": 1,
        "status_interval": 5,
    }
    paths = {"snapshot_path": str(folder), "configuration_snapshot_path": str(folder)}
    config = {
        "profiles": {"default": "twin", "twin": profile},
        "fps": {"use_lock": False, "skip_assignments_check": True, **paths},
        "positioner": {"trajectory_dump_path": str(folder)},
        "files": {"log_dir": str(folder)},
    }
    return json.dumps(config, indent=2) + "\n"  # which is YAML, too


async def _serve(
    server: TwinServer, request: ServeRequest, count: int, addresses: list[Address]
) -> dict[str, Any]:
    stop = asyncio.Event()
    loop = asyncio.get_running_loop()
    for number in (signal.SIGINT, signal.SIGTERM):
        loop.add_signal_handler(number, stop.set)
    await server.open()
    try:
        if not request.as_json:
            typer.echo(_greeting(count, addresses))
        await _wait(server, request, stop)
        return server.report() | {"load_average_1min": os.getloadavg()[0]}
    finally:
        server.close()


async def _wait(server: TwinServer, request: ServeRequest, stop: asyncio.Event) -> None:
    """Until told to stop; reports in between."""
    loop = asyncio.get_running_loop()
    end = None if request.stop_after_s is None else loop.time() + request.stop_after_s
    while not stop.is_set():
        left = None if end is None else max(end - loop.time(), 0.0)
        wait = min((t for t in (request.report_every_s or None, left) if t is not None), default=None)
        try:
            await asyncio.wait_for(stop.wait(), wait)
        except TimeoutError:
            if end is not None and loop.time() >= end:
                return
            typer.echo(_text(server.report()), err=True)


def _greeting(count: int, addresses: list[Address]) -> str:
    first, last = addresses[0], addresses[-1]
    where = f"{first}" if len(addresses) == 1 else f"{first} to {last}"
    devices = "1 device" if len(addresses) == 1 else f"{len(addresses)} devices"
    return f"{count} positioners on {devices} with {len(PORTS)} CAN ports each: {where}; Ctrl-C ends"


def _text(report: dict[str, Any]) -> str:
    """A few lines for people."""
    lines = [
        f"{report['time_s']:.1f} s of twin time: "
        f"{report['ticks']} ticks computed, {report['resting']} at rest",
        f"kept {100 * report['share_kept']:.2f} % of the ticks; late by {report['p50_ms']:.2f} ms (half), "
        f"{report['p99_ms']:.2f} ms (99 %), {report['worst_ms']:.2f} ms (worst)",
        f"{report['clients']} clients, {report['frames_in']} frames in, {report['frames_out']} out",
    ]
    losses = {
        "given_up_s": "s of clock given up",
        "overflowed": "frames over the queue",
        "unread": "frames unread by the client",
        "lost": "replies lost on purpose",
        "late": "replies late on purpose",
        "refused_clients": "clients turned away",
    }
    lost = [f"{report[key]:.4g} {what}" for key, what in losses.items() if report[key]]
    return "\n".join([*lines, *([", ".join(lost)] if lost else []), *report["happened"]])
