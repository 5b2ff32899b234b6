"""Checks that ask the array: gateways, numbers against the layout, firmware. Nothing moves."""

from __future__ import annotations

import asyncio
from collections import Counter

import numpy as np

from fiberloom.bus.client import Client
from fiberloom.bus.protocol import Status
from fiberloom.bus.spec import CANNET, BusSpec
from fiberloom.errors import InputError
from fiberloom.hardware import Hardware
from fiberloom.instruments import FocalPlane
from fiberloom.operation.session.doctor.findings import DoctorFinding, DoctorLimits, note, numbers, ok, wrong
from fiberloom.operation.session.doctor.one_exposure import FEW, ImageCheck
from fiberloom.typing import Flags, Floats

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


def check_numbers(plane: FocalPlane, found: set[int]) -> DoctorFinding:
    """The numbers that were `found` to answer against those of the layout `plane`."""
    known = set(plane.positioner_id[~plane.offline].tolist())
    missing, strange = sorted(known - found), sorted(found - set(plane.positioner_id.tolist()))
    if not found:
        return wrong("positioners", "none answers", "no positioner answers: check their power")
    if strange or len(missing) > FEW * len(known):
        text = f"{len(found & known)} of {len(known)} of the layout answer"
        text += f"; not in the layout: {numbers(strange)}" if strange else ""
        text += f"; missing: {numbers(missing)}" if missing else ""
        return wrong("positioners", "wrong layout", f"{text}: check --layout, --instrument, --positioners")
    if missing:
        text = f"no answer from {numbers(missing)}: power, cable, or exclude them"
        return wrong("positioners", "silent positioners", text)
    return ok("positioners", f"all {len(known)} of the layout answer")


class ArrayCheck(ImageCheck):
    """Asks one array that is open."""

    def __init__(self, plane: FocalPlane, hardware: Hardware, limits: DoctorLimits) -> None:
        """`plane`: the layout; `hardware`: open; `limits`: from where on something is wrong."""
        super().__init__(plane, hardware, limits)
        self.client = Client(hardware.bus)
        self.wire_deg = np.zeros((len(plane), 2))
        self.answered = np.zeros(len(plane), dtype=bool)

    async def bus(self) -> list[DoctorFinding]:
        """Numbers against the layout, firmware, what positioners say of themselves."""
        found = await self.client.discover()
        findings = [check_numbers(self.plane, set(found))]
        there = np.isin(self.plane.positioner_id, found)
        if there.any():
            ids = self.plane.positioner_id[there]
            self.wire_deg[there], self.answered[there] = await self.client.positions_deg(ids)
            findings += [self._versions(await self.client.firmware_versions(ids)), await self._flags()]
        return findings

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

    def misses_mm(self, reported_mm: Floats) -> Floats:
        """(n,) of the fibres that are seen: how far from where their positioners report, mm."""
        if self.image is None:
            return np.empty(0)
        rows: Flags = self.image.seen & self.answered
        off: Floats = np.hypot(*(self.image.xy_mm - reported_mm)[rows].T)
        return off
