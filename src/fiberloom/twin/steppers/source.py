"""Arrays of steppers of the twin as the hardware of a field: MEGARA, MOONS, LAMOST."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from fiberloom.calibration.transmission.sweep import Calibration, Progress
from fiberloom.drive.steppers import KnownUnits, StepperDrive, StepperLink
from fiberloom.drive.steppers.bench import BenchSettings, calibrate_units
from fiberloom.drive.steppers.drive import Maker
from fiberloom.drive.steppers.kept import read_units
from fiberloom.errors import InputError
from fiberloom.hardware import Hardware
from fiberloom.instruments import FocalPlane, Instrument
from fiberloom.metrology import Camera
from fiberloom.twin.camera.models import image_camera
from fiberloom.twin.camera.noise_camera import NoiseCamera
from fiberloom.twin.errors.sizes import TwinErrors
from fiberloom.twin.faults.clock import FaultClock
from fiberloom.twin.faults.grammar import parse_faults
from fiberloom.twin.faults.kinds import ServiceKind
from fiberloom.twin.faults.schedule import ScheduledFault, schedule_faults
from fiberloom.twin.hardware import check_camera
from fiberloom.twin.steppers.array import CountPath, StepperArray
from fiberloom.twin.steppers.bus import FAULTS, StepperBus
from fiberloom.twin.steppers.units import StepperUnits, draw_stepper_units
from fiberloom.typing import Floats, Ints

BENCH_UM = 2.0
"""[A] Noise of a bench's camera, 2-D rms."""


@dataclass(frozen=True)
class ArrayKind:
    """What differs between instruments."""

    bus: Callable[[StepperArray], StepperBus]
    link: Callable[[Any, FaultClock], StepperLink]
    """Of a bus, in virtual time."""
    maker: Callable[[Instrument], Maker]
    bench: BenchSettings
    gateway_of: Callable[[int], int]
    """Number of the bus of a unit: they lose their power together."""


class StepperSource:
    """Implements `fiberloom.operation.source.Source`; what is wrong with its arguments is told at once."""

    def __init__(
        self, plane: FocalPlane, kind: ArrayKind, seed: int, camera: str, faults: str, errors: str = "none"
    ) -> None:
        check_camera(camera)
        self._gateways = [(kind.gateway_of(k), 0) for k in plane.positioner_id.tolist()]
        able = plane.positioner_id[~plane.offline]
        self.faults = schedule_faults(parse_faults(faults, FAULTS), able, sorted(set(self._gateways)), seed)
        self.plane, self.kind, self.seed = plane, kind, seed
        self.camera = "noise" if plane.instrument.camera is None else camera
        self.errors = TwinErrors.of(plane.instrument, errors)
        self._known_file: Path | None = None

    @cached_property
    def units(self) -> StepperUnits:
        """The true units."""
        return draw_stepper_units(self.plane, self.seed)

    @cached_property
    def known(self) -> KnownUnits:
        """What a bench finds of them, or has found before by the file of a calibration."""
        if self._known_file is not None:
            return read_units(self._known_file, self.plane)
        return calibrate_units(self.plane, TwinBench(self.plane, self.units, self.seed + 1), self.kind.bench)

    @cached_property
    def bus(self) -> StepperBus:
        """The field, folded, as power comes on; it keeps its state from one observation to the next."""
        return self.kind.bus(StepperArray(self.plane, self.units, seed=self.seed))

    @cached_property
    def schedule(self) -> list[ScheduledFault]:
        """The faults, those of a gateway for each of its units."""
        at = dict(zip(self.plane.positioner_id.tolist(), self._gateways, strict=True))
        return [
            one if one.kind != ServiceKind.BUS_OFF else replace(one, positioner_id=number)
            for one in self.faults
            for number in (at if one.kind == ServiceKind.BUS_OFF else [0])
            if one.kind != ServiceKind.BUS_OFF or at[number] == one.place
        ]

    @cached_property
    def hardware(self) -> Hardware:
        """Drive, camera and truth."""
        array = self.bus.array
        faults = FaultClock(self.bus, self.schedule, self.seed)
        link = self.kind.link(self.bus, faults)
        drive = StepperDrive(self.plane, link, self.known, self.kind.maker(self.plane.instrument))
        vouched = np.ones(len(self.plane), dtype=bool)
        return Hardware(None, self._camera(array), array, vouched=vouched, telescope=array, drive=drive)

    def _camera(self, array: StepperArray) -> Camera:
        if self.camera == "image":
            return image_camera(array, self.seed, errors=self.errors)
        return NoiseCamera(array, self.plane.instrument.metrology.noise_rms_um, self.seed, self.errors)

    async def open(self) -> Hardware:
        """The field as it is now."""
        return self.hardware

    async def sweep(self, points: int, progress: Progress) -> Calibration | None:
        """Steppers have tables of their own; there is no sweep of `points`, and no `progress`."""
        return None

    def maps_file(self, points: int) -> Path | None:
        """None: tables of steppers are not transmission maps, however many `points` these have."""
        return None

    def know(self, file: Path) -> None:
        """Goes by the units of a `file` of `calibrate steppers`. InputError where it is none."""
        read_units(file, self.plane)  # what is wrong with it is told now
        self._known_file = file

    def keep(self, file: Path | None) -> None:
        """InputError for any `file`: steppers teach nothing that is kept."""
        raise InputError("--adapt: steppers teach nothing that is kept; leave it out")

    def about(self) -> dict[str, Any]:
        """What was put in."""
        sizes = self.units.sizes
        told = {
            "datum switches": f"close {sizes.switch_deg:g} deg off, and {sizes.repeat_deg:g} deg apart",
            "gears": f"{sizes.gear_deg:g} deg at orders 1 to 3, play {sizes.play_deg:g} deg",
            "bench": f"{self.kind.bench.knots} points of each axis, camera {BENCH_UM:g} um",
        }
        notes = []
        if not self.plane.instrument.metrology.present:
            notes.append("no camera looks while this instrument observes: measured positions only score")
        return {"put_in": told, "notes": notes}

    @property
    def true_plane(self) -> FocalPlane | None:
        """The layout with the true arms."""
        longer = np.column_stack([self.units.beta_longer_mm, np.zeros(len(self.plane))])
        points = {name: mm + longer for name, mm in self.plane.points.items()}
        return replace(self.plane, arms=self.units.arms, points=points)


class TwinBench:
    """The same units alone, under a bench's camera. Implements `fiberloom.drive.steppers.bench.Bench`."""

    def __init__(self, plane: FocalPlane, units: StepperUnits, seed: int) -> None:
        self._array = StepperArray(plane, units, seed=seed, contacts=False)
        self._now_s = 0.0
        self._array.clock = lambda: self._now_s
        self._array.dead[:] = False
        self._every = np.arange(len(plane))
        self._rng = np.random.default_rng([seed, 0xBE7C])

    def home(self) -> None:
        """All search both switches."""
        for axis in (1, 0):
            took_s, _, _ = self._array.seek(self._every, axis, 1000.0)
            self._now_s += float(took_s.max()) + 1.0

    def go(self, counts: Ints) -> None:
        """All go to `counts` (N, 2)."""
        path = np.stack([self._array.counts, counts]).astype(np.float64)
        time_s = np.broadcast_to(np.array([[0.0], [1.0]]), (2, len(counts)))
        self._now_s += self._array.go(CountPath(self._every, time_s, path)) + 1.0

    def look(self) -> Floats:
        """(N, 2) fibres in mm."""
        at: Floats = self._array.fibre_xy()
        return at + self._rng.normal(0.0, 1e-3 * BENCH_UM / np.sqrt(2.0), at.shape)
