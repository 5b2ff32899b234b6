"""Checks of positioners that have commands of their own, by their drive. Nothing moves."""

from __future__ import annotations

import numpy as np

from fiberloom.drive.port import LooksOnly, UnitSays
from fiberloom.metrology.camera import NoCamera
from fiberloom.operation.session.doctor.array import check_numbers
from fiberloom.operation.session.doctor.findings import DoctorFinding, note, numbers, ok, wrong
from fiberloom.operation.session.doctor.one_exposure import ImageCheck


class DriveCheck(ImageCheck):
    """Asks the positioners behind a drive of their own."""

    async def bus(self) -> list[DoctorFinding]:
        """Numbers against the layout, and what positioners say of themselves."""
        drive = self.hardware.drive
        if not isinstance(drive, LooksOnly):
            text = (
                "connected, but these cannot be asked without being moved: nothing of them is checked; "
                "`fiberloom observe` begins with what they can tell"
            )
            return [wrong("positioners", "not checked", text)]
        told = await drive.look()
        findings = [check_numbers(self.plane, set(told))]
        return [*findings, *self._of_units(told)] if told else findings

    def _of_units(self, told: dict[int, UnitSays]) -> list[DoctorFinding]:
        wrongs = [f"{number}: {says.trouble}" for number, says in sorted(told.items()) if says.trouble]
        findings = (
            [wrong("units", "unfit", f"{len(wrongs)} must not move: {'; '.join(wrongs[:8])}")]
            if wrongs
            else []
        )
        moving = sorted(number for number, says in told.items() if says.moving)
        if moving:
            findings.append(wrong("motion", "moving", f"still moving: {numbers(moving)}; `fiberloom stop`"))
        known = [says.datum for says in told.values() if says.datum is not None]
        if not known:
            text = "they never say whether they know their places: an image tells, or `fiberloom home`"
            return [*findings, note("flags", "datum not told", text)]
        lost = sorted(number for number, says in told.items() if says.datum is False)
        if lost:
            text = f"have no datum: {numbers(lost)}; `fiberloom home`, and `observe` searches it first"
            return [*findings, note("flags", "datum lost", text)]
        return [*findings, ok("flags", "datums set")]

    async def look(self) -> list[DoctorFinding]:
        """One image, where a camera looks. Fibres are expected nowhere: no place is known for certain."""
        if isinstance(self.hardware.camera, NoCamera):
            return [note("camera", "no camera", "none looks: where fibres are is not checked")]
        return await self.camera(np.full((len(self.plane), 2), np.nan))
