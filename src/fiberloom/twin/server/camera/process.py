"""The camera of a served twin in a process of its own, behind all ordinary programs (nice).

Painting an image takes a core for a second or more, and sending it some tenths; the twin's clock is due
every 0.5 ms. The camera's process asks the twin where its fibres are, at mid-exposure, and does all
else alone. It ends with the pipe.
"""

from __future__ import annotations

import asyncio
import os
import signal
import subprocess
import threading
import time
import traceback
from contextlib import suppress
from dataclasses import dataclass, replace
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane
from fiberloom.metrology.cameras import check_fiducials
from fiberloom.metrology.sources.child import begin_child, end_child
from fiberloom.twin.camera.imaging import CameraModel, ImagingCamera, StillScene
from fiberloom.twin.camera.models import imaging_camera, model_for
from fiberloom.twin.errors.sizes import NO_ERRORS, TwinErrors
from fiberloom.twin.server.address import Address
from fiberloom.twin.server.camera.alpaca import AlpacaServer
from fiberloom.twin.server.camera.discovery import DiscoveryAnswer
from fiberloom.twin.server.camera.exposing import Look, TwinShutter, Watched
from fiberloom.twin.server.camera.folder import TRIGGER, FolderWriter
from fiberloom.twin.server.camera.indi import NAME as INDI_NAME
from fiberloom.twin.server.camera.indi import IndiServer

NICENESS = 10
START_S = 60.0
"""So long the process may take to begin."""
_LOOK, _FAULTS = "look", "faults"
_LIFE_S = 0.25
"""How often the process looks whether the twin is still there."""


@dataclass(frozen=True)
class CameraDoors:
    """By which ways hosts reach the camera; None: not by this one."""

    alpaca: Address | None = None
    folder: Path | None = None
    every_s: float = 0.0
    """Into the folder an image after so many seconds; 0: when triggered."""
    indi: Address | None = None
    discovery_port: int | None = None
    """UDP, at which the Alpaca camera answers hosts that look for one."""

    def __str__(self) -> str:
        urls = [f"alpaca://{self.alpaca}/0"] if self.alpaca else []
        if self.folder:
            urls.append(f"folder:{self.folder}")
            if not self.every_s:
                urls[-1] += f"?trigger=touch {{folder}}/{TRIGGER}_{{exposure}}"
        if self.indi:
            urls.append(f"indi://{self.indi}/{INDI_NAME}")
        return "camera: " + ", ".join(urls)


@dataclass(frozen=True)
class _CameraSetup:
    """What the process needs to know."""

    plane: FocalPlane
    model: CameraModel
    seed: int
    speed: float
    doors: CameraDoors
    errors: TwinErrors = NO_ERRORS

    def camera(self) -> ImagingCamera:
        nothing = StillScene(self.plane.centres_mm[:0])
        return imaging_camera(nothing, self.plane, self.seed, self.model, threads=1, errors=self.errors)


class CameraProcess:
    """A camera that looks at a served twin. `twin` tells what there is to be seen, in this process.

    `open` in the event loop that answers; `plane`, `seed` and `speed` are the twin's, `doors` where hosts
    reach the camera.
    """

    def __init__(
        self,
        plane: FocalPlane,
        twin: Watched,
        *,
        seed: int,
        speed: float,
        doors: CameraDoors,
        errors: TwinErrors = NO_ERRORS,
    ) -> None:
        """`errors`: of the fiducials' table and the air, um rms."""
        check_fiducials(plane)
        self._twin = twin
        self._setup = _CameraSetup(plane, model_for(plane), seed, speed, doors, errors)
        self._connection: Connection | None = None
        self._process: subprocess.Popen[bytes] | None = None
        self.doors = doors
        self.looks = 0

    async def open(self) -> None:
        """Starts the process and waits until it listens. Raises InputError where it cannot."""
        self._process, self._connection = begin_child(__name__)
        self._connection.send(self._setup)
        said = await asyncio.get_running_loop().run_in_executor(None, self._first_word)
        if isinstance(said, str):
            self.close()
            raise InputError(said)
        self.doors = said
        asyncio.get_running_loop().add_reader(self._connection.fileno(), self._answer)

    def close(self) -> None:
        """Ends the process."""
        if self._connection is not None:
            with suppress(RuntimeError):  # no loop runs any more
                asyncio.get_running_loop().remove_reader(self._connection.fileno())
            assert self._process is not None
            end_child(self._process, self._connection)
            self._connection = None

    def _first_word(self) -> CameraDoors | str:
        assert self._connection is not None
        try:
            if not self._connection.poll(START_S):
                return f"the camera's process did not begin within {START_S:g} s"
            said: CameraDoors | str = self._connection.recv()
        except (EOFError, OSError):
            return "the camera's process ended at once; what it wrote says why"
        return said

    def _answer(self) -> None:
        """The camera looks."""
        assert self._connection is not None
        try:
            wanted = self._connection.recv()
            self.looks += wanted == _LOOK
            self._connection.send(self._twin.look() if wanted == _LOOK else self._twin.faults())
        except (EOFError, OSError):  # it has ended; hosts see that themselves
            asyncio.get_running_loop().remove_reader(self._connection.fileno())


class _Twin:
    """The twin, as the camera's process asks it."""

    def __init__(self, connection: Connection) -> None:
        self._connection, self._lock = connection, threading.Lock()

    def look(self) -> Look:
        answer: Look = self._ask(_LOOK)
        return answer

    def faults(self) -> frozenset[str]:
        answer: frozenset[str] = self._ask(_FAULTS)
        return answer

    def _ask(self, what: str) -> Any:
        try:
            with self._lock:
                self._connection.send(what)
                answer = self._connection.recv()
        except (EOFError, OSError):
            os._exit(0)  # the twin has gone; threads may wait for it
        return answer

    def wait_for_its_end(self) -> None:
        """Returns when the pipe ends: with the lock in hand nothing else can come."""
        with suppress(EOFError, OSError):
            while True:
                with self._lock:
                    if self._connection.poll(0.0):
                        self._connection.recv()
                time.sleep(_LIFE_S)


def main(fd: int) -> None:
    """The camera's process: serves until the pipe `fd` ends."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C reaches both; the twin ends this one
    os.nice(NICENESS)
    connection = Connection(fd)
    setup: _CameraSetup = connection.recv()
    twin = _Twin(connection)
    shutter = TwinShutter(setup.camera(), twin, setup.speed)
    try:
        open_doors: Any = _open(shutter, setup.doors)
    except OSError as error:
        connection.send(f"{setup.doors}: {error.strerror or error}; choose another address or folder")
        return
    except Exception:
        traceback.print_exc()
        return
    connection.send(open_doors)
    twin.wait_for_its_end()
    os._exit(0)  # threads may still paint


def _open(shutter: TwinShutter, doors: CameraDoors) -> CameraDoors:
    if doors.folder is not None:
        doors.folder.mkdir(parents=True, exist_ok=True)
        FolderWriter(shutter, doors.folder, shutter.camera.model.exposure_s, doors.every_s)
    if doors.indi is not None:
        IndiServer(shutter, doors.indi)
    if doors.alpaca is None:
        return doors
    server = AlpacaServer(shutter, doors.alpaca.host, doors.alpaca.port)
    alpaca = Address(doors.alpaca.host, server.port)
    if doors.discovery_port is not None:
        DiscoveryAnswer(alpaca, doors.discovery_port)
    return replace(doors, alpaca=alpaca)
