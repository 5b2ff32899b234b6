"""The twin's camera as a program that writes FITS files into a folder.

A file `expose` in the folder, or `expose_SECONDS`, makes it take an image; it takes the file away. Images are
written under a hidden name and renamed when they are complete.
"""

from __future__ import annotations

import threading
from contextlib import suppress
from pathlib import Path

from fiberloom.metrology.images import CameraImage, write_image
from fiberloom.twin.faults.kinds import CameraFaultKind
from fiberloom.twin.server.camera.exposing import TwinShutter

TRIGGER = "expose"
POLL_S = 0.05


class FolderWriter:
    """Writes the images of a shutter into `folder`, until `close`.

    `exposure_s` where the trigger does not say; `every_s`: an image after so many seconds, without a
    trigger; 0: only when triggered.
    """

    def __init__(self, shutter: TwinShutter, folder: Path, exposure_s: float, every_s: float = 0.0) -> None:
        self.shutter, self.folder = shutter, folder
        self._exposure_s, self._every_s = exposure_s, every_s
        self._number = 0
        self._over = threading.Event()
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def close(self) -> None:
        """Writes no more."""
        self._over.set()
        self._thread.join()

    def _run(self) -> None:
        while not self._over.wait(self._every_s or POLL_S):
            for exposure_s in self._wanted():
                image = self.shutter.take(exposure_s)
                if image is not None:
                    with suppress(OSError):  # a full disk: the host sees no image
                        self._write(image)

    def _wanted(self) -> list[float]:
        """Exposures to take now, in seconds."""
        if self._every_s:
            return [self._exposure_s]
        wanted = []
        for path in sorted(self.folder.glob(f"{TRIGGER}*")):
            _, _, seconds = path.name.partition("_")
            with suppress(OSError):
                path.unlink()
                wanted.append(_seconds(seconds, self._exposure_s))
        return wanted

    def _write(self, image: CameraImage) -> None:
        self._number += 1
        path = self.folder / f"image_{self._number:06}.fits"
        hidden = path.with_name(f".{path.name}.part")
        write_image(image, hidden)
        if CameraFaultKind.HALF in self.shutter.faults():
            with hidden.open("r+b") as file:
                file.truncate(hidden.stat().st_size // 2)
        hidden.rename(path)


def _seconds(text: str, otherwise: float) -> float:
    try:
        number = float(text)
    except ValueError:
        return otherwise
    return number if 0.0 <= number < 3600.0 else otherwise
