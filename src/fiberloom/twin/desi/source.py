"""DESI's twin as the hardware of a field."""

from __future__ import annotations

from dataclasses import replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from fiberloom.calibration.transmission.sweep import Calibration, Progress
from fiberloom.drive.desi.drive import DesiDrive
from fiberloom.drive.desi.maps.kept import kept_file, read_maps
from fiberloom.drive.desi.maps.learned import PLANETARY, LearnedMaps
from fiberloom.hardware import Hardware
from fiberloom.instruments import FocalPlane
from fiberloom.metrology import Camera
from fiberloom.twin.camera.models import image_camera
from fiberloom.twin.camera.noise_camera import NoiseCamera
from fiberloom.twin.desi.array import DesiTwin
from fiberloom.twin.desi.transport import DesiTransport
from fiberloom.twin.desi.units import DesiUnits, draw_desi_units
from fiberloom.twin.errors.sizes import TwinErrors
from fiberloom.twin.faults.clock import FaultClock
from fiberloom.twin.faults.grammar import parse_faults
from fiberloom.twin.faults.kinds import Reach, ServiceKind
from fiberloom.twin.faults.schedule import ScheduledFault, schedule_faults
from fiberloom.twin.hardware import check_camera
from fiberloom.twin.sky.guider import TwinGuider

FAULTS = Reach(("busoff", "dark", "dead", "deaf", "lost", "lying", "slipping"), timed=True)
"""Of --faults. There is no encoder: one that is dead reports what one that lies does. `busoff` takes bus and
power from half a petal, `slipping` is a degraded ("linear") motor that is not known to be one."""
PETALS, MIDDLE_DEVICE = 10, 270
"""[A] Half a petal has a bus and a supply of its own: locations below and above the middle one."""


def buses_of(plane: FocalPlane) -> list[tuple[int, int]]:
    """Petal and half of each positioner of a `plane`: of a table by its number, else by its direction."""
    numbers = plane.positioner_id
    if plane.hole[0].startswith("P"):  # location: 1000 x place of the petal + device
        petal, half = numbers // 1000, numbers % 1000 >= MIDDLE_DEVICE
    else:
        turn = np.arctan2(*plane.centres_mm.T[::-1]) / (2.0 * np.pi) % 1.0 * PETALS
        petal, half = turn.astype(int), turn % 1.0 >= 0.5
    return [(int(p), int(h)) for p, h in zip(petal, half, strict=True)]


class DesiSource:
    """Implements `fiberloom.operation.source.Source`; what is wrong with its arguments is told at once."""

    def __init__(self, plane: FocalPlane, seed: int, camera: str, faults: str, errors: str = "none") -> None:
        check_camera(camera)
        able = plane.positioner_id[~plane.offline]
        self._buses = buses_of(plane)
        places = sorted(set(self._buses))
        self.faults = schedule_faults(parse_faults(faults, FAULTS), able, places, seed)
        self.plane, self.seed, self.camera = plane, seed, camera
        self.errors = TwinErrors.of(plane.instrument, errors)
        self._maps: LearnedMaps | None = None
        self._kept: Path | None = None

    @cached_property
    def units(self) -> DesiUnits:
        """The true units."""
        return draw_desi_units(self.plane, self.seed)

    @cached_property
    def twin(self) -> DesiTwin:
        """The field, folded at first; it keeps its state from one observation to the next."""
        return DesiTwin(self.plane, self.units, seed=self.seed)

    @cached_property
    def schedule(self) -> list[ScheduledFault]:
        """The faults, those of a bus for each of its positioners."""
        numbers = self.plane.positioner_id[~self.plane.offline].tolist()
        bus_of = dict(zip(self.plane.positioner_id.tolist(), self._buses, strict=True))
        return [
            fault if fault.kind != ServiceKind.BUS_OFF else replace(fault, positioner_id=number)
            for fault in self.faults
            for number in (numbers if fault.kind == ServiceKind.BUS_OFF else [0])
            if fault.kind != ServiceKind.BUS_OFF or bus_of[number] == fault.place
        ]

    @cached_property
    def hardware(self) -> Hardware:
        """Drive, camera and truth."""
        camera: Camera
        if self.camera == "image":
            camera = image_camera(self.twin, self.seed, errors=self.errors)
        else:
            rms_um = self.plane.instrument.metrology.noise_rms_um
            camera = NoiseCamera(self.twin, rms_um, self.seed, self.errors)
        faults = FaultClock(self.twin, self.schedule, self.seed)
        drive = DesiDrive(self.plane, DesiTransport(self.twin, faults), self._maps)
        drive.kept = self._kept
        vouched = np.ones(len(self.plane), dtype=bool)
        guider = TwinGuider(self.errors.pointing, self.seed)
        return Hardware(
            None, camera, self.twin, vouched=vouched, telescope=self.twin, drive=drive, guider=guider
        )

    async def open(self) -> Hardware:
        """The field as it is now."""
        return self.hardware

    async def sweep(self, points: int, progress: Progress) -> Calibration | None:
        """There is no bench: maps are learnt from images. `points` and `progress` are not used."""
        return None

    def maps_file(self, points: int) -> Path | None:
        """Nothing is kept, whatever the `points`."""
        return None

    def know(self, file: Path) -> None:
        """Begins with the maps of a `file` of earlier nights. InputError where it is none."""
        if file == self._kept and not file.exists():
            return  # its first night
        self._maps = read_maps(file, self.plane, PLANETARY)
        # arms and fields of this twin are where those of its first night were
        self._maps.believed_deg = self.plane.park_deg.copy()

    def keep(self, file: Path | None) -> None:
        """Begins with what is in the `file`, if there is one, and writes it anew after each image.

        None: the file of this layout and seed in the user's own folder.
        """
        self._kept = file or kept_file(self.plane, self.seed)
        self.know(self._kept)

    def about(self) -> dict[str, Any]:
        """What was put in."""
        return {
            "put_in": {
                "gears": "planetary orders, amplitudes by the published blind error of 54 um",
                "scatter of a move": f"{self.units.sizes.scatter_deg:g} deg per axis",
            }
        }

    @property
    def true_plane(self) -> FocalPlane | None:
        """The layout with the true arms."""
        longer = np.column_stack([self.units.beta_longer_mm, np.zeros(len(self.plane))])
        points = {name: mm + longer for name, mm in self.plane.points.items()}
        return replace(self.plane, arms=self.units.arms, points=points)
