"""An array and a shutter that outlive the process that observes with them: a twin served over a pipe.

Time is the twin's. It passes while a process waits for the bus, and goes on where that has died. The shutter
notes where every fibre truly is when it opens and when it closes.
"""

from __future__ import annotations

import asyncio
import contextlib
import multiprocessing
import os
import signal
import threading
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from typing import Any

import numpy as np

from fiberloom.bus.transport import Frame
from fiberloom.instruments import FocalPlane
from fiberloom.instruments.model import METROLOGY
from fiberloom.metrology import Measurement
from fiberloom.twin.camera.noise_camera import NoiseCamera
from fiberloom.twin.twin import Touch, Twin
from fiberloom.twin.units import Units
from fiberloom.typing import Floats
from fiberloom.units import TICK_S, UM_PER_MM

FORK = multiprocessing.get_context("fork")
SLICE_S = 0.005
MOST_S = 5.0
"""Of one request: a process that waits for a shutter can be killed on the way."""


@dataclass
class Opening:
    """One time that the shutter was open."""

    key: str
    start_s: float
    end_s: float
    begin_mm: Floats
    """(F, N, 2) all science fibres as it opened."""
    end_mm: Floats | None = None
    """As it closed; None: it is open."""

    @property
    def moved_um(self) -> float:
        """The largest way of a fibre meanwhile."""
        assert self.end_mm is not None
        return float(UM_PER_MM * np.linalg.norm(self.end_mm - self.begin_mm, axis=-1).max())


@dataclass
class NightWorld:
    """A twin, its camera and a shutter."""

    twin: Twin
    camera: NoiseCamera
    fibres: list[str]
    openings: list[Opening] = field(default_factory=list)
    contacts: list[Touch] = field(default_factory=list)
    images: int = 0
    requests: int = 0
    _backlog: list[Frame] = field(default_factory=list)

    @classmethod
    def of(cls, plane: FocalPlane, units: Units, seed: int) -> NightWorld:
        """Folded and at rest."""
        twin = Twin(plane, units, seed=seed, threads=1)
        camera = NoiseCamera(twin, plane.instrument.metrology.noise_rms_um, seed)
        return cls(twin, camera, [name for name in plane.points if name != METROLOGY])

    def passes(self, duration_s: float, until_heard: bool = False) -> None:
        """Lets time pass; `until_heard`: no longer than until something arrives."""
        end_s = self.twin.time_s + duration_s
        while True:
            left_s = end_s - self.twin.time_s
            replies = self.twin.run(min(max(left_s, TICK_S), SLICE_S))
            self._backlog += [Frame(*reply) for reply in replies]
            self._close()
            if left_s <= SLICE_S or (until_heard and self._backlog):
                break
        self.contacts += self.twin.touches()

    @property
    def is_open(self) -> bool:
        """The shutter is."""
        return bool(self.openings) and self.openings[-1].end_mm is None

    def _fibres_mm(self) -> Floats:
        return np.array([self.twin.fibre_xy(name) for name in self.fibres])

    def _close(self) -> None:
        for opening in self.openings[-1:]:
            if opening.end_mm is None and self.twin.time_s >= opening.end_s:
                opening.end_mm = self._fibres_mm()

    def _open(self, key: str, exposure_s: float) -> None:
        if any(opening.key == key for opening in self.openings):
            return
        now_s = self.twin.time_s
        self.openings.append(Opening(key, now_s, now_s + exposure_s, self._fibres_mm()))

    def _seen(self, key: str) -> tuple[float | None, float | None]:
        for opening in self.openings:
            if opening.key == key:
                return opening.start_s, None if opening.end_mm is None else opening.end_s
        return None, None

    def _hears(self, timeout_s: float) -> list[Frame]:
        if not self._backlog:
            self.passes(min(timeout_s, MOST_S), until_heard=True)
        frames, self._backlog = self._backlog, []
        return frames

    def _looks(self) -> Measurement:
        self.images += 1
        return self.camera.measure()

    def answer(self, name: str, given: Sequence[Any]) -> Any:
        """What a process asks for."""
        self.requests += 1
        asked: dict[str, Callable[..., Any]] = {
            "send": self.twin.send,
            "receive": self._hears,
            "look": self._looks,
            "open": self._open,
            "seen": self._seen,
        }
        return asked[name](*given)

    def serve(self, host: Connection, kill: Callable[[NightWorld], bool], fuse: Callable[[], None]) -> Any:
        """Serves one process until it ends; what it said at last, None: it was killed.

        `kill`: asked before each answer whether `fuse` is to be lit.
        """
        self._backlog.clear()
        lit = False
        with contextlib.suppress(OSError):
            host.send(self.twin.time_s)
        while True:
            try:
                name, *given = host.recv()
            except (EOFError, OSError):
                return None
            if name == "ended":
                return given[0]
            if not lit and kill(self):
                lit = True
                fuse()
            with contextlib.suppress(OSError):  # dead by now: the next request tells
                host.send((self.answer(name, given), self.twin.time_s))


class PipedArray:
    """Bus, camera and shutter over a pipe. Implements `Transport`, `Camera` and, for a clock, `Shutter`."""

    def __init__(self, pipe: Connection) -> None:
        self._pipe, self._lock = pipe, threading.Lock()
        self.time_s: float = pipe.recv()

    def _ask(self, *words: Any) -> Any:
        with self._lock:
            self._pipe.send(words)
            answer, self.time_s = self._pipe.recv()
        return answer

    async def send(self, frames: Sequence[Any]) -> None:
        """Puts frames on the bus."""
        self._ask("send", [(frame[0], bytes(frame[1])) for frame in frames])

    async def receive(self, timeout_s: float) -> list[Frame]:
        """What has come."""
        await asyncio.sleep(0)
        frames: list[Frame] = self._ask("receive", timeout_s)
        return frames

    async def close(self) -> None:
        """Nothing to let go of."""

    def measure(self, expected_mm: object = None) -> Measurement:
        """An image."""
        image: Measurement = self._ask("look")
        return image

    async def start(self, key: str, exposure_s: float) -> None:
        """Opens the shutter."""
        self._ask("open", key, exposure_s)

    async def seen_s(self, key: str) -> tuple[float | None, float | None]:
        """When it was opened and closed, s of the twin."""
        times: tuple[float | None, float | None] = self._ask("seen", key)
        return times


def kill_after(pid: int, delay_s: float) -> Callable[[], None]:
    """Kills a process a little later, in real time: between any two instructions."""

    def light() -> None:
        threading.Timer(delay_s, _killed, (pid,)).start()

    return light


def _killed(pid: int) -> None:
    with contextlib.suppress(ProcessLookupError):
        os.kill(pid, signal.SIGKILL)
