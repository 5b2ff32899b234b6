"""Checks that ask the array: gateways, numbers against the layout, firmware, camera, light. Nothing moves."""

from __future__ import annotations

import asyncio
import time
from collections import Counter
from typing import Any

import numpy as np

from fiberloom.bus.client import Client
from fiberloom.bus.protocol import Status
from fiberloom.bus.spec import CANNET, BusSpec
from fiberloom.errors import InputError
from fiberloom.hardware import Hardware
from fiberloom.instruments import FocalPlane
from fiberloom.metrology import Measurement
from fiberloom.metrology.acquisition import AcquisitionError
from fiberloom.metrology.sources.errors import CameraError, ImageStale
from fiberloom.metrology.spots import Flag
from fiberloom.operation.session.doctor.findings import DoctorFinding, DoctorLimits, note, numbers, ok, wrong
from fiberloom.typing import Flags, Floats

FEW = 0.5
"""A share of the layout below which it is the wrong layout, or the light is off."""

SATURATED = 0.02
"""Share of the fibres that may be saturated."""

_BROKEN = Status.COLLISION | Status.ESTIMATED_POSITION


async def check_gateways(bus: str) -> list[DoctorFinding]:
    """Whether each gateway can be reached, and is free. Other buses are only known once they are open."""
    spec = BusSpec.parse(bus)
    if spec.interface != CANNET:
        return []
    return list(await asyncio.gather(*(_check_gateway(channel) for channel in spec.channels)))


async def _check_gateway(channel: str) -> DoctorFinding:
    from fiberloom.bus.cannet import CanNetTransport

    try:
        transport = await CanNetTransport.open([channel], timeout_s=3.0)
    except InputError as error:
        refused = "no connection" in str(error)
        trouble = "no gateway" if refused else "gateway in use"
        advice = "" if refused else "; it takes one client at a time: is another program connected?"
        return wrong("gateway", trouble, f"{error}{advice}")
    await transport.close()
    return ok("gateway", f"{channel} answers")


class ArrayCheck:
    """Asks one array that is open."""

    def __init__(self, plane: FocalPlane, hardware: Hardware, limits: DoctorLimits) -> None:
        """`plane`: the layout; `hardware`: open; `limits`: from where on something is wrong."""
        self.plane, self.hardware, self.limits = plane, hardware, limits
        self.client = Client(hardware.bus)
        self.wire_deg = np.zeros((len(plane), 2))
        self.answered = np.zeros(len(plane), dtype=bool)
        self.image: Measurement | None = None

    async def bus(self) -> list[DoctorFinding]:
        """Numbers against the layout, firmware, what positioners say of themselves."""
        found = await self.client.discover()
        findings = [self._numbers(set(found))]
        there = np.isin(self.plane.positioner_id, found)
        if there.any():
            ids = self.plane.positioner_id[there]
            self.wire_deg[there], self.answered[there] = await self.client.positions_deg(ids)
            findings += [self._versions(await self.client.firmware_versions(ids)), await self._flags()]
        return findings

    def _numbers(self, found: set[int]) -> DoctorFinding:
        known = set(self.plane.positioner_id[~self.plane.offline].tolist())
        missing, strange = sorted(known - found), sorted(found - set(self.plane.positioner_id.tolist()))
        if not found:
            return wrong("positioners", "none answers", "no positioner answers: check their power")
        if strange or len(missing) > FEW * len(known):
            text = f"{len(found & known)} of {len(known)} of the layout answer"
            text += f"; not in the layout: {numbers(strange)}" if strange else ""
            text += f"; missing: {numbers(missing)}" if missing else ""
            return wrong(
                "positioners", "wrong layout", f"{text}: check --layout, --instrument, --positioners"
            )
        if missing:
            text = f"no answer from {numbers(missing)}: power, cable, or exclude them"
            return wrong("positioners", "silent positioners", text)
        return ok("positioners", f"all {len(known)} of the layout answer")

    def _versions(self, versions: dict[int, str]) -> DoctorFinding:
        counts = Counter(versions.values())
        if len(counts) > 1:
            usual = counts.most_common(1)[0][0]
            other = sorted(i for i, v in versions.items() if v != usual)
            text = f"{usual}, but not {numbers(other)} ({', '.join(sorted(set(counts) - {usual}))})"
            return note("firmware", "versions differ", text)
        return ok("firmware", ", ".join(counts) or "not told")

    async def _flags(self) -> DoctorFinding:
        answers = await self.client.status(self.plane.positioner_id[self.answered])
        bits = {i: a.values[0] for i, a in answers.items() if a.ok}
        collided = sorted(i for i, b in bits.items() if b & Status.COLLISION)
        lost = sorted(
            i
            for i, b in bits.items()
            if b & Status.ESTIMATED_POSITION or b & Status.DATUMS_INITIALIZED != Status.DATUMS_INITIALIZED
        )
        forgetful = sorted(i for i, b in bits.items() if b & Status.STORAGE_FAILED)
        if forgetful:
            text = f"cannot keep their positions, and may refuse to move: {numbers(forgetful)}; exclude them"
            return wrong("flags", "storage failed", text)
        if collided:
            return wrong("flags", "collided", f"report a collision: {numbers(collided)}; `fiberloom recover`")
        if lost:
            text = f"have lost their datum: {numbers(lost)}; `fiberloom home`"
            return note("flags", "datum lost", text)
        return ok("flags", "no collision, datums set")

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

    def misses_mm(self, reported_mm: Floats) -> Floats:
        """(n,) of the fibres that are seen: how far from where their positioners report, mm."""
        if self.image is None:
            return np.empty(0)
        rows: Flags = self.image.seen & self.answered
        off: Floats = np.hypot(*(self.image.xy_mm - reported_mm)[rows].T)
        return off
