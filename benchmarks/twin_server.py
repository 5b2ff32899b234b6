"""Does the served twin keep its clock? Serves positioners, drives them by the client, prints lateness.

    python benchmarks/twin_server.py [--positioners 500] [--seconds 10] [--images 1] [--first] [--control]

Idle first, then a move of everybody at 2000 rpm, both over TCP, on the machine as it is: the load average
is part of the answer. Why ticks were not kept is told by cause (`fiberloom.twin.real_time.Lateness`), all of
them and those that did not wait for another. With `--images` a third time, with one exposure after another of
its Alpaca camera.

With `--control` the move once more beside threads that compute nothing: one on each core, before the clock,
that only sleep until every tick (`peers/idle_clock.c`, needs gcc and root). Their missed ticks are the
machine's. A late tick counts as the machine's, too, if the thread of its core missed one meanwhile, or if it
would have been kept without the time by which that thread was woken late.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import socket
import subprocess
import sys
import tempfile
import threading
import time
from dataclasses import dataclass, replace
from pathlib import Path

from peers.issue import compiled

from fiberloom.bus import CanNetTransport, Client, WireTrajectory
from fiberloom.metrology.sources.errors import CameraAborted
from fiberloom.metrology.sources.spec import CameraSpec, open_source
from fiberloom.twin.server.address import addresses_of
from fiberloom.twin.server.server import device_count
from fiberloom.units import TICK_S

LISTEN, CAMERA = "127.0.0.1:19328", "127.0.0.1:19329"
HOME, AWAY = (10.0, 170.0), (45.0, 175.0)  # alpha turns at 1935 rpm for 3.1 s


CONTROL = Path(__file__).parent / "peers" / "idle_clock.c"


@dataclass(frozen=True)
class Served:
    """How the twin is served."""

    positioners: int
    seconds: float
    first: bool = False
    exposure_s: float | None = None
    """Of its camera, if there is one."""

    @property
    def lasts_s(self) -> float:
        """Until the server stops."""
        return self.seconds + 6.0


def served(how: Served) -> subprocess.Popen:
    options = ["--listen", LISTEN, "--positioners", str(how.positioners)]
    options += ["--stop-after", str(how.lasts_s), "--json"]
    options += ["--first"] if how.first else []
    options += ["--camera-listen", CAMERA] if how.exposure_s is not None else []
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


def measure(how: Served, moving: bool) -> dict:
    """Serves, drives, and returns what the server says at its end."""
    server = served(how)
    if how.exposure_s is None:
        driven = asyncio.run(drive(how.positioners, how.seconds, moving))
    else:
        driven = asyncio.run(observed(how.positioners, how.seconds, how.exposure_s))
    out, _ = server.communicate()
    report = json.loads(out)
    keep = ("ticks", "resting", "share_kept", "p50_ms", "p99_ms", "worst_ms", "given_up_s")
    keep += ("late_by_cause", "first_by_cause", "woken_ms", "computing_ms", "late_ticks")
    return {k: report[k] for k in keep} | driven | {"load_average": report["load_average_1min"]}


def beside_control(how: Served) -> dict:
    """The move beside a thread on each core that computes nothing."""
    with tempfile.TemporaryDirectory() as folder:
        program = compiled(CONTROL.read_text(), [], Path(folder) / "idle_clock")
        if program is None:
            raise SystemExit("--control: needs gcc")
        cores = sorted(os.sched_getaffinity(0))
        command = [[str(program), str(core), str(how.lasts_s + 4.0)] for core in cores]
        controls = [subprocess.Popen(c, stdout=subprocess.PIPE, text=True) for c in command]
        result = measure(how, moving=True)
        said = [control.communicate()[0] for control in controls]
    if any(control.returncode for control in controls):
        raise SystemExit("--control: the system allows no real-time priority; run as root")
    return result | {"control": compared(result, dict(zip(cores, said, strict=True)))}


def compared(result: dict, said: dict[int, str]) -> dict:
    """What the control threads missed, by core, and how many late ticks are the machine's.

    The first of those that were late by themselves are told one by one: the machine's are counted of these.
    """
    late_ticks, by_themselves = result["late_ticks"], sum(result["first_by_cause"].values())
    out, held = {}, {}
    for core, text in said.items():
        lines = [line.split() for line in text.splitlines()]
        ticks, missed, worst_s = map(float, lines[-1][1:])
        out[f"core {core}"] = {"ticks": ticks, "share_kept": 1.0 - missed / ticks, "worst_ms": 1e3 * worst_s}
        held[core] = [(float(begin), float(end)) for _, begin, end in lines[:-1]]
    by_machine = sum(is_machines(tick, held.get(tick["core"], [])) for tick in late_ticks)
    return out | {
        "late_by_themselves": by_themselves,
        "told": len(late_ticks),
        "of_told_the_machine": by_machine,
    }


def is_machines(tick: dict, held: list[tuple[float, float]]) -> bool:
    """Was its core held for a tick meanwhile, or would it have been kept without the time so lost?"""
    due_s, end_s = tick["due_s"], tick["due_s"] + 1e-3 * tick["late_ms"]
    meanwhile = [(begin, end) for begin, end in held if end > due_s and begin < end_s]
    lost_s = sum(min(end, end_s) - max(begin, due_s) for begin, end in meanwhile)
    return any(end - begin >= TICK_S for begin, end in meanwhile) or end_s - lost_s <= due_s + TICK_S


def show(name: str, result: dict) -> None:
    """One line, and one for each tick that was late by itself."""
    print(name, json.dumps({k: v for k, v in result.items() if k != "late_ticks"}))
    for t in result["late_ticks"]:
        print(
            f"  at {t['due_s']:.4f} s {t['late_ms']:6.2f} ms, {t['cause']}, "
            f"computed in {t['computing_ms']:.2f} ms, core {t['core']}, {t['frames']} frames, "
            f"{t['single']} positioners not in lanes"
        )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--positioners", type=int, default=500)
    parser.add_argument("--seconds", type=float, default=10.0)
    parser.add_argument("--first", action="store_true", help="as `fiberloom twin --first`")
    parser.add_argument("--control", action="store_true", help="beside threads that compute nothing")
    parser.add_argument("--images", type=float, metavar="S", help="exposures of so many seconds")
    parser.add_argument("--out", type=Path)
    args = parser.parse_args()
    how, results = Served(args.positioners, args.seconds, args.first), {}
    for name, moving in (("idle", False), ("moving", True)):
        results[name] = measure(how, moving)
        show(name, results[name])
    if args.control:
        results["moving, beside control"] = beside_control(how)
        show("moving, beside control", results["moving, beside control"])
    if args.images is not None:
        seen = measure(replace(how, exposure_s=args.images), True)
        results["moving, images"] = seen
        show("moving, images", seen)
    if args.out:
        args.out.write_text(json.dumps(results, indent=2))


if __name__ == "__main__":
    main()
