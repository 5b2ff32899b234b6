"""A command of an operator: the real `fiberloom observe`, with bus and camera at the other end of a pipe."""

from __future__ import annotations

import asyncio
import contextlib
import io
import sys
import threading
import traceback
from collections.abc import Sequence
from dataclasses import dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import fiberloom.connect
from fiberloom.bus.links import Link
from fiberloom.bus.transport import Frame
from fiberloom.cli.app import main
from fiberloom.connect import array_address
from fiberloom.errors import InputError
from fiberloom.metrology import Measurement
from fiberloom.metrology.sources.errors import (
    CameraError,
    CameraRefused,
    CameraSilent,
    ImageBroken,
    ImageStale,
)
from fiberloom.operation.session.states import SessionState
from fiberloom.operation.source import OpenedArray
from fiberloom.store import Store
from fiberloom.store.arrays import ArrayBook

CRASH = 70
"""Exit code of what is no answer to an operator."""
BUS, CAMERA = "cannet://10.0.0.1,10.0.0.2", "alpaca://10.0.0.3:11111/0"
"""Addresses that an operator would type; nothing is there."""

FAILURES: dict[str, CameraError] = {
    "camera_hang": CameraSilent("no image after 10 s"),
    "camera_error": CameraRefused("answered with 500"),
    "camera_half": ImageBroken("cut short"),
    "camera_stale": ImageStale("the exposure began before it was asked for"),
}
"""As the sources of images report them (their own tests show that they do)."""


class PipedArray:
    """Bus and camera over a pipe. Implements `Transport` and `Camera`."""

    def __init__(self, pipe: Connection, ids: Sequence[int], time_s: float) -> None:
        self._pipe, self._ids, self._lock = pipe, list(ids), threading.Lock()
        self.time_s = time_s
        self.links = [Link("gateway 1"), Link("gateway 2")]
        self._known: set[int] = set()

    def _ask(self, *words: Any) -> Any:
        with self._lock:
            self._pipe.send(words)
            answer, self.time_s, self.links = self._pipe.recv()
        return answer

    def link_of(self, positioner: int) -> Link | None:
        """Every other one is behind the second gateway; not known before it has answered."""
        return self.links[self._ids.index(positioner) % 2] if positioner in self._known else None

    async def send(self, frames: Sequence[Any]) -> None:
        """Puts frames on the bus."""
        self._ask("send", [(frame[0], bytes(frame[1])) for frame in frames])

    async def receive(self, timeout_s: float) -> list[Frame]:
        """What has come."""
        await asyncio.sleep(0)
        frames: list[Frame] = self._ask("receive", timeout_s)
        self._known |= {frame.id >> 18 for frame in frames} & set(self._ids)
        return frames

    async def close(self) -> None:
        """Nothing to let go of."""

    def measure(self, expected_mm: object = None) -> Measurement:
        """An image, or a failure as a camera's source reports it."""
        image: Measurement | str = self._ask("look")
        if isinstance(image, str):
            raise FAILURES[image]
        return image


@dataclass(frozen=True)
class Desk:
    """What an operator has: layout, maps, a list of targets, a folder."""

    ids: Sequence[int]
    options: tuple[str, ...]
    """Instrument, positioners and seed of the layout."""
    maps: Path
    folder: Path
    log: Path
    """Takes what the command prints."""

    @property
    def store(self) -> Path:
        """Of the array."""
        return self.folder / "arrays.sqlite"

    def observe(self, targets: Path) -> list[str]:
        """The command, as typed."""
        more = ["--moves", str(MOVES), "--pages", "none", "--out", str(self.folder / "out")]
        return ["fiberloom", "observe", str(targets), *self._array, *more]

    def recover(self) -> list[str]:
        """What the operator types where the array is locked after a collision."""
        return ["fiberloom", "recover", *self._array]

    @property
    def _array(self) -> list[str]:
        files = ["--calibration", str(self.maps), "--store", str(self.store)]
        return [*self.options, "--bus", BUS, "--camera", CAMERA, *files]

    def locked(self) -> bool:
        """Whether the array is locked after a collision."""
        if not self.store.exists():
            return False
        try:
            with Store.read(self.store) as store:
                return ArrayBook(store, array_address(BUS)).state().state == SessionState.LOCKED
        except InputError:  # its command was killed before it had made the tables
            return False


MOVES = 4
"""Of a command: the blind move and three corrections, so that two further ones follow the first two."""


def command(pipe: Connection, desk: Desk, words: list[str]) -> None:
    """Waits for its turn, runs one command of these words, tells how it ended."""
    array = PipedArray(pipe, desk.ids, pipe.recv())
    fiberloom.connect.open_hardware = lambda *_, **__: OpenedArray(array, array)
    sys.argv = words
    code, said = _run()
    with desk.log.open("a") as log:
        log.write(said)
    pipe.send(("ended", code, said))


def _run() -> tuple[int, str]:
    """Exit code, and what was printed for the operator."""
    with contextlib.redirect_stderr(io.StringIO()) as said, contextlib.redirect_stdout(said):
        try:
            main()
            code = 0
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else int(end.code is not None)
        except BaseException:
            traceback.print_exc()
            code = CRASH
    return code, said.getvalue()
