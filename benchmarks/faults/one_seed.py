"""One seed in a process of its own: an array, two commands one after the other, and what came of it.

Where one leaves the array locked after a collision `fiberloom recover` follows, as an operator would type it.
"""

from __future__ import annotations

import ctypes
import gc
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
RECOVERS = 2
"""So often `recover` is typed, where the array is locked still: the camera may fail meanwhile."""
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
        hosts = [_hosts(array, scene, desk, number) for number in range(COMMANDS)]
        fill = None if ballast is None else lambda fault: ballast.fill(fault.size)
        world = World(array.plane, array.units, scene, fill)
        operator = Operator(world, ballast, desk)
        for number, (observe, *recovers) in enumerate(hosts):
            operator.types(observe, kill=number == 0)
            operator.goes_on(recovers)
        line = judged(world, array.maps, folder, operator.ended)
        line |= {"locked": operator.locked, "recovered": operator.recovered}
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


Host = tuple[BaseProcess, Connection]
"""A command in a process of its own, that waits for its turn."""


def _hosts(array: Array, scene: Scene, desk: Desk, number: int) -> list[Host]:
    """An observation, and what may have to follow it; begun before the twin has threads."""
    targets = desk.folder / f"targets-{number}.csv"
    n = 8 * len(array.plane)
    write_targets(random_targets(array.plane, n, COMMANDS * scene.seed + number), targets)
    return [_host(desk, words) for words in [desk.observe(targets), *[desk.recover()] * RECOVERS]]


def _host(desk: Desk, words: list[str]) -> Host:
    ours, theirs = FORK.Pipe()
    process = FORK.Process(target=partial(_alone, ours), args=(theirs, desk, words), daemon=True)
    process.start()
    theirs.close()
    return process, ours


def _alone(ours: Connection, theirs: Connection, desk: Desk, words: list[str]) -> None:
    gc.freeze()  # what the parent left may own threads that are not here: to join them is a crash
    die_with_parent()
    ours.close()  # or the end of the other process would not be noticed
    command(theirs, desk, words)


def die_with_parent() -> None:
    """Of this process: where its parent is killed, it is killed too (Linux)."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, int(signal.SIGKILL))


class Operator:
    """Types commands, makes room on the disk, recovers what is locked."""

    def __init__(self, world: World, ballast: Ballast | None, desk: Desk) -> None:
        """`world`: the array; `ballast`: of a disk that may be full; `desk`: files."""
        self._world, self._ballast, self._desk = world, ballast, desk
        self.ended: list[Ended] = []
        """Every command, in order."""
        self.locked = self.recovered = 0
        """How often a command left the array locked, and how often it was not after `recover`."""

    def types(self, host: Host, *, kill: bool = False, deed: str = "observe") -> None:
        """Serves one command; afterwards room is made, and where it died the array goes on alone."""
        (process, pipe), world = host, self._world
        kills = world.scene.of("kill") if kill else []
        assert process.pid is not None
        ended = world.serve(pipe, process.pid, kills[0] if kills else None)
        pipe.close()
        process.join()
        code = (process.exitcode or ended.exit) if ended.exit < 0 else ended.exit
        self.ended.append(replace(ended, exit=code, deed=deed))
        if self._ballast is not None:
            self._ballast.away()
        if code < 0:
            world.passes(float(np.random.default_rng([world.scene.seed, 0x6A]).uniform(0.0, GAP_S)))

    def goes_on(self, recovers: list[Host]) -> None:
        """Recovers where the array is locked, again where that fails; a host that is not needed ends."""
        known = self.locked > self.recovered
        self.locked += self._desk.locked() and not known
        for process, pipe in recovers:
            if self._desk.locked():
                self.types((process, pipe), deed="recover")
            else:
                pipe.close()
                process.kill()
        self.recovered = self.locked - self._desk.locked()
