"""Arrays outside of this process whose motors have no transmission maps: DESI's buses, the FPGA of PFS."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from fiberloom.bus.spec import BusSpec
from fiberloom.bus.transport import Transport
from fiberloom.drive.desi.drive import DesiDrive
from fiberloom.drive.desi.frames import positioner_of
from fiberloom.drive.desi.maps.kept import read_maps
from fiberloom.drive.desi.maps.learned import PLANETARY, LearnedMaps
from fiberloom.drive.pfs import CobraDrive, FpgaClient
from fiberloom.drive.pfs.streams import over_tcp, tcp_address
from fiberloom.drive.piezo import MotorMaps, read_summary_maps
from fiberloom.errors import InputError
from fiberloom.hardware import Hardware
from fiberloom.instruments import FocalPlane
from fiberloom.metrology import Camera
from fiberloom.operation.safety.stop import to_its_end
from fiberloom.operation.source import FPGA, CanArray, OutsideArray


@dataclass
class OpenedDesi(CanArray):
    """An array of motors without encoders on a bus of DESI's frames. Implements `Source`."""

    plane: FocalPlane
    bus: BusSpec | Transport
    camera: Camera
    camera_name: str = ""
    known_file: Path | None = None
    """What earlier nights have taught."""
    kept_file: Path | None = None
    """The same, written anew after each image."""

    def know(self, file: Path) -> None:
        """Begins with the maps of a `file`, and believes arms to be where it says."""
        self.known_file = file

    def keep(self, file: Path | None) -> None:
        """As `know` with a `file`, which is written anew after each image. InputError where none is named."""
        if file is None:
            raise InputError(
                "--adapt: name the file in which this array keeps what it learns, by --calibration"
            )
        self.kept_file = file

    async def open(self) -> Hardware:
        """Opens the bus, unless the caller has opened it. Without a file all are taken to be folded."""
        maps = self._maps()
        drive = DesiDrive(self.plane, await self.opened_bus(whose=positioner_of), maps)
        drive.kept = self.kept_file
        return self.driven_by(drive, len(self.plane))

    def _maps(self) -> LearnedMaps | None:
        """As learnt so far; None: nothing, also where a file is to be kept that is not there yet."""
        found = self.kept_file or self.known_file
        if found is None or (found == self.kept_file and not found.exists()):
            return None
        return read_maps(found, self.plane, PLANETARY)


class OpenedCobras(OutsideArray):
    """Cobras of PFS behind an FPGA on TCP, and a camera that looks at them. Implements `Source`."""

    def __init__(self, plane: FocalPlane, address: str, camera: Camera, camera_name: str = "") -> None:
        """`plane` of the cobras; `address`: HOST or HOST:PORT; `camera`, and its address."""
        self.plane, self.camera, self.camera_name, self.address = plane, camera, camera_name, address
        self._connect = over_tcp(*tcp_address(address))
        self._maps: MotorMaps | None = None

    @property
    def bus_name(self) -> str:
        """The address of the FPGA."""
        return f"{FPGA}{self.address}"

    async def open(self) -> Hardware:
        """Homes all cobras: nothing else tells where they are. InputError where maps are missing."""
        if self._maps is None:
            raise InputError(f"{self.bus_name}: name the motor maps of its cobras by --calibration")
        drive = CobraDrive(self.plane, self._maps, FpgaClient(self._connect), self.plane.dots_mm)
        try:
            await drive.home()
        except BaseException:
            await to_its_end(drive.stop())
            await drive.close()
            raise
        return self.driven_by(drive, len(self.plane))

    def know(self, file: Path) -> None:
        """The motors are those of a summary of motor maps, in `file`."""
        self._maps = read_summary_maps(file, self.plane.positioner_id)

    def keep(self, file: Path | None) -> None:
        """InputError for any `file`: what cobras teach is not kept."""
        raise InputError("--adapt: what cobras teach is not kept; leave it out")
