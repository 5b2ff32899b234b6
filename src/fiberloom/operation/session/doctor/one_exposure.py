"""Checks of one image of an array: does it come, is it fresh, is there light. Nothing moves."""

from __future__ import annotations

import asyncio
import time
from typing import Any

import numpy as np

from fiberloom.hardware import Hardware
from fiberloom.instruments import FocalPlane
from fiberloom.metrology import Measurement
from fiberloom.metrology.acquisition import AcquisitionError
from fiberloom.metrology.sources.errors import CameraError, ImageStale
from fiberloom.metrology.spots import Flag
from fiberloom.operation.session.doctor.findings import DoctorFinding, DoctorLimits, note, numbers, ok, wrong
from fiberloom.typing import Floats

FEW = 0.5
"""A share of the layout below which it is the wrong layout, or the light is off."""

SATURATED = 0.02
"""Share of the fibres that may be saturated."""


class ImageCheck:
    """Looks at one array that is open."""

    def __init__(self, plane: FocalPlane, hardware: Hardware, limits: DoctorLimits) -> None:
        """`plane`: the layout; `hardware`: open; `limits`: from where on something is wrong."""
        self.plane, self.hardware, self.limits = plane, hardware, limits
        self.image: Measurement | None = None

    async def camera(self, expected_mm: Floats) -> list[DoctorFinding]:
        """One image: does it come, is it fresh, is there light, is it saturated."""
        asked_s = time.time()
        try:
            self.image = await asyncio.to_thread(self.hardware.camera.measure, expected_mm)
        except ImageStale as error:
            future = "future" in str(error) or "before it was asked" in str(error)
            return [wrong("camera", "clock off" if future else "old image", str(error))]
        except CameraError as error:
            return [wrong("camera", "no camera", str(error))]
        except AcquisitionError as error:
            text = f"{error}; is the light on, and is the shutter open?"
            return [*self._exposure(asked_s), wrong("light", "dark field", text)]
        return [*self._exposure(asked_s), self._light(self.image)]

    def _light(self, image: Measurement) -> DoctorFinding:
        wanted = ~self.plane.offline
        seen = int((image.seen & wanted).sum())
        text = f"{seen} of {int(wanted.sum())} fibres are seen"
        if seen < FEW * wanted.sum():
            return wrong("light", "dark field", f"{text}: switch the back-illumination on")
        dark = self.plane.positioner_id[wanted & ~image.seen].tolist()
        return note("light", "dark fibres", f"{text}; not {numbers(dark)}") if dark else ok("light", text)

    def _exposure(self, asked_s: float) -> list[DoctorFinding]:
        """Of an image that was kept: its clock, and its brightest pixels."""
        reduction: Any = getattr(self.hardware.camera, "last", None)
        if reduction is None:
            return [ok("camera", "answers")]
        image = reduction.image
        begun = image.begun_utc_s
        findings = [ok("camera", f"{image.shape[1]} x {image.shape[0]} px, {image.exposure_s:g} s")]
        if begun is not None and abs(begun - asked_s) > self.limits.clock_s + image.exposure_s:
            text = f"the camera's clock is {begun - asked_s:+.1f} s off this machine's: set both (NTP)"
            findings.append(wrong("clock", "clock off", text))
        return [*findings, self._saturation(reduction)]

    def _saturation(self, reduction: Any) -> DoctorFinding:
        image = reduction.image
        top = float(np.max(image.array()))
        saturated = reduction.spots.flags & Flag.SATURATED != 0
        share = float(np.mean(saturated)) if len(saturated) else 0.0
        if not np.isfinite(image.saturation_adu) or top < image.saturation_adu:
            return ok("exposure", f"brightest pixel {top:.0f} units")
        if share > SATURATED:
            text = f"{100 * share:.0f} % of the spots are saturated: expose shorter, or dim the light"
            return wrong("exposure", "saturated image", text)
        return ok("exposure", f"brightest pixel {top:.0f} units, {100 * share:.1f} % of the spots saturated")
