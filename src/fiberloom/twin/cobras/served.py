"""A served twin of PFS: its boards on a TCP port, and what a camera sees of its cobras."""

from __future__ import annotations

from collections import Counter
from typing import Any

import numpy as np

from fiberloom.twin.cobras.array import CobraArray
from fiberloom.twin.cobras.server import BoardServer
from fiberloom.twin.server.address import Address
from fiberloom.twin.server.camera.exposing import Look


class ServedCobras:
    """Cobras behind one FPGA. Implements `Watched`: a camera may look at them."""

    def __init__(self, array: CobraArray, address: Address, speed: float = 1.0) -> None:
        """`array` of cobras; `address` of the FPGA; `speed`: seconds of its clock in one of ours."""
        self._array, self._address = array, address
        self._boards = BoardServer(array, speed=speed)

    async def open(self) -> None:
        """Listens. InputError where the address is taken."""
        await self._boards.listen(self._address.host, self._address.port)

    def close(self) -> None:
        """Cuts the connection and listens no more."""
        self._boards.shut()

    def report(self) -> dict[str, Any]:
        """What happened so far."""
        contacts = Counter("fiducials" if c.other is None else "cobras" for c in self._array.touched)
        return {
            "time_s": self._boards.now_s(),
            "runs": self._boards.boards.runs,
            "contacts": {kind: contacts[kind] for kind in ("cobras", "fiducials")},
        }

    def told(self, report: dict[str, Any]) -> str:
        """A `report` of this server as a line of text."""
        contacts = report["contacts"]
        return (
            f"{report['time_s']:.1f} s of twin time: {report['runs']} RUNs; arms touched "
            f"{contacts['cobras']} times each other and {contacts['fiducials']} times a fiducial"
        )

    def look(self) -> Look:
        """What a camera sees now: no fibre that is behind its dot."""
        lit_mm = np.where(self._array.dark[:, None], np.nan, self._array.fibre_xy())
        return Look(self._boards.now_s(), lit_mm)

    def faults(self) -> frozenset[str]:
        """Of the camera: none."""
        return frozenset()
