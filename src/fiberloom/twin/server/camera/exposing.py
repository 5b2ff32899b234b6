"""Exposures of a served twin's camera: what happens between the request and the image.

The scene is the twin's at mid-exposure; it is painted afterwards. Nothing here knows how a host asks.
"""

from __future__ import annotations

import threading
import time
from dataclasses import dataclass, field, replace
from enum import IntEnum
from typing import NamedTuple, Protocol

from fiberloom.metrology.images import CameraImage
from fiberloom.twin.camera.imaging import CameraModel, ImagingCamera, StillScene
from fiberloom.twin.faults.kinds import CameraFaultKind
from fiberloom.typing import Floats

DAY_S = 86400.0


class Look(NamedTuple):
    """What the twin tells of itself at one moment."""

    time_s: float
    lit_mm: Floats
    """(N, 2) of the fibres; NaN for a dark one."""


class Watched(Protocol):
    """The twin that a camera looks at."""

    def look(self) -> Look:
        """What there is to be seen now."""
        ...

    def faults(self) -> frozenset[str]:
        """Of the camera, those that are on now; asked often, so it must not hold up the twin."""
        ...


class ShutterState(IntEnum):
    """CameraState of Alpaca."""

    IDLE = 0
    EXPOSING = 2
    READING = 3
    ERROR = 5


class ExposureError(Exception):
    """The camera is broken."""


@dataclass
class _Exposure:
    """One that was asked for."""

    duration_s: float
    begun_utc_s: float
    given_up: threading.Event = field(default_factory=threading.Event)


class TwinShutter:
    """Exposes and paints in threads; one exposure at a time, a new one ends the one before.

    `twin`: what it looks at; `speed`: its seconds in one of ours, in which exposures are counted.
    """

    def __init__(self, camera: ImagingCamera, twin: Watched, speed: float = 1.0) -> None:
        self.camera, self._twin, self._speed = camera, twin, speed
        self._model = camera.model
        self.state = ShutterState.IDLE
        self.image: CameraImage | None = None
        """The last one that is ready, None while one is being taken."""
        self._before: CameraImage | None = None
        self._now: _Exposure | None = None
        self._lock, self._painting = threading.Lock(), threading.Lock()
        self.taken = 0

    def faults(self) -> frozenset[str]:
        """Those of the camera that are on now."""
        return self._twin.faults()

    def check(self) -> None:
        """Raises ExposureError where the camera is broken now."""
        if CameraFaultKind.ERROR in self.faults():
            raise ExposureError("the camera is broken")

    def start(self, duration_s: float) -> None:
        """Begins an exposure of so many seconds."""
        self.check()
        self.give_up()
        exposure = _Exposure(duration_s, time.time())
        with self._lock:
            self.state, self.image, self._now = ShutterState.EXPOSING, None, exposure
        threading.Thread(target=self._run, args=(exposure,), daemon=True).start()

    def give_up(self) -> None:
        """Ends the running exposure without an image."""
        with self._lock:
            if self._now is not None:
                self._now.given_up.set()
                self._now, self.state = None, ShutterState.IDLE

    def take(self, duration_s: float) -> CameraImage | None:
        """Exposes and waits; None where the exposure was given up or the camera hangs or is broken."""
        if self.faults() & {CameraFaultKind.HANG, CameraFaultKind.ERROR}:
            return None
        self.start(duration_s)
        while self.state in (ShutterState.EXPOSING, ShutterState.READING):
            time.sleep(0.01)
        return self.image

    def _run(self, exposure: _Exposure) -> None:
        faults = self.faults()
        half_s = 0.5 * exposure.duration_s / self._speed
        if CameraFaultKind.HANG in faults or exposure.given_up.wait(half_s):
            return
        scene = self._twin.look()
        if exposure.given_up.wait(half_s):
            return
        self._say(exposure, ShutterState.READING)
        try:
            image = self._read_out(exposure, scene, stale=CameraFaultKind.STALE in faults)
        except Exception:
            self._say(exposure, ShutterState.ERROR)
            raise
        with self._lock:
            if self._now is exposure:
                self.image, self._before = image, image
                self._now, self.state = None, ShutterState.IDLE
                self.taken += 1

    def _read_out(self, exposure: _Exposure, scene: Look, stale: bool) -> CameraImage:
        if stale and self._before is not None:
            return self._before
        with self._painting:
            self.camera.scene = StillScene(scene.lit_mm, scene.time_s)
            self.camera.model = brightened(self._model, exposure.duration_s / self._model.exposure_s)
            image = self.camera.expose()
        begun_utc_s = exposure.begun_utc_s - (DAY_S if stale else 0.0)
        return replace(image, exposure_s=exposure.duration_s, begun_utc_s=begun_utc_s)

    def _say(self, exposure: _Exposure, state: ShutterState) -> None:
        with self._lock:
            if self._now is exposure:
                self.state = state


def brightened(model: CameraModel, factor: float) -> CameraModel:
    """The camera with an exposure longer by this factor: all that shines and all that strikes grows."""
    if factor == 1.0:
        return model
    light, detector = model.light, model.detector
    return replace(
        model,
        light=replace(
            light,
            fibre_e=light.fibre_e * factor,
            fiducial_e=light.fiducial_e * factor,
            background_e=light.background_e * factor,
            gradient_e=light.gradient_e * factor,
        ),
        detector=replace(detector, cosmic_rays=detector.cosmic_rays * factor),
        exposure_s=model.exposure_s * factor,
    )
