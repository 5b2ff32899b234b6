"""Arrays of steppers outside of this process: MOONS' gateways, MEGARA's buses, LAMOST's coordinators."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

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
    read: Callable[[str], Any] = staticmethod(BusSpec.parse)
    """What an address says. Raises InputError for one that says nothing."""

    def __init__(
        self,
        plane: FocalPlane,
        bus: str | Transport,
        camera: Camera,
        camera_name: str = "",
        speed: float = 1.0,
    ) -> None:
        """`plane` of the units; `bus`: its address without `at`, or of CAN frames the open bus, which stays
        open; `camera`, and its address; `speed`: seconds of the units in one of ours.
        """
        self.plane, self.camera, self.camera_name, self._speed = plane, camera, camera_name, speed
        self.address = bus if isinstance(bus, str) else "opened"
        self._bus: Any = self.read(bus) if isinstance(bus, str) else bus
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
        return self.driven_by(drive, len(self.plane))

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
    read = staticmethod(gateway_address)

    async def _link(self) -> StepperLink:
        host, port = self._bus
        gateways = TcpGateways(host, port, self._speed)
        await gateways.open()
        return MoonsLink(gateways)

    def _maker(self) -> Maker:
        return WaveformMaker.of(self.plane.instrument, TRIAL_DEG)


class OpenedLamost(OpenedSteppers):
    """Units of LAMOST over the air. `address`: HOST or HOST:PORT of what speaks to the coordinators."""

    at = "radio://"
    read = staticmethod(radio_address)

    async def _link(self) -> StepperLink:
        host, port = self._bus
        radio = TcpRadio(host, port, self._speed)
        await radio.open()
        return MegaraLink(RadioTransport(radio))


class OpenedMegara(OpenedSteppers):
    """Robots of MEGARA on a bus of CAN frames, by its address as `BusSpec` reads it, or opened before."""

    async def _link(self) -> StepperLink:
        spec = self._bus
        bus = await spec.open(whose=robot_of) if isinstance(spec, BusSpec) else LeftOpen(spec)
        return MegaraLink(bus if self._speed == 1.0 else FasterBus(bus, self._speed))


class FasterBus(LeftOpen):
    """A bus of a twin whose clock runs faster than ours, closed with it."""

    def __init__(self, bus: Transport, speed: float) -> None:
        """`speed`: seconds of the twin in one of ours."""
        super().__init__(bus)
        self._speed = speed

    @property
    def time_s(self) -> float:
        """Of the twin."""
        return self._transport.time_s * self._speed

    async def receive(self, timeout_s: float) -> list[Frame]:
        """Waits for frames, `timeout_s` of the twin at most."""
        return await self._transport.receive(timeout_s / self._speed)

    async def close(self) -> None:
        """Closes the bus."""
        await self._transport.close()


STEPPERS: dict[str, type[OpenedSteppers]] = {
    "lamost": OpenedLamost,
    "megara": OpenedMegara,
    "moons": OpenedMoons,
}
"""Arrays of steppers by their protocol."""
