"""A camera by INDI, with `indipyclient`: whatever driver an `indiserver` runs.

The talking is done by a process of its own (`indi_child`), which is begun with the first exposure.
"""

from __future__ import annotations

import itertools
import shutil
import socket
import subprocess
import tempfile
import weakref
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path

from fiberloom.errors import InputError
from fiberloom.metrology.images import CameraImage
from fiberloom.metrology.sources import errors, indi_child
from fiberloom.metrology.sources.child import begin_child, end_child
from fiberloom.metrology.sources.deadline import Deadline
from fiberloom.metrology.sources.errors import (
    CameraAborted,
    CameraError,
    CameraRefused,
    CameraSilent,
    ImageBroken,
)
from fiberloom.metrology.sources.fits import FitsForeign, FitsIncomplete, check_complete
from fiberloom.metrology.sources.folder import image_in_memory
from fiberloom.metrology.sources.indi_child import IndiOrder, IndiWord
from fiberloom.metrology.sources.remote import ExposureSettings, RemoteSource

_CONNECT_S = 5.0
_POLL_S = 0.05
"""How often it is looked whether the exposure is given up."""
_GIVEN_UP_S = indi_child.GIVE_UP_S + 0.5
"""So long the process may take to tell the camera."""


class IndiSource(RemoteSource):
    """The camera `name` at the server `host` and `port`; see `RemoteSource`."""

    def __init__(self, host: str, port: int, name: str, settings: ExposureSettings) -> None:
        super().__init__(f"indi://{host}:{port}/{name}", settings)
        self.host, self.port, self.device = host, port, name
        self._talker: IndiTalker | None = None

    def close(self) -> None:
        """Gives up what is running and ends the process; a further exposure begins another one."""
        super().close()
        with self._busy:
            self._end_talker()

    def _take(self, deadline: Deadline) -> CameraImage:
        deadline.doing = "connecting"
        try:
            socket.create_connection((self.host, self.port), min(_CONNECT_S, deadline.left_s())).close()
        except OSError as error:
            raise CameraSilent(
                f"{self.name}: no connection ({error}); is indiserver running, and is this its address?"
            ) from None
        talker = self._talker = self._talker or IndiTalker(self.name)
        try:
            return self._image(talker.expose(self, deadline))
        except EOFError:
            self._end_talker()
            raise CameraSilent(
                f"{self.name}: the process that talks to the server has ended; what it wrote says why"
            ) from None

    def _end_talker(self) -> None:
        if self._talker is not None:
            self._talker.end()
            self._talker = None

    def _image(self, path: Path) -> CameraImage:
        try:
            check_complete(path)
            return image_in_memory(path)
        except (FitsIncomplete, FitsForeign, InputError) as error:
            raise ImageBroken(f"{self.name}: no whole image in FITS ({error}); take another one") from None
        finally:
            path.unlink(missing_ok=True)


class IndiTalker:
    """The process that talks to the server of a `camera`, and the folder that it writes into."""

    def __init__(self, camera: str) -> None:
        try:
            self.folder = Path(tempfile.mkdtemp(prefix="fiberloom-indi-"))
            self.process, self._connection = begin_child(indi_child.__name__)
        except OSError as error:
            raise CameraRefused(f"{camera}: no process can be begun ({error})") from None
        self.end = weakref.finalize(self, _end, self.process, self._connection, self.folder)
        """Ends the process and removes the folder; called by itself where this is held no longer."""
        self._numbers = itertools.count(1)

    def expose(self, source: IndiSource, deadline: Deadline) -> Path:
        """A file with the image. Raises CameraError, and EOFError where the process has ended."""
        number = next(self._numbers)
        self._send(
            IndiOrder(
                number,
                source.name,
                source.host,
                source.port,
                source.device,
                source.settings.exposure_s,
                self.folder,
            )
        )
        try:
            return self._answer(number, deadline)
        except (CameraAborted, CameraSilent):
            self._give_up(number)
            raise

    def _answer(self, number: int, deadline: Deadline) -> Path:
        while True:
            while not self._connection.poll(_POLL_S):
                deadline.check()
            word = self._word()
            if word.number != number:
                continue
            deadline.doing = word.doing or deadline.doing
            if word.error:
                kind: type[CameraError] = getattr(errors, word.error)
                raise kind(word.text)
            if word.image is not None:
                return word.image

    def _give_up(self, number: int) -> None:
        """So that the camera is free for the next exposure, if it hears."""
        last = Deadline("", _GIVEN_UP_S)
        with suppress(EOFError, CameraError):
            self._send(None)
            self._answer(number, last)
        last.close()

    def _send(self, order: IndiOrder | None) -> None:
        try:
            self._connection.send(order)
        except OSError:
            raise EOFError from None

    def _word(self) -> IndiWord:
        try:
            word: IndiWord = self._connection.recv()
        except OSError:
            raise EOFError from None
        return word


def _end(process: subprocess.Popen[bytes], connection: Connection, folder: Path) -> None:
    end_child(process, connection)
    shutil.rmtree(folder, ignore_errors=True)
