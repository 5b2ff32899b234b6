"""The array of one seed: twin, camera and cables, served over a pipe to commands that may die.

Time is the twin's: it passes while a command waits for the bus, and goes on where that has died.
"""

from __future__ import annotations

import asyncio
import contextlib
import os
import signal
import threading
from collections.abc import Callable
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any, NamedTuple

import numpy as np

from fiberloom.bus.client import Client
from fiberloom.bus.links import Link
from fiberloom.bus.transport import Frame
from fiberloom.instruments import FocalPlane
from fiberloom.instruments.model import AXES
from fiberloom.metrology import Measurement
from fiberloom.planning import random_configuration
from fiberloom.twin.camera.noise_camera import NoiseCamera
from fiberloom.twin.faults.clock import FaultClock
from fiberloom.twin.faults.faults import Fault
from fiberloom.twin.hardware import draw_faults
from fiberloom.twin.transport import TwinTransport
from fiberloom.twin.twin import Touch, Twin
from fiberloom.twin.units import Units
from fiberloom.typing import Floats
from fiberloom.units import TICK_S

from .draw import OF_THE_CAMERA, Injected, Scene

SLICE_S = 0.005
DEADLINE_S = 10.0
"""Of an exposure that hangs."""


class Shot(NamedTuple):
    """The truth when an image was taken: (N, 2) mm of each fibre."""

    time_s: float
    fibres: dict[str, Floats]


@dataclass(frozen=True)
class Ended:
    """How a command ended."""

    exit: int
    said: str
    begun_s: float
    ended_s: float
    killed: bool = False
    deed: str = "observe"


class World:
    """A deployed field with the faults of a scene."""

    def __init__(
        self, plane: FocalPlane, units: Units, scene: Scene, fill: Callable[[Injected], bool] | None = None
    ) -> None:
        """`plane`, its true `units`; `scene`: what goes wrong; `fill`: fills the disk, and tells whether."""
        self.plane, self.scene = plane, scene
        start_deg = random_configuration(plane, scene.seed)
        self.twin = Twin(plane, units, seed=scene.seed, start_deg=start_deg, threads=1)
        self.camera = NoiseCamera(self.twin, plane.instrument.metrology.noise_rms_um, scene.seed)
        for fault in scene.of("false_start"):
            asyncio.run(self._lie(fault))
        self.clock = FaultClock(self.twin, draw_faults(plane, scene.text(), scene.seed), scene.seed)
        self.links = [Link("gateway 1"), Link("gateway 2")]
        self.shots: list[Shot] = []
        self.contacts: list[Touch] = []
        self.images = 0
        self.acted: set[Injected] = set()
        """Of camera, disk, cables and kills: what a command has met."""
        self._fill_disk = fill or (lambda _: False)
        self._backlog: list[Frame] = []
        self._due = sorted(self._own(), key=lambda entry: entry[0])
        self._follow()

    async def _lie(self, fault: Injected) -> None:
        """One positioner takes a wrong alpha for its own; within its travel, so that it takes it."""
        client = Client(TwinTransport(self.twin))
        ids = client.ids = [fault.positioner_id]
        (here,), _ = await client.positions_deg(np.array(ids))
        low, high = self.plane.hard_stops_deg[0]
        there = low + 2.0 + (here[0] + fault.size - low) % (high - low - 4.0)
        await client.set_position(ids, there, here[1])

    def behind(self, fault: Injected) -> list[int]:
        """Positioners behind the gateway whose cable is cut: every other one."""
        assert fault.kind == "cut"
        return [int(p) for p in self.plane.positioner_id[1::2]]

    def _own(self) -> list[tuple[float, Callable[[], object]]]:
        """What the grammar does not know, and when."""
        due: list[tuple[float, Callable[[], object]]] = []
        for fault in self.scene.of("broken_arm"):
            due.append((fault.at_s, lambda f=fault: self._break(f)))
        for fault in self.scene.of("cut"):
            due.append((fault.at_s, lambda f=fault: self._cut(f, True)))
            due.append((fault.at_s + fault.size, lambda f=fault: self._cut(f, False)))
        for fault in self.scene.of("disk_full"):
            due.append((fault.at_s, lambda f=fault: self._fill(f)))
        return due

    def _break(self, fault: Injected) -> None:
        self.twin.slip(fault.positioner_id, AXES[fault.axis], fault.size, fault.size)

    def _fill(self, fault: Injected) -> None:
        if self._fill_disk(fault):
            self.acted.add(fault)

    def _cut(self, fault: Injected, on: bool) -> None:
        mute = {f.positioner_id for f in self.scene.of("mute")}
        for positioner in self.behind(fault):
            for kind in ("deaf", "mute"):
                if kind != "mute" or positioner not in mute:
                    (self.twin.inject if on else self.twin.clear)(Fault(kind, positioner))
        if on:
            self.links[1].goes_down("gateway 2: cable cut", self.twin.time_s)
        else:
            self.links[1].comes_up(self.twin.time_s)

    def _follow(self) -> None:
        while self._due and self._due[0][0] <= self.twin.time_s:
            self._due.pop(0)[1]()
        self.clock.follow()

    # what a command asks

    def passes(self, duration_s: float, until_heard: bool = False) -> None:
        """Lets time pass; `until_heard`: no longer than until something arrives."""
        end_s = self.twin.time_s + duration_s
        while True:
            left_s = end_s - self.twin.time_s
            replies = self.clock.carried(self.twin.run(min(max(left_s, TICK_S), SLICE_S)))
            self._backlog += [Frame(*reply) for reply in replies]
            self._follow()
            if left_s <= SLICE_S or (until_heard and self._backlog):
                break
        self.contacts += self.twin.touches()

    def hears(self, timeout_s: float) -> list[Frame]:
        """Frames for the command."""
        if not self._backlog:
            self.passes(timeout_s, until_heard=True)
        frames, self._backlog = self._backlog, []
        return frames

    def looks(self) -> Measurement | str:
        """An image, or the kind of the fault of the camera."""
        number, self.images = self.images, self.images + 1
        for fault in self.scene.of(*OF_THE_CAMERA):
            if fault.at_s <= number < fault.at_s + fault.size:
                self.acted.add(fault)
                if fault.kind == "camera_hang":
                    self.passes(DEADLINE_S)
                return fault.kind
        self.shots.append(Shot(self.twin.time_s, {f: self.twin.fibre_xy(f) for f in self.plane.points}))
        return self.camera.measure()

    def serve(self, host: Connection, pid: int, kill: Injected | None = None) -> Ended:
        """Serves one command until it ends; `kill`: when its process `pid` is killed."""
        begun_s, fuse = self.twin.time_s, _Fuse(pid, kill)
        self._backlog.clear()  # nobody has listened
        host.send(self.twin.time_s)
        while True:
            try:
                name, *given = host.recv()
            except (EOFError, OSError):
                if fuse.lit and kill is not None:
                    self.acted.add(kill)
                return Ended(-9, "", begun_s, self.twin.time_s, fuse.lit)
            if name == "ended":
                fuse.out()
                return Ended(*given, begun_s, self.twin.time_s)
            fuse.at(self.twin.time_s)
            with contextlib.suppress(ConnectionError):  # dead by now: the next request tells
                host.send((self._answer(name, given), self.twin.time_s, self.links))

    def _answer(self, name: str, given: list[Any]) -> Any:
        if name == "send":
            return self.twin.send(given[0])
        return self.hears(given[0]) if name == "receive" else self.looks()


class _Fuse:
    """Kills a process at a time of the twin and a little real time, which the twin's does not tell."""

    def __init__(self, pid: int, kill: Injected | None) -> None:
        self._kill, self._pid, self.lit = kill, pid, False
        self._timer: threading.Timer | None = None

    def at(self, time_s: float) -> None:
        if self._kill is not None and not self.lit and time_s >= self._kill.at_s:
            self.lit = True
            self._timer = threading.Timer(self._kill.size, os.kill, (self._pid, signal.SIGKILL))
            self._timer.start()

    def out(self) -> None:
        if self._timer is not None:
            self._timer.cancel()
