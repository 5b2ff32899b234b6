"""A camera whose program writes FITS files into a folder; a command may trigger each exposure."""

from __future__ import annotations

import fnmatch
import importlib
import logging
import shlex
import subprocess
import tempfile
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from fiberloom.errors import InputError
from fiberloom.metrology.images import CameraImage, read_image
from fiberloom.metrology.sources.deadline import Deadline
from fiberloom.metrology.sources.errors import CameraRefused, CameraSilent, ImageBroken, ImageStale
from fiberloom.metrology.sources.fits import FitsForeign, FitsIncomplete, check_complete
from fiberloom.metrology.sources.fresh import began_too_early
from fiberloom.metrology.sources.remote import ExposureSettings, RemoteSource

PATTERN = "*.fits,*.fit,*.fts,*.fits.gz,*.fits.fz"
"""Names of images, unless told."""
POLL_S = 0.1
"""How often the folder is looked at; with `watchdog` events come sooner. Network disks send none."""
SETTLED_S = 2.0
"""A file that has not changed for so long and is no whole image will not become one."""


@dataclass(frozen=True)
class _FileState:
    """Of a file at one moment."""

    size: int
    changed_ns: int
    inode: int


@dataclass
class _FileSearch:
    """What has been seen of new files since the request."""

    camera: str
    asked_utc_s: float
    clock_s: float
    before: dict[Path, _FileState]
    since: dict[Path, tuple[_FileState, float]] = field(default_factory=dict)
    """The state of a new file, and since when."""
    skipped: dict[Path, _FileState] = field(default_factory=dict)
    broken: str = ""
    stale: str = ""

    def image(self, now: dict[Path, _FileState]) -> CameraImage | None:
        """A whole image that was exposed after the request, if there is one now."""
        for path, state in sorted(now.items(), key=lambda item: item[1].changed_ns):
            if state not in (self.before.get(path), self.skipped.get(path)):
                image = self._look(path, state)
                if image is not None:
                    return image
        return None

    def _look(self, path: Path, state: _FileState) -> CameraImage | None:
        known, since_s = self.since.get(path, (None, 0.0))
        if known != state:  # it may be in the writing: once more in a moment
            self.since[path] = state, time.monotonic()
            return None
        try:
            check_complete(path)
            image = image_in_memory(path, state.changed_ns * 1e-9)
        except (FitsIncomplete, FitsForeign, InputError) as error:
            self.broken = f"{path.name}: {error}"
            if time.monotonic() - since_s > SETTLED_S:
                raise ImageBroken(f"{self.camera}: {self.broken}; no whole image; take another one") from None
            return None
        except FileNotFoundError:  # it was renamed meanwhile
            return None
        self.broken = ""
        if began_too_early(image, self.asked_utc_s, self.clock_s):
            self.skipped[path] = state
            self.stale = f"{path.name} was exposed before it was asked for"
            return None
        return image

    def failure(self, silent: CameraSilent) -> Exception:
        """What to raise where no image came in time."""
        if self.broken:
            return ImageBroken(f"{silent} ({self.broken})")
        return ImageStale(f"{silent} ({self.stale})") if self.stale else silent


def image_in_memory(path: Path, changed_utc_s: float | None = None) -> CameraImage:
    """The image of a file, which may go: one that is mapped and written anew would end this process.

    `changed_utc_s`: when the file was written; it bounds the exposure where the header has no date.
    """
    image = read_image(path)
    begun = image.begun_utc_s
    if begun is None and changed_utc_s is not None:
        begun = changed_utc_s - image.exposure_s
    return replace(image, pixels=np.array(image.pixels), begun_utc_s=begun, time_s=begun or 0.0)


class FolderSource(RemoteSource):
    """Takes the first image that appears in `folder` and was exposed after the request.

    See `RemoteSource`. `trigger`: a command, without a shell, that makes the camera expose;
    `{exposure}` in it becomes the seconds and `{folder}` the folder. Without one the camera runs free.
    `pattern`: names of images, joined by commas. A name that begins with a point is none.
    """

    def __init__(
        self, folder: str | Path, settings: ExposureSettings, *, trigger: str = "", pattern: str = PATTERN
    ) -> None:
        self.folder = Path(folder).expanduser()
        super().__init__(f"folder:{self.folder}", settings)
        if not self.folder.is_dir():
            raise InputError(f"camera {self.name}: no such folder")
        try:
            words = shlex.split(trigger)
        except ValueError as error:
            raise InputError(f"camera {self.name}: trigger={trigger}: {error}") from None
        told = {"{exposure}": f"{settings.exposure_s:.10g}", "{folder}": str(self.folder)}
        for mark, text in told.items():
            words = [word.replace(mark, text) for word in words]
        self._trigger = words
        self._patterns = [p.strip() for p in pattern.split(",") if p.strip()]
        self._event = threading.Event()
        self._observer: Any = None

    def close(self) -> None:
        """Gives up what is running; the folder is looked at no longer."""
        super().close()
        if self._observer is not None:
            self._observer.stop()
            self._observer.join()
            self._observer = None

    def _take(self, deadline: Deadline) -> CameraImage:
        search = _FileSearch(self.name, time.time(), self.settings.clock_s, self._states())
        deadline.doing = "waiting for a file"
        deadline.at_end(self._event.set)
        self._observe()
        with self._triggered() as check_trigger:
            while True:
                image = search.image(self._states())
                if image is not None:
                    return image
                check_trigger()
                try:
                    deadline.wait(POLL_S, self._event)
                except CameraSilent as silent:
                    raise search.failure(silent) from None

    def _states(self) -> dict[Path, _FileState]:
        try:
            paths = [p for p in self.folder.iterdir() if self._is_image(p.name)]
        except OSError as error:
            raise CameraRefused(f"{self.name}: {error.strerror or error}; is the disk there?") from None
        states = {}
        for path in paths:
            with suppress(OSError):  # renamed or deleted meanwhile
                stat = path.stat()
                states[path] = _FileState(stat.st_size, stat.st_mtime_ns, stat.st_ino)
        return states

    def _is_image(self, name: str) -> bool:
        return not name.startswith(".") and any(fnmatch.fnmatch(name, p) for p in self._patterns)

    def _observe(self) -> None:
        """Events of the folder wake the look at it, where `watchdog` is installed."""
        if self._observer is not None:
            return
        try:
            events = importlib.import_module("watchdog.events")
            observer = importlib.import_module("watchdog.observers").Observer()
        except ImportError:
            return
        # at its end it tells of a race that is of no consequence
        logging.getLogger("watchdog.observers.inotify").setLevel(logging.CRITICAL)
        handler = events.FileSystemEventHandler()
        handler.on_any_event = lambda event: self._event.set()
        observer.daemon = True
        with suppress(OSError):  # too many watches: looking at it is enough
            observer.schedule(handler, str(self.folder))
            observer.start()
            self._observer = observer

    @contextmanager
    def _triggered(self) -> Iterator[Any]:
        """Runs the command beside; what is given raises CameraRefused once it has failed."""
        if not self._trigger:
            yield lambda: None
            return
        with tempfile.TemporaryFile() as said:
            try:
                process = subprocess.Popen(
                    self._trigger, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL, stderr=said
                )
            except OSError as error:
                raise CameraRefused(
                    f"{self.name}: trigger {self._trigger[0]}: {error.strerror or error}"
                ) from None

            def check() -> None:
                if process.poll():
                    said.seek(0)
                    words = said.read(4096).decode(errors="replace").strip().splitlines()
                    raise CameraRefused(
                        f"{self.name}: trigger {self._trigger[0]} ended with {process.returncode}: "
                        f"{words[-1] if words else 'without a word'}"
                    )

            try:
                yield check
            finally:
                _end(process)


def _end(process: subprocess.Popen[bytes]) -> None:
    """A trigger that has not ended by itself."""
    try:
        process.wait(1.0)
    except subprocess.TimeoutExpired:
        process.terminate()
        try:
            process.wait(1.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()
