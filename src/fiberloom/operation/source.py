"""Sources of the hardware of a field: the protocol of a twin and of a real array."""

from __future__ import annotations

import copy
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Protocol, Self, cast, runtime_checkable

import numpy as np

from fiberloom.bus.links import Link, links_of
from fiberloom.bus.spec import BusSpec
from fiberloom.bus.transport import Frame, Transport
from fiberloom.calibration.transmission.sweep import Calibration, Progress
from fiberloom.drive.port import Drive
from fiberloom.errors import InputError
from fiberloom.hardware import Guider, Hardware
from fiberloom.instruments import FocalPlane
from fiberloom.metrology import Camera
from fiberloom.typing import Floats

FPGA = "fpga://"
"""Before the address of the boards of PFS."""


class Source(Protocol):
    """Opens positioners and a camera for the time of a motion."""

    async def open(self) -> Hardware:
        """Opens the bus and the camera; `FieldMotion.close` closes the bus."""
        ...

    async def sweep(self, points: int, progress: Progress) -> Calibration | None:
        """Sweeps every positioner on a bench: transmission maps and their report.

        `points`: per axis and direction; `progress`: called with the points done and all. None: there is
        no bench, the positioners are to be swept where they are.
        """
        ...

    def maps_file(self, points: int) -> Path | None:
        """File in which the maps of such a sweep are kept, whether or not it exists; None: not kept."""
        ...

    def know(self, file: Path) -> None:
        """Takes what the `file` of a calibration says of motors that have no transmission maps."""
        ...

    def keep(self, file: Path | None) -> None:
        """Keeps in a `file` what motors that have no transmission maps teach; None: in one of its own.

        InputError where such motors teach nothing that can be kept.
        """
        ...

    def about(self) -> dict[str, Any]:
        """Entries of summary.json about the source."""
        ...

    @property
    def true_plane(self) -> FocalPlane | None:
        """The true layout; None for a real array."""
        ...


@runtime_checkable
class Doubting(Protocol):
    """A `Source` that calibrates its motors before a field, and so knows some that will not arrive."""

    async def doubtful(self, moves: int | None = None) -> dict[int, str]:
        """By number why positioners cannot be counted on. Calibrates where that was not done.

        `moves` of the field, the blind one too; None: those of the instrument.
        """
        ...

    def standing_deg(self) -> Floats:
        """(N, 2) alpha and beta in deg where positioners stand after that."""
        ...

    def scatter(self) -> Floats | None:
        """(N, 2), dimensionless: rms by which moves of both motors miss, of their way, as calibrated; NaN, or
        None: not known."""
        ...


class LeftOpen:
    """A transport that another one has opened and closes. Implements `Transport`."""

    def __init__(self, transport: Transport) -> None:
        self._transport = transport

    @property
    def time_s(self) -> float:
        """Of the bus."""
        return self._transport.time_s

    @property
    def links(self) -> Sequence[Link]:
        """Its connections."""
        return links_of(self._transport)

    def link_of(self, positioner: int) -> Link | None:
        """The connection to a positioner, where it is known."""
        find = getattr(self._transport, "link_of", None)
        return None if find is None else cast("Link | None", find(positioner))

    def line_of(self, positioner: int) -> str:
        """The port at which a positioner hangs, in words; "": not known."""
        find = getattr(self._transport, "line_of", None)
        return "" if find is None else str(find(positioner))

    async def send(self, frames: Sequence[tuple[int, bytes] | Frame]) -> None:
        """Sends frames."""
        await self._transport.send(frames)

    async def receive(self, timeout_s: float) -> list[Frame]:
        """Waits for frames, `timeout_s` s at most."""
        return await self._transport.receive(timeout_s)

    async def close(self) -> None:
        """Nothing: it stays open."""


class OutsideArray:
    """What arrays outside of this process have in common: no bench, no file of their own, no known truth."""

    camera: Camera
    camera_name: str
    """Its address, where it has one."""
    guider: Guider | None = None
    """What looks at guide stars; set by `guided_by`."""

    def guided_by(self, guider: Guider) -> Self:
        """The same array on a telescope whose guide cameras are asked by `guider`."""
        made = copy.copy(self)
        object.__setattr__(made, "guider", guider)  # of frozen ones too
        return made

    @property
    def bus_name(self) -> str:
        """The address of the bus, in words."""
        raise NotImplementedError

    def named(self) -> dict[str, str]:
        """Bus and camera in words: equal for two commands to one array."""
        return {"bus": self.bus_name, "camera": self.camera_name or type(self.camera).__name__}

    def driven_by(self, drive: Drive, n: int) -> Hardware:
        """Its `n` positioners, moved by a `drive` of their own kind, and believed to be where that says."""
        return Hardware(None, self.camera, vouched=np.ones(n, dtype=bool), drive=drive, guider=self.guider)

    async def sweep(self, points: int, progress: Progress) -> None:
        """None: an array has no bench."""

    def maps_file(self, points: int) -> Path | None:
        """None: maps come from a file that the caller names."""
        return None

    def about(self) -> dict[str, Any]:
        """Empty: only a twin has entries of its own."""
        return {}

    @property
    def true_plane(self) -> FocalPlane | None:
        """None: the true layout is not known."""
        return None


class CanArray(OutsideArray):
    """Positioners on a bus of CAN frames, given by its address or opened."""

    bus: BusSpec | Transport

    @property
    def bus_name(self) -> str:
        """Kind and channels of the bus; "opened" where it was opened before."""
        spec = self.bus if isinstance(self.bus, BusSpec) else None
        return "opened" if spec is None else f"{spec.interface}:{','.join(spec.channels)}"

    async def opened_bus(self, **how: Callable[[int], int]) -> Transport:
        """The bus, opened unless the caller has opened it; `how`: as `BusSpec.open` takes it."""
        return await self.bus.open(**how) if isinstance(self.bus, BusSpec) else LeftOpen(self.bus)


@dataclass(frozen=True)
class OpenedArray(CanArray):
    """Positioners on a bus and a camera that looks at them. Implements `Source`."""

    bus: BusSpec | Transport
    camera: Camera
    camera_name: str = ""

    @classmethod
    def of(cls, bus: str | Transport, camera: Any, camera_name: str = "") -> OpenedArray:
        """An array on a bus, given by its address or opened, with a camera, which is an object.

        The bus is opened when something moves; `camera_name`: the camera's address. Raises InputError
        where the address cannot be read or the camera has no `measure`.
        """
        if isinstance(camera, str) or not callable(getattr(camera, "measure", None)):
            raise InputError(
                f"camera {camera!r}: cannot be opened by its address; give an object with "
                "measure(expected_mm) -> Measurement, e.g. fiberloom.metrology.pipeline.ImageCamera over "
                "your exposures"
            )
        return cls(BusSpec.parse(bus) if isinstance(bus, str) else bus, camera, camera_name)

    async def open(self) -> Hardware:
        """Opens the bus, unless the caller has opened it."""
        return Hardware(await self.opened_bus(), self.camera, guider=self.guider)

    def know(self, file: Path) -> None:
        """No array outside has such motors yet: InputError for any `file`."""
        raise InputError(f"{file}: this array has transmission maps, or none at all")

    def keep(self, file: Path | None) -> None:
        """No array outside has such motors yet: InputError."""
        raise InputError("--adapt: the motors of this array teach nothing that can be kept; leave it out")
