"""`fiberloom doctor`: everything that can be looked at without moving anything."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from fiberloom.drive.port import Drive
from fiberloom.errors import InputError
from fiberloom.operation.session.doctor.array import ArrayCheck, check_gateways
from fiberloom.operation.session.doctor.by_drive import DriveCheck
from fiberloom.operation.session.doctor.findings import DoctorFinding, DoctorLimits, Verdict, wrong
from fiberloom.operation.session.doctor.here import (
    check_calibration,
    check_clock,
    check_disk,
    check_exclusions,
    check_misses,
    check_owner,
)
from fiberloom.operation.session.session import KnownArray

USUAL_MM = 0.03
"""Half of the fibres are seen nearer to where the motors say, with maps and arms of these units."""

FAR_MM = 1.0
"""If half of the fibres are farther off, it is another layout."""


@dataclass(frozen=True)
class Doctor:
    """Looks at one array."""

    known: KnownArray
    bus: str
    """Its address."""
    limits: DoctorLimits
    progress: Callable[[str], None] = lambda _: None

    async def look(self) -> list[DoctorFinding]:
        """All findings, in the order in which they are best put right."""
        known, book = self.known, self.known.book
        findings = [
            check_disk(book.store.name, self.limits),
            check_clock(book, self.limits),
            owner := check_owner(book),
            check_exclusions(book, known.plane),
        ]
        if known.plane.instrument.drive.by_maps:
            findings.append(check_calibration(known.plane, known.maps, self.limits))
        if owner.trouble == "gateway in use":
            return findings  # the array is not asked: that would disturb its owner
        self.progress("asking the gateways")
        twin = self.bus.startswith("twin:")
        gateways = [] if twin else await check_gateways(self.bus)
        findings += gateways
        if any(g.verdict is Verdict.WRONG for g in gateways):
            return findings
        return findings + await self._of_array()

    async def _of_array(self) -> list[DoctorFinding]:
        plane = self.known.plane
        try:
            hardware = await self.known.source.open()
        except InputError as error:
            return [wrong("bus", "no bus", str(error))]
        if hardware.drive is not None:
            return await self._of_drive(DriveCheck(plane, hardware, self.limits), hardware.drive)
        check = ArrayCheck(plane, hardware, self.limits)
        try:
            self.progress("asking the positioners")
            findings = await check.bus()
            self.progress("taking an image")
            output_deg = self.known.maps.to_output(check.wire_deg)
            reported_mm = plane.forward(*output_deg.T)
            findings += await check.camera(np.where(check.answered[:, None], reported_mm, np.nan))
        finally:
            await check.client.close()
        return findings + self._compare(check.misses_mm(reported_mm))

    async def _of_drive(self, check: DriveCheck, drive: Drive) -> list[DoctorFinding]:
        try:
            self.progress("asking the positioners")
            findings = await check.bus()
            self.progress("taking an image")
            return findings + await check.look()
        finally:
            await drive.close()

    def _compare(self, miss_mm: np.ndarray) -> list[DoctorFinding]:
        if len(miss_mm) >= 3 and np.median(miss_mm) > FAR_MM:
            text = f"half of the fibres are seen more than {np.median(miss_mm):.1f} mm from where they report"
            return [wrong("layout", "wrong layout", f"{text}: check --layout, --instrument, --positioners")]
        return [check_misses(self.known.maps, miss_mm, USUAL_MM)]
