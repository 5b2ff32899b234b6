"""Gateways that are cut for some seconds in the middle of a move: who is stopped, flagged, late.

    python benchmarks/array/links.py --cuts 20 --gateways 3 --positioners 36 --out links.json

A twin behind several CAN@net gateways on loopback, in real time with arms that touch; the host is the field
motion of an observation, over TCP. Each move goes to another random configuration; meanwhile the connection
to one gateway, drawn by the seed, is cut at a random instant, and no connection is taken for `--seconds`.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import time
from pathlib import Path
from typing import Any

import numpy as np
from events import EventsOnly

from fiberloom.bus import CanNetTransport
from fiberloom.calibration.transmission.maps import identity
from fiberloom.hardware import Hardware
from fiberloom.health.status import FAULTS
from fiberloom.instruments import generate, load_instrument
from fiberloom.metrology import Measurement
from fiberloom.operation.motion import FieldMotion
from fiberloom.operation.move import Goals
from fiberloom.planning import random_pair
from fiberloom.twin import Twin, draw_units
from fiberloom.twin.camera.noise_camera import NoiseCamera
from fiberloom.twin.server.address import Address
from fiberloom.twin.server.server import TwinServer

WITHIN_UM = 500.0
"""The blind move's, with linear maps: far less; a positioner that did not arrive is millimetres away."""


class HeldCamera:
    """Measures a twin that runs meanwhile."""

    def __init__(self, server: TwinServer, camera: NoiseCamera) -> None:
        self.server, self.camera = server, camera

    def measure(self, expected_mm: np.ndarray) -> Measurement:
        """Between two ticks."""
        assert self.server.real is not None
        with self.server.real.held():
            return self.camera.measure(expected_mm)


async def cut(server: TwinServer, gateway: int, after_s: float, for_s: float) -> None:
    """Cuts one gateway once the arms have moved for a while."""
    before = server.traffic.frames_in
    while server.traffic.frames_in < before + 100:  # the trajectories are being loaded
        await asyncio.sleep(0.01)
    await asyncio.sleep(after_s)
    server.listeners[gateway].cut(True)
    await asyncio.sleep(for_s)
    server.listeners[gateway].cut(False)


async def moves(asked: argparse.Namespace) -> list[dict[str, Any]]:
    """All moves, each with its cut."""
    plane = generate(load_instrument("sdssv"), seed=asked.seed, n_positioners=asked.positioners)
    twin = Twin(plane, draw_units(plane, asked.seed), seed=asked.seed, threads=1)
    server = TwinServer(twin, [Address("127.0.0.1", 0) for _ in range(asked.gateways)])
    await server.open()
    recorder = EventsOnly()
    camera = HeldCamera(server, NoiseCamera(twin, plane.instrument.metrology.noise_rms_um, asked.seed))
    transport = await CanNetTransport.open([str(listener.address) for listener in server.listeners])
    vouched = np.ones(len(plane), dtype=bool)
    hardware = Hardware(transport, camera, vouched=vouched)
    motion = FieldMotion(plane, identity(plane.positioner_id), hardware, recorder)
    rng = np.random.default_rng(asked.seed)
    rows = []
    try:
        await motion.connect()
        for number in range(asked.cuts):
            goal_deg = random_pair(plane, asked.seed + number)[1]
            rows.append(await one_move(motion, server, goal_deg, rng, asked.seconds))
            rows[-1]["events"] = recorder.lines()
            recorder.events.clear()
            print(json.dumps(rows[-1]), flush=True)
    finally:
        await motion.close()
        server.close()
    return rows


async def one_move(
    motion: FieldMotion, server: TwinServer, goal_deg: np.ndarray, rng: np.random.Generator, cut_s: float
) -> dict[str, Any]:
    """Goes to a configuration while one gateway is cut."""
    gateway, after_s = int(rng.integers(len(server.listeners))), float(rng.uniform(1.0, 27.0))
    before, begun_s = len(motion.moves), time.monotonic()
    saboteur = asyncio.create_task(cut(server, gateway, after_s, cut_s))
    await motion.go(Goals.without_targets(motion.plane, goal_deg))
    await saboteur
    state, image = motion.state, motion.moves[-1].measurement
    miss_um = 1e3 * np.hypot(*(image.xy_mm - state.metrology_mm(motion.moves[-1].commanded_deg)).T)
    assert server.real is not None
    with server.real.held() as twin:
        contacts = len(twin.touches())
    return {
        "gateway": gateway + 1,
        "cut_after_s": round(after_s, 2),
        "motion_s": round(motion.moves[before].plan.duration_s, 2),
        "took_s": round(time.monotonic() - begun_s, 1),
        "moves": len(motion.moves) - before,
        "flagged": [str(f) for f in state.faults if f in FAULTS],
        "not_at_goal": int((miss_um > WITHIN_UM).sum()),
        "contacts": contacts,
    }


def main() -> None:
    """Run what the command line asks for."""
    asked = arguments()
    rows = asyncio.run(moves(asked))
    stopped = sum("stopped" in event for row in rows for event in row["events"])
    print(
        f"{len(rows)} cuts of {asked.seconds:g} s: {stopped} stops, "
        f"{sum(len(r['flagged']) for r in rows)} flagged, "
        f"{sum(r['not_at_goal'] for r in rows)} of {len(rows) * asked.positioners} not at their goal, "
        f"{sum(r['contacts'] for r in rows)} contacts, {sum(r['moves'] - 1 for r in rows)} recovery moves"
    )
    if asked.out:
        asked.out.write_text(json.dumps(rows, indent=1) + "\n")


def arguments() -> argparse.Namespace:
    """The command line."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--cuts", type=int, default=20)
    parser.add_argument("--gateways", type=int, default=3)
    parser.add_argument("--positioners", type=int, default=36)
    parser.add_argument("--seconds", type=float, default=5.0, help="length of each cut")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--out", type=Path, help="JSON file")
    return parser.parse_args()


if __name__ == "__main__":
    main()
