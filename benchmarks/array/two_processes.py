"""One field observed twice: in this process, and by a host that shares nothing with the array but sockets.

    python benchmarks/array/two_processes.py [--positioners N] [--seeds N] [--camera alpaca|folder|indi]

For each seed the array is the same: units, targets and maps of one twin. The second time it is served by
`fiberloom twin` in a process of its own, with CAN@net and a camera; the host is another new process that
must not import a line of the twin. Printed: rms as measured after each move, their ratio, and by
how much the host's event loop was late (p99 of the time).
"""

from __future__ import annotations

import argparse
import asyncio
import json
import socket
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from lag import LoopLag

import fiberloom as fl
from fiberloom.store import Store
from fiberloom.store.arrays import ArrayBook
from fiberloom.targets import random_targets, write_targets

CAMERAS = ("alpaca", "folder", "indi")


def rms_um(summary: dict[str, Any]) -> list[float]:
    """As measured, of each move."""
    return [move["measured_rms_um"] for move in summary["moves"]]


def inside(plane: fl.FocalPlane, seed: int, folder: Path) -> list[float]:
    """In this process; leaves targets and maps in the folder."""
    field = fl.Field.twin(plane, seed=seed)
    field.run.calibrate().save(folder / "maps.npz")
    targets = random_targets(plane, 8 * len(plane), seed)
    write_targets(targets, folder / "targets.csv")
    return rms_um(field.run.observe(targets, corrections=2, out=folder / "inside").summary())


async def host(plane: fl.FocalPlane, seed: int, folder: Path, bus: str, camera: str) -> dict[str, Any]:
    """The other process: what an observatory runs."""
    field = fl.Field.open(plane, bus, camera, calibration=folder / "maps.npz", seed=seed)
    field.book = ArrayBook(Store.open(folder / "arrays.sqlite"), bus)  # owned, with signs of life
    targets = fl.read_targets(folder / "targets.csv")
    lag = LoopLag()
    with lag.watched():
        seen = await field.observe(targets, corrections=2, out=folder / "outside")
    return {
        "rms_um": rms_um(seen.summary()),
        "within": seen.summary()["n_within_requirement"],
        "slowest": lag.slowest(),
        "twin_imported": any(name.startswith("fiberloom.twin") for name in sys.modules),
    } | lag.figures()


@contextmanager
def served(positioners: int, seed: int, folder: Path, kind: str) -> Iterator[tuple[str, str]]:
    """An array in a process of its own: the addresses of its bus and of its camera."""
    doors = {
        "alpaca": ["--camera-listen", f"127.0.0.1:{free_port()}"],
        "folder": ["--camera-folder", str(folder / "images")],
        "indi": ["--camera-indi", f"127.0.0.1:{free_port()}"],
    }[kind]
    command = [sys.executable, "-m", "fiberloom.cli", "twin", "--positioners", str(positioners)]
    command += ["--seed", str(seed), "--listen", f"127.0.0.1:{free_port()}", *doors]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as twin:
        assert twin.stdout is not None
        try:
            address = twin.stdout.readline().split(": ")[1].split(";")[0].strip()
            camera = twin.stdout.readline().split(": ", 1)[1].strip()
            yield bus_of(address), camera
        finally:
            twin.terminate()
            twin.communicate(timeout=60)


def outside(positioners: int, seed: int, folder: Path, kind: str) -> dict[str, Any]:
    """A served array and a host, each in a process of its own."""
    with served(positioners, seed, folder, kind) as (bus, camera):
        words = ["--host", str(folder), "--positioners", str(positioners), "--first", str(seed)]
        words += ["--bus", bus, "--url", camera]
        done = subprocess.run([sys.executable, __file__, *words], capture_output=True, text=True, check=False)
    if done.returncode:
        raise RuntimeError(done.stderr)
    return dict(json.loads(done.stdout.splitlines()[-1]))


def free_port() -> int:
    """A TCP port that is not in use now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


def bus_of(greeting: str) -> str:
    """The address that a greeting names: `127.0.0.1:19400` or `127.0.0.1:19400 to 127.0.0.6:19400`."""
    first, _, last = greeting.partition(" to ")
    hosts = [first]
    if last:
        stem, port = first.rsplit(".", 1)[0], first.rsplit(":", 1)[1]
        ends = [int(host.rsplit(".", 1)[1].split(":")[0]) for host in (first, last)]
        hosts = [f"{stem}.{k}:{port}" for k in range(ends[0], ends[1] + 1)]
    return "cannet://" + ",".join(hosts)


def main() -> int:
    """Exit code 1 where a host imported the twin, or a median differs by more than 5 per cent."""
    parser = argparse.ArgumentParser(description="in one process and in two")
    parser.add_argument("--positioners", type=int, default=37)
    parser.add_argument("--seeds", type=int, default=3)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--camera", choices=CAMERAS, default="alpaca")
    parser.add_argument("--out", type=Path)
    for hidden in ("--host", "--bus", "--url"):
        parser.add_argument(hidden, help=argparse.SUPPRESS)
    given = parser.parse_args()
    if given.host:
        plane = fl.FocalPlane.of("sdssv", seed=given.first, n=given.positioners)
        folder = Path(given.host)
        print(json.dumps(asyncio.run(host(plane, given.first, folder, given.bus, given.url))))
        return 0
    rows = []
    for seed in range(given.first, given.first + given.seeds):
        plane = fl.FocalPlane.of("sdssv", seed=seed, n=given.positioners)
        with tempfile.TemporaryDirectory() as name:
            row = {"seed": seed, "inside_um": inside(plane, seed, Path(name))}
            row |= outside(given.positioners, seed, Path(name), given.camera)
        rows.append(row)
        print(json.dumps(row), file=sys.stderr, flush=True)
    medians = [np.median([row[key] for row in rows], axis=0) for key in ("inside_um", "rms_um")]
    print(f"{given.positioners} positioners, {given.camera}, {given.seeds} seeds; rms as measured, um")
    for move, (a, b) in enumerate(zip(*medians, strict=True), 1):
        print(f"move {move}: one process {a:.2f}, two processes {b:.2f}, ratio {b / a:.3f}")
    print(f"event loop late by {max(row['lag_p99_ms'] for row in rows):.1f} ms at most at p99")
    imported = any(row["twin_imported"] for row in rows)
    print(f"fiberloom.twin imported by a host: {'yes' if imported else 'no'}")
    if given.out:
        given.out.write_text(json.dumps(rows, indent=2) + "\n")
    return 1 if imported or np.abs(medians[1] / medians[0] - 1.0).max() > 0.05 else 0


if __name__ == "__main__":
    sys.exit(main())
