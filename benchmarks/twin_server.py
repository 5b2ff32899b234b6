"""Does the served twin keep its clock? Serves positioners, drives them by the client, prints lateness.

    python benchmarks/twin_server.py [--positioners 500] [--seconds 10] [--images 1]

Idle first, then a move of everybody at 2000 rpm, both over TCP, on the machine as it is: the load average
is part of the answer. Why ticks were not kept is told by cause (`fiberloom.twin.real_time.Lateness`), all of
them and those that did not wait for another. With `--images` a third time, with one exposure after another of
its Alpaca camera.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import socket
import subprocess
import sys
import threading
import time
from pathlib import Path

from fiberloom.bus import CanNetTransport, Client, WireTrajectory
from fiberloom.metrology.sources.errors import CameraAborted
from fiberloom.metrology.sources.spec import CameraSpec, open_source
from fiberloom.twin.server.address import addresses_of
from fiberloom.twin.server.server import device_count

LISTEN, CAMERA = "127.0.0.1:19328", "127.0.0.1:19329"
HOME, AWAY = (10.0, 170.0), (45.0, 175.0)  # alpha turns at 1935 rpm for 3.1 s


def served(positioners: int, seconds: float, first: bool, camera: bool) -> subprocess.Popen:
    options = ["--listen", LISTEN, "--positioners", str(positioners), "--stop-after", str(seconds), "--json"]
    options += ["--first"] if first else []
    options += ["--camera-listen", CAMERA] if camera else []
    return subprocess.Popen([sys.executable, "-m", "fiberloom.cli", "twin", *options], stdout=subprocess.PIPE)


async def drive(positioners: int, seconds: float, moving: bool) -> dict[str, float]:
    """Connects as soon as it listens; moves everybody to and fro, or only asks for the status."""
    hosts = [str(address) for address in addresses_of(LISTEN, device_count(positioners))]
    transport = await connected(hosts)
    client = Client(transport)
    ids = await client.discover()
    assert len(ids) == positioners
    begin_s, load_s, there = time.monotonic(), 0.0, True
    while time.monotonic() - begin_s < seconds:
        if not moving:
            await client.status(ids)
            await client.sleep(0.1)
            continue
        here, goal = (HOME, AWAY) if there else (AWAY, HOME)
        start = time.monotonic()
        path = WireTrajectory.from_deg([0.1, 3.2], *zip(here, goal, strict=True))
        sent = await client.send_trajectories(dict.fromkeys(ids, path))
        load_s = time.monotonic() - start
        assert sent.ok.all(), sent
        await client.start(ids)
        done = await client.wait_until_done(ids, 10.0, expected_s=3.0)
        assert done.ok.all(), done
        there = not there
    await client.close()
    return {"load_s": load_s}


class Photographer(threading.Thread):
    """Takes one image after another until told to stop."""

    def __init__(self, exposure_s: float) -> None:
        super().__init__()
        self.source = open_source(CameraSpec.parse(f"alpaca://{CAMERA}/0?exposure={exposure_s}&deadline=60"))
        self.took_s: list[float] = []
        self.over = threading.Event()

    def run(self) -> None:
        while not self.over.is_set():
            begin_s = time.monotonic()
            try:
                self.source.expose()
            except CameraAborted:
                return
            self.took_s.append(time.monotonic() - begin_s)

    def stop(self) -> None:
        self.over.set()
        self.source.abort()
        self.join()


async def observed(positioners: int, seconds: float, exposure_s: float) -> dict[str, float]:
    """Moves everybody to and fro while images are taken."""
    photographer = Photographer(exposure_s)
    while not listening():
        await asyncio.sleep(0.1)
    photographer.start()
    try:
        driven = await drive(positioners, seconds, moving=True)
    finally:
        photographer.stop()
    took_s = photographer.took_s
    return driven | {"images": len(took_s), "image_s": sum(took_s) / max(len(took_s), 1)}


def listening() -> bool:
    host, port = CAMERA.split(":")
    with socket.socket() as s:
        return s.connect_ex((host, int(port))) == 0


async def connected(hosts: list[str]) -> CanNetTransport:
    for _ in range(200):
        try:
            return await CanNetTransport.open(hosts)
        except Exception:
            await asyncio.sleep(0.1)
    raise SystemExit("the server does not listen")


def measure(
    positioners: int, seconds: float, moving: bool, first: bool, exposure_s: float | None = None
) -> dict:
    server = served(positioners, seconds + 6.0, first, exposure_s is not None)
    if exposure_s is None:
        driven = asyncio.run(drive(positioners, seconds, moving))
    else:
        driven = asyncio.run(observed(positioners, seconds, exposure_s))
    out, _ = server.communicate()
    report = json.loads(out)
    keep = ("ticks", "resting", "share_kept", "p50_ms", "p99_ms", "worst_ms", "given_up_s")
    keep += ("late_by_cause", "first_by_cause", "woken_ms", "computing_ms")
    return {k: report[k] for k in keep} | driven | {"load_average": report["load_average_1min"]}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--positioners", type=int, default=500)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--first", action="store_true", help="as `fiberloom twin --first`")
    parser.add_argument("--images", type=float, metavar="S", help="exposures of so many seconds")
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()
    results = {}
    for name, moving in (("idle", False), ("moving", True)):
        results[name] = measure(args.positioners, args.seconds, moving, args.first)
        print(name, json.dumps(results[name]))
    if args.images is not None:
        seen = measure(args.positioners, args.seconds, True, args.first, args.images)
        results["moving, images"] = seen
        print("moving, images", json.dumps(seen))
    if args.out:
        args.out.write_text(json.dumps(results, indent=2))


if __name__ == "__main__":
    main()
