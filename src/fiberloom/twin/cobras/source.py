"""The twin of PFS as the hardware of a field: cobras behind their boards, in virtual time, under a camera."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from fiberloom.calibration.transmission.sweep import Calibration, Progress
from fiberloom.drive.pfs import CobraDrive, FpgaClient
from fiberloom.drive.pfs.calibration import CobraCalibration, calibrate_cobras, doubtful, standing_deg
from fiberloom.drive.pfs.numbering import COBRAS
from fiberloom.drive.piezo import MotorMaps, read_summary_maps
from fiberloom.errors import InputError
from fiberloom.hardware import Hardware
from fiberloom.instruments import FocalPlane
from fiberloom.metrology import Camera
from fiberloom.twin.actuators import PiezoErrors, drawn_maps
from fiberloom.twin.camera.models import image_camera
from fiberloom.twin.camera.noise_camera import NoiseCamera
from fiberloom.twin.cobras.array import CobraArray, Contact
from fiberloom.twin.cobras.streams import VirtualBoards
from fiberloom.twin.errors.sizes import TwinErrors
from fiberloom.twin.hardware import check_camera, draw_faults
from fiberloom.twin.sky.guider import TwinGuider
from fiberloom.typing import Floats

KIND = "cobras of the twin begin at home; their arms and dots are those of the layout"


@dataclass
class CobraSource:
    """Implements `fiberloom.operation.source.Source`; what is wrong with its arguments is told at once.

    `plane` of cobras; `seed` of motors and noise; `camera`: noise or image; `faults` and `errors`: as of the
    other twins; `maps` of the 2 N motors, without their errors, drawn when left out.
    """

    plane: FocalPlane
    seed: int
    camera: str
    faults: str = ""
    errors: str = "none"
    maps: MotorMaps | None = None
    calibrated: bool = True
    """Motors are calibrated before the first field, with the camera that knows whose spot is whose."""

    def __post_init__(self) -> None:
        check_camera(self.camera)
        if self.plane.positioner_id.max(initial=0) > COBRAS:
            raise InputError(f"cobra {self.plane.positioner_id.max()}: boards have {COBRAS} of them")
        timed = [
            f for f in draw_faults(self.plane, self.faults, self.seed) if f.start_s > 0 or f.end_s < np.inf
        ]
        if timed:
            raise InputError(
                f"--faults {timed[0].kind}: faults of cobras are there from the begin; leave out @ and +"
            )
        self._twin_errors  # noqa: B018  an unknown name is told now

    @cached_property
    def _twin_errors(self) -> TwinErrors:
        return TwinErrors.of(self.plane.instrument, self.errors)

    @cached_property
    def known_maps(self) -> MotorMaps:
        """What the host has: drawn for all cobras of the instrument, so that each keeps its own."""
        if self.maps is not None:
            return self.maps
        every = drawn_maps(COBRAS, self.seed)
        rows = (2 * (self.plane.positioner_id[:, None] - 1) + np.arange(2)).ravel()
        return MotorMaps(every.step_deg[rows], every.bin_deg, every.pulse_us[rows])

    @cached_property
    def array(self) -> CobraArray:
        """The cobras as they are."""
        array = CobraArray(self.plane, self.known_maps, PiezoErrors(), self.seed)
        for fault in draw_faults(self.plane, self.faults, self.seed):
            array.inject(fault.fault)
        return array

    @cached_property
    def boards(self) -> VirtualBoards:
        """Their boards; the clock of all."""
        return VirtualBoards(self.array)

    @cached_property
    def hardware(self) -> Hardware:
        """The field; it keeps its state from one observation to the next."""
        drive = CobraDrive(
            self.plane, self.known_maps, FpgaClient(self.boards.connector()), self.array.dots_mm
        )
        vouched = np.ones(len(self.plane), dtype=bool)
        guider = TwinGuider(self._twin_errors.pointing, self.seed)
        return Hardware(
            None,
            self._camera(),
            self.array,
            vouched=vouched,
            telescope=self.array,
            drive=drive,
            guider=guider,
        )

    def _camera(self) -> Camera:
        if self.camera == "image":
            return image_camera(self.array, self.seed, errors=self._twin_errors)
        return self._noise_camera()

    def _noise_camera(self) -> Camera:
        noise_um = self.plane.instrument.metrology.noise_rms_um
        return NoiseCamera(self.array, noise_um, self.seed, self._twin_errors)  # type: ignore[arg-type]

    async def open(self) -> Hardware:
        """The field as it is now; at first home, with motors calibrated."""
        if self.calibrated and not self.calibrations:
            await self._calibrate()
        return self.hardware

    async def doubtful(self, moves: int | None = None) -> dict[int, str]:
        """By number why cobras cannot be counted on, by their calibration; empty where there is none.

        `moves` of the field; None: those of the instrument.
        """
        await self.open()
        return doubtful(self.calibrations[0], self.plane, moves) if self.calibrations else {}

    def standing_deg(self) -> Floats:
        """(N, 2) alpha and beta in deg, by an image after the search of the stops; at the stops before."""
        return standing_deg(self.plane, self._seen_at_stops_mm)

    def scatter(self) -> Floats | None:
        """(N, 2), dimensionless, of moves of theta and phi, as calibrated; None before."""
        return self.calibrations[0].motors.scatter.reshape(-1, 2) if self.calibrations else None

    @cached_property
    def calibrations(self) -> list[CobraCalibration]:
        """What was found before the first field; empty until then."""
        return []

    @cached_property
    def _calibration_contacts(self) -> list[Contact]:
        return []

    @cached_property
    def _seen_at_stops_mm(self) -> Floats:
        """(N, 2) fibres after the calibration; NaN where not seen, and before."""
        return np.full((len(self.plane), 2), np.nan)

    @property
    def calibration_contacts(self) -> int:
        """How often arms touched while motors were calibrated."""
        return len(self._calibration_contacts)

    async def _calibrate(self) -> None:
        bench = FpgaClient(self.boards.connector())
        drive = CobraDrive(self.plane, self.known_maps, bench, self.array.dots_mm)
        found = await calibrate_cobras(drive, self._noise_camera())
        self.calibrations.append(found)
        await drive.home()
        image = self._noise_camera().measure(None)
        self._seen_at_stops_mm = np.where(image.seen[:, None], image.xy_mm, np.nan)
        self._calibration_contacts.extend(self.array.touched)
        self.array.touched.clear()
        own = self.hardware.drive
        assert isinstance(own, CobraDrive)
        await own.client.open()  # its clock is that of the boards from now on
        own.law.maps = found.motors.maps
        own.law.trust_maps(found.motors.scatter, np.array([not r for r in found.motors.reason]))

    async def sweep(self, points: int, progress: Progress) -> Calibration | None:
        """Cobras have motor maps; there is no bench that sweeps `points`, and no `progress`."""
        return None

    def maps_file(self, points: int) -> Path | None:
        """None: motor maps are not transmission maps, however many `points` these have."""
        return None

    def know(self, file: Path) -> None:
        """The motors are those of a summary of motor maps, in `file`, with the errors of the twin."""
        self.maps = read_summary_maps(file, self.plane.positioner_id)

    def keep(self, file: Path | None) -> None:
        """InputError for any `file`: what cobras teach is not kept."""
        raise InputError("--adapt: what cobras teach is not kept; leave it out")

    def about(self) -> dict[str, Any]:
        """What was put in."""
        errors = PiezoErrors()
        told = {
            "motors": f"lasting errors {errors.unit_sd:g}, of a place {errors.here_sd:g}, fresh "
            f"{errors.move_median:g} of the way; fitted to the published convergence",
            "motor maps": "drawn as the published ones are distributed" if self.maps is None else "given",
            "camera": self.camera,
        }
        return {"put_in": told, "notes": [KIND]}

    @property
    def true_plane(self) -> FocalPlane | None:
        """The layout: its arms are the true ones."""
        return self.plane
