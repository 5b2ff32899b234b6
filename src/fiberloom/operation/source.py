"""Where the hardware of a field comes from: what a twin and a real array both offer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol

from fiberloom.bus.spec import BusSpec
from fiberloom.bus.transport import Frame, Transport
from fiberloom.calibration.transmission.sweep import Calibration, Progress
from fiberloom.errors import InputError
from fiberloom.hardware import Hardware
from fiberloom.instruments import FocalPlane
from fiberloom.metrology import Camera


class Source(Protocol):
    """Positioners and a camera, to be had for as long as something moves."""

    async def open(self) -> Hardware:
        """The bus and the camera; `FieldMotion.close` lets go of the bus."""
        ...

    async def sweep(self, points: int, progress: Progress) -> Calibration:
        """Sweeps every positioner on a bench; an InputError says how it is done where this cannot."""
        ...

    def maps_file(self, points: int) -> Path | None:
        """Where maps of such a sweep are kept, there or not yet; None: nowhere."""
        ...

    def about(self) -> dict[str, Any]:
        """What summary.json tells of it."""
        ...

    @property
    def true_plane(self) -> FocalPlane | None:
        """The layout as it really is; a twin only."""
        ...


class _LeftOpen:
    """A transport of the caller, who closes it."""

    def __init__(self, transport: Transport) -> None:
        self._transport = transport

    @property
    def time_s(self) -> float:
        return self._transport.time_s

    async def send(self, frames: Sequence[tuple[int, bytes] | Frame]) -> None:
        await self._transport.send(frames)

    async def receive(self, timeout_s: float) -> list[Frame]:
        return await self._transport.receive(timeout_s)

    async def close(self) -> None:
        pass


@dataclass(frozen=True)
class OpenedArray:
    """Positioners on a bus and a camera that looks at them. Implements `Source`."""

    bus: BusSpec | Transport
    camera: Camera

    @classmethod
    def of(cls, bus: str | Transport, camera: Any) -> OpenedArray:
        """Checks what was given; the bus is opened when something moves."""
        if isinstance(camera, str) or not callable(getattr(camera, "measure", None)):
            raise InputError(
                f"camera {camera!r}: cannot be opened by its address; give an object with "
                "measure(expected_mm) -> Measurement, e.g. fiberloom.metrology.pipeline.ImageCamera over "
                "your exposures"
            )
        return cls(BusSpec.parse(bus) if isinstance(bus, str) else bus, camera)

    async def open(self) -> Hardware:
        """Opens the bus anew, unless the caller gave one that is open."""
        bus = await self.bus.open() if isinstance(self.bus, BusSpec) else _LeftOpen(self.bus)
        return Hardware(bus, self.camera)

    async def sweep(self, points: int, progress: Progress) -> Calibration:
        """Arms among neighbours cannot be swept; says what to do instead."""
        raise InputError(
            "an opened field needs calibration=FILE, its transmission maps: sweep the units on a bench with "
            "fiberloom.calibration.calibrate_transmission(client, camera, plane), then .maps.save(FILE)"
        )

    def maps_file(self, points: int) -> Path | None:
        """None: maps come from a file that the caller names."""
        return None

    def about(self) -> dict[str, Any]:
        """Nothing was put in."""
        return {}

    @property
    def true_plane(self) -> FocalPlane | None:
        """Not known."""
        return None
