"""Arrays of steppers outside of this process: MOONS' gateways, MEGARA's buses, LAMOST's coordinators."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np

from fiberloom.bus.links import Link, links_of
from fiberloom.bus.spec import BusSpec
from fiberloom.bus.transport import Frame, Transport
from fiberloom.drive.lamost import RadioTransport, TcpRadio, radio_address
from fiberloom.drive.megara.frames import robot_of
from fiberloom.drive.megara.link import MegaraLink
from fiberloom.drive.moons import MoonsLink, WaveformMaker
from fiberloom.drive.moons.tcp import TcpGateways, gateway_address
from fiberloom.drive.steppers import KnownUnits, StepperDrive, StepperLink
from fiberloom.drive.steppers.drive import TRIAL_DEG, Maker
from fiberloom.drive.steppers.kept import read_units
from fiberloom.drive.steppers.square import SquareMaker
from fiberloom.errors import InputError
from fiberloom.hardware import Hardware
from fiberloom.instruments import FocalPlane
from fiberloom.metrology import Camera
from fiberloom.metrology.camera import NoCamera
from fiberloom.operation.source import LeftOpen, OutsideArray


class OpenedSteppers(OutsideArray):
    """Units of steppers, and a camera that corrects them, or only scores. Implements `Source`."""

    at = ""
    """Before the address of its bus; "": any bus of CAN frames."""

    def __init__(
        self,
        plane: FocalPlane,
        address: str,
        camera: Camera,
        camera_name: str = "",
        speed: float = 1.0,
    ) -> None:
        """`plane` of the units; `address` of their bus, without `at`; `camera`, and its address; `speed`:
        seconds of theirs in one of ours.
        """
        self.plane, self.camera, self.camera_name, self.address = plane, camera, camera_name, address
        self._speed = speed
        self._known: KnownUnits | None = None

    @property
    def bus_name(self) -> str:
        """The address of the bus."""
        return f"{self.at}{self.address}"

    async def open(self) -> Hardware:
        """Connects. InputError where nothing answers, or nothing is known of the units."""
        if self._known is None:
            raise InputError(
                f"{self.bus_name}: name what a bench has found of its units by --calibration, a file of "
                "'fiberloom calibrate steppers'"
            )
        drive = StepperDrive(self.plane, await self._link(), self._known, self._maker())
        vouched = np.ones(len(self.plane), dtype=bool)
        return Hardware(None, self.camera, vouched=vouched, drive=drive, guider=self.guider)

    async def _link(self) -> StepperLink:
        raise NotImplementedError

    def _maker(self) -> Maker:
        return SquareMaker.of(self.plane.instrument, TRIAL_DEG)

    def about(self) -> dict[str, Any]:
        """That nothing was measured, where no camera looks."""
        if not isinstance(self.camera, NoCamera):
            return {}
        return {"notes": ["no camera looks: where fibres are is not known, and none counts as on target"]}

    def know(self, file: Path) -> None:
        """The units are those of a `file` of `calibrate steppers`. InputError where it is none."""
        self._known = read_units(file, self.plane)

    def keep(self, file: Path | None) -> None:
        """InputError for any `file`: steppers teach nothing that is kept."""
        raise InputError("--adapt: steppers teach nothing that is kept; leave it out")


class OpenedMoons(OpenedSteppers):
    """Units of MOONS behind their gateways on TCP. `address`: HOST or HOST:PORT of the first."""

    at = "gateways://"

    def __init__(
        self, plane: FocalPlane, address: str, camera: Camera, camera_name: str = "", speed: float = 1.0
    ) -> None:
        super().__init__(plane, address, camera, camera_name, speed)
        self._where = gateway_address(address)

    async def _link(self) -> StepperLink:
        gateways = TcpGateways(*self._where, self._speed)
        await gateways.open()
        return MoonsLink(gateways)

    def _maker(self) -> Maker:
        return WaveformMaker.of(self.plane.instrument, TRIAL_DEG)


class OpenedLamost(OpenedSteppers):
    """Units of LAMOST over the air. `address`: HOST or HOST:PORT of what speaks to the coordinators."""

    at = "radio://"

    def __init__(
        self, plane: FocalPlane, address: str, camera: Camera, camera_name: str = "", speed: float = 1.0
    ) -> None:
        super().__init__(plane, address, camera, camera_name, speed)
        self._where = radio_address(address)

    async def _link(self) -> StepperLink:
        radio = TcpRadio(*self._where, self._speed)
        await radio.open()
        return MegaraLink(RadioTransport(radio))


class OpenedMegara(OpenedSteppers):
    """Robots of MEGARA on a bus of CAN frames, by its address or opened before."""

    def __init__(
        self,
        plane: FocalPlane,
        bus: str | Transport,
        camera: Camera,
        camera_name: str = "",
        speed: float = 1.0,
    ) -> None:
        """`bus`: its address as `BusSpec` reads it, or the open bus, which stays open."""
        super().__init__(plane, bus if isinstance(bus, str) else "opened", camera, camera_name, speed)
        self._bus = BusSpec.parse(bus) if isinstance(bus, str) else bus

    async def _link(self) -> StepperLink:
        spec = self._bus
        bus = await spec.open(whose=robot_of) if isinstance(spec, BusSpec) else LeftOpen(spec)
        return MegaraLink(bus if self._speed == 1.0 else FasterBus(bus, self._speed))


class FasterBus:
    """A bus of a twin whose clock runs faster than ours. Implements `Transport`."""

    def __init__(self, bus: Transport, speed: float) -> None:
        """`speed`: seconds of the twin in one of ours."""
        self._bus, self._speed = bus, speed

    @property
    def time_s(self) -> float:
        """Of the twin."""
        return self._bus.time_s * self._speed

    @property
    def links(self) -> Sequence[Link]:
        """Its connections."""
        return links_of(self._bus)

    def link_of(self, positioner: int) -> Link | None:
        """The connection to a positioner, where it is known."""
        find = getattr(self._bus, "link_of", None)
        return None if find is None else cast("Link | None", find(positioner))

    def line_of(self, positioner: int) -> str:
        """The port at which a positioner hangs, in words; "": not known."""
        find = getattr(self._bus, "line_of", None)
        return "" if find is None else str(find(positioner))

    async def send(self, frames: Sequence[tuple[int, bytes] | Frame]) -> None:
        """Sends `frames`."""
        await self._bus.send(frames)

    async def receive(self, timeout_s: float) -> list[Frame]:
        """Waits for frames, `timeout_s` of the twin at most."""
        return await self._bus.receive(timeout_s / self._speed)

    async def close(self) -> None:
        """Closes the bus."""
        await self._bus.close()
