"""A GenICam camera (GigE Vision, USB3 Vision) by Aravis, whose Python door is the system's `gi`."""

from __future__ import annotations

import importlib
import time
from contextlib import suppress
from typing import Any

import numpy as np

from fiberloom.metrology.images import CameraImage
from fiberloom.metrology.sources.deadline import Deadline
from fiberloom.metrology.sources.errors import CameraError, CameraRefused, CameraSilent, ImageBroken
from fiberloom.metrology.sources.remote import ExposureSettings, RemoteSource
from fiberloom.typing import Array

VERSION = "0.8"
_POP_US = 50_000
"""How often it is looked whether the exposure is given up, in us."""
_FORMATS = (("Mono16", np.uint16, 65535.0), ("Mono12", np.uint16, 4095.0), ("Mono8", np.uint8, 255.0))
"""In order of preference: name, type of a pixel, largest number."""
_BUFFERS = 2
_US_PER_S = 1e6


def aravis_module() -> Any:
    """Aravis by its introspection. Raises CameraRefused where the system lacks it."""
    try:
        importlib.import_module("gi").require_version("Aravis", VERSION)
        return importlib.import_module("gi.repository.Aravis")
    except (ImportError, ValueError) as error:
        raise CameraRefused(f"aravis: {error}; apt-get install python3-gi gir1.2-aravis-0.8") from None


class AravisSource(RemoteSource):
    """The camera of this `name` (serial number, address, or `Fake_1`); see `RemoteSource`."""

    def __init__(self, name: str, settings: ExposureSettings) -> None:
        super().__init__(f"aravis:{name}", settings)
        self.device = name
        self._camera: Any = None
        self._pixel: tuple[Any, float] = (np.uint16, 65535.0)

    def close(self) -> None:
        """Gives up what is running and lets go of the camera."""
        super().close()
        self._camera = None

    def _take(self, deadline: Deadline) -> CameraImage:
        aravis = aravis_module()
        deadline.doing = "connecting"
        try:
            self._camera = self._camera or self._opened(aravis)
            return self._exposed(aravis, deadline)
        except CameraError:
            self._camera = None
            raise
        except Exception as error:  # GLib.Error, which this file cannot name
            self._camera = None
            deadline.check()
            raise CameraRefused(f"{self.name}: {error}; is it switched on, and free?") from None

    def _opened(self, aravis: Any) -> Any:
        if self.device.startswith("Fake"):
            aravis.enable_interface("Fake")
        camera = aravis.Camera.new(self.device)
        if camera is None:
            raise CameraSilent(f"{self.name}: no such camera; arv-tool lists those that answer")
        there = set(camera.dup_available_pixel_formats_as_strings())
        found = next((form for form in _FORMATS if form[0] in there), None)
        if found is None:
            raise CameraRefused(f"{self.name}: has {', '.join(sorted(there))}; an image in grey is needed")
        camera.set_pixel_format_from_string(found[0])
        self._pixel = found[1:]
        with suppress(Exception):  # not every camera has regions
            _, width = camera.get_width_bounds()
            _, height = camera.get_height_bounds()
            camera.set_region(0, 0, width, height)
        return camera

    def _exposed(self, aravis: Any, deadline: Deadline) -> CameraImage:
        camera = self._camera
        camera.set_acquisition_mode(aravis.AcquisitionMode.SINGLE_FRAME)
        camera.set_exposure_time(self.settings.exposure_s * _US_PER_S)
        stream = camera.create_stream(None, None)
        for _ in range(_BUFFERS):
            stream.push_buffer(aravis.Buffer.new_allocate(camera.get_payload()))
        deadline.doing = "exposing"
        started_utc_s = time.time()
        camera.start_acquisition()
        try:
            while (buffer := stream.timeout_pop_buffer(_POP_US)) is None:
                deadline.check()
        finally:
            with suppress(Exception):
                camera.stop_acquisition()
        if buffer.get_status() != aravis.BufferStatus.SUCCESS:
            raise ImageBroken(
                f"{self.name}: {buffer.get_status().value_nick}: packets lost; take another one"
            )
        exposure_s = camera.get_exposure_time() / _US_PER_S
        arrived_utc_s = buffer.get_system_timestamp() * 1e-9
        # a single frame begins when the acquisition does; one that came before that is an old one
        begun = started_utc_s if arrived_utc_s >= started_utc_s else arrived_utc_s - exposure_s
        return CameraImage(
            self._pixels(buffer),
            saturation_adu=self._pixel[1],
            exposure_s=exposure_s,
            time_s=begun,
            begun_utc_s=begun,
            header={"INSTRUME": self.name},
        )

    def _pixels(self, buffer: Any) -> Array:
        width, height = buffer.get_image_width(), buffer.get_image_height()
        data = buffer.get_data()
        kind = np.dtype(self._pixel[0])
        if len(data) < width * height * kind.itemsize:
            raise ImageBroken(f"{self.name}: {len(data)} bytes for {width} x {height} px: cut short")
        flat = np.frombuffer(data, kind, width * height)
        return flat.reshape(height, width).astype(np.uint16)
