"""One seed in a process of its own: an array, two commands one after the other, and what came of it."""

from __future__ import annotations

import ctypes
import multiprocessing
import resource
import shutil
import signal
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import partial
from multiprocessing.connection import Connection
from multiprocessing.process import BaseProcess
from pathlib import Path
from typing import Any

import numpy as np

from fiberloom.calibration.transmission.maps import TransmissionMaps
from fiberloom.instruments import FocalPlane
from fiberloom.targets import random_targets, write_targets
from fiberloom.twin.units import Units

from .disk import Ballast, mounted
from .draw import Scene
from .host import Desk, command
from .judge import judged
from .world import Ended, World

COMMANDS = 2
_PR_SET_PDEATHSIG = 1
FORK = multiprocessing.get_context("fork")
GAP_S = 20.0
"""At most so long after a command that was killed the next one begins."""


@dataclass(frozen=True)
class Array:
    """The field of the campaign: layout, true units, maps and the options that name it."""

    plane: FocalPlane
    units: Units
    maps: TransmissionMaps
    maps_file: Path
    options: tuple[str, ...]


def run_seed(array: Array, scene: Scene, log: Path) -> dict[str, Any]:
    """What came of one seed, as a line of the campaign's file; `log`: takes what the commands print."""
    begun_s = time.monotonic()
    with _folder(scene) as (folder, ballast):
        desk = Desk(array.plane.positioner_id.tolist(), array.options, array.maps_file, folder, log)
        hosts = [_host(array, scene, desk, number) for number in range(COMMANDS)]
        fill = None if ballast is None else lambda fault: ballast.fill(fault.size)
        world = World(array.plane, array.units, scene, fill)
        ended = [_ended(world, ballast, host, number) for number, host in enumerate(hosts)]
        line = judged(world, array.maps, folder, ended)
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    line["cpu_s"] = round(sum(u.ru_utime + u.ru_stime for u in used), 2)
    line["wall_s"] = round(time.monotonic() - begun_s, 2)
    return line


@contextmanager
def _folder(scene: Scene) -> Iterator[tuple[Path, Ballast | None]]:
    """A folder for a seed; with a disk that can be full, where one is to be full and it may be."""
    folder = Path(tempfile.mkdtemp(prefix=f"fiberloom-seed-{scene.seed}-"))
    disk = scene.of("disk_full") and mounted(folder)
    try:
        yield folder, Ballast(folder) if disk else None
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _host(array: Array, scene: Scene, desk: Desk, number: int) -> tuple[BaseProcess, Connection]:
    """A command in a process of its own, that waits; begun before the twin has threads."""
    targets = desk.folder / f"targets-{number}.csv"
    n = 8 * len(array.plane)
    write_targets(random_targets(array.plane, n, COMMANDS * scene.seed + number), targets)
    ours, theirs = FORK.Pipe()
    process = FORK.Process(target=partial(_alone, ours), args=(theirs, desk, targets), daemon=True)
    process.start()
    theirs.close()
    return process, ours


def _alone(ours: Connection, theirs: Connection, desk: Desk, targets: Path) -> None:
    die_with_parent()
    ours.close()  # or the end of the other process would not be noticed
    command(theirs, desk, targets)


def die_with_parent() -> None:
    """Of this process: where its parent is killed, it is killed too (Linux)."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, int(signal.SIGKILL))


def _ended(world: World, ballast: Ballast | None, host: tuple[BaseProcess, Connection], number: int) -> Ended:
    """Serves one command; afterwards room is made, and where it died the array goes on alone."""
    process, pipe = host
    kills = world.scene.of("kill") if number == 0 else []
    assert process.pid is not None
    ended = world.serve(pipe, process.pid, kills[0] if kills else None)
    pipe.close()
    process.join()
    if ended.exit < 0:
        ended = replace(ended, exit=process.exitcode or ended.exit)
    if ballast is not None:
        ballast.away()
    if ended.exit < 0:
        world.passes(float(np.random.default_rng([world.scene.seed, 0x6A]).uniform(0.0, GAP_S)))
    return ended
