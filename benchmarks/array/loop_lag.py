"""How long the event loop is kept from listening while a field is observed.

    python benchmarks/array/loop_lag.py [--positioners N] [--seed S] [--out FILE.json]
                                        [--served alpaca|folder|indi [--images N]]

A task asks for the loop every two milliseconds and notes by how much it is late: while an image is read and
reduced, a field is planned, a plan verified, a move recorded. Wall time, so: on an idle machine. The ten
slowest steps are named.

Without `--served` the twin computes in the same loop, in slices; a real bus does not. With it the array and
its camera are processes of their own, reached by CAN@net and by the camera's protocol, as at an observatory.
On few cores those take the host's time, too: the load averages are printed. With `--images` nothing moves,
and so many images are taken: what the camera alone costs the loop.
"""

from __future__ import annotations

import argparse
import asyncio
import json
import os
import tempfile
import time
from pathlib import Path

from lag import LoopLag
from two_processes import CAMERAS, outside, served

import fiberloom as fl
from fiberloom.metrology.sources.spec import CameraSpec, open_source
from fiberloom.targets import random_targets, write_targets

TARGETS_EACH = 4


Told = tuple[dict[str, float], list[str]]
"""Figures, and the slowest steps."""


async def observe(plane: fl.FocalPlane, seed: int, out: Path) -> Told:
    """One observation with two corrections, the twin in the same loop."""
    field = fl.Field.twin(plane, seed=seed)
    await field.calibrate()
    lag = LoopLag()
    with lag.watched():
        await field.observe(random_targets(plane, TARGETS_EACH * len(plane), seed), corrections=2, out=out)
    return lag.figures(), lag.slowest()


def observe_served(plane: fl.FocalPlane, seed: int, folder: Path, camera: str) -> Told:
    """The same of an array in processes of its own."""
    fl.Field.twin(plane, seed=seed).run.calibrate().save(folder / "maps.npz")
    write_targets(random_targets(plane, TARGETS_EACH * len(plane), seed), folder / "targets.csv")
    told = outside(len(plane), seed, folder, camera)
    return {key: value for key, value in told.items() if key.startswith("lag_")}, told["slowest"]


async def photograph(url: str, n: int) -> Told:
    """Takes so many images beside the loop, as an observation does; nothing moves."""
    source = open_source(CameraSpec.parse(f"{url}{'&' if '?' in url else '?'}exposure=1&deadline=120"))
    await asyncio.to_thread(source.expose)  # the first one begins what has to be begun
    lag, begin_s = LoopLag(), time.monotonic()
    with lag.watched():
        for _ in range(n):
            await asyncio.to_thread(source.expose)
    source.close()
    return lag.figures() | {"image_s": (time.monotonic() - begin_s) / n}, lag.slowest()


def photograph_served(plane: fl.FocalPlane, seed: int, folder: Path, camera: str, n: int) -> Told:
    """The same at an array in processes of its own."""
    with served(len(plane), seed, folder, camera) as (_, url):
        return asyncio.run(photograph(url, n))


def main() -> None:
    """Prints percentiles of the lag, and the slowest steps."""
    parser = argparse.ArgumentParser(description="lag of the event loop")
    parser.add_argument("--positioners", type=int, default=500)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--served", choices=CAMERAS)
    parser.add_argument("--images", type=int, default=0)
    parser.add_argument("--out", type=Path)
    given = parser.parse_args()
    plane = fl.FocalPlane.of("sdssv", seed=given.seed, n=given.positioners)
    before = os.getloadavg()[0]
    with tempfile.TemporaryDirectory() as folder:
        if given.served and given.images:
            figures, slowest = photograph_served(plane, given.seed, Path(folder), given.served, given.images)
        elif given.served:
            figures, slowest = observe_served(plane, given.seed, Path(folder), given.served)
        else:
            figures, slowest = asyncio.run(observe(plane, given.seed, Path(folder)))
    figures |= {"load_before": before, "load_after": os.getloadavg()[0]}
    array = f"served, {given.served}" if given.served else "the twin in the same loop"
    print(
        f"{given.positioners} positioners, {array}: " + ", ".join(f"{k} {v:.1f}" for k, v in figures.items())
    )
    print("\n".join(slowest))
    if given.out:
        given.out.write_text(json.dumps(figures, indent=2) + "\n")


if __name__ == "__main__":
    main()
