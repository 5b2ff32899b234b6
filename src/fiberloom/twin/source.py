"""A twin as the hardware of a field: units drawn from the seed, on a bus, under a camera."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any

from fiberloom.bus.client import Client
from fiberloom.calibration.transmission.cache import cache_path
from fiberloom.calibration.transmission.sweep import (
    Calibration,
    Progress,
    SweepSettings,
    calibrate_transmission,
)
from fiberloom.errors import InputError
from fiberloom.hardware import Hardware
from fiberloom.instruments import FocalPlane
from fiberloom.twin.draw import draw_units, put_in
from fiberloom.twin.errors.sizes import TwinErrors
from fiberloom.twin.hardware import bench_hardware, check_camera, check_motors, draw_faults, field_hardware
from fiberloom.twin.twin import ADAPTIVE
from fiberloom.twin.units import Units
from fiberloom.version import core_digest

KIND = "this twin's tables are true and its air is still; --errors all makes it as a real array is"
"""Note of an observation on a twin without errors."""


@dataclass(frozen=True)
class _Key:
    """What a cached calibration depends on beside the layout and the seed."""

    sweep: SweepSettings
    units: str
    """Digest of the true units: on a twin, other units are other hardware."""
    core: str
    """Digest of the compiled core: another twin moves the same units otherwise, to the last bits."""
    steps: tuple[int, int]
    """Substeps of the twin's plant: other steps are other motions, to the last bits too."""


class TwinSource:
    """Implements `fiberloom.operation.source.Source`; what is wrong with its arguments is told at once."""

    def __init__(self, plane: FocalPlane, seed: int, camera: str, faults: str, errors: str = "none") -> None:
        check_motors(plane.instrument)
        check_camera(camera)
        draw_faults(plane, faults, seed)
        self.plane, self.seed, self.camera, self.faults = plane, seed, camera, faults
        self.errors = TwinErrors.of(plane.instrument, errors)

    @cached_property
    def units(self) -> Units:
        """The true units in this night."""
        return self.errors.temperature.applied(self.bench_units, self.plane)

    @cached_property
    def bench_units(self) -> Units:
        """The same at the temperature of the calibration."""
        return draw_units(self.plane, self.seed, errors=self.errors.at_calibration())

    @cached_property
    def hardware(self) -> Hardware:
        """The field, folded at first; it keeps its state from one observation to the next."""
        return field_hardware(
            self.plane, self.units, self.seed, faults=self.faults, camera=self.camera, errors=self.errors
        )

    async def open(self) -> Hardware:
        """The field as it is now."""
        return self.hardware

    async def sweep(self, points: int, progress: Progress) -> Calibration:
        """The same units on a bench of their own, where arms do not meet, as warm as benches are."""
        bench = bench_hardware(self.plane, self.bench_units, self.seed)
        client = Client(bench.bus)
        await client.discover()
        return await calibrate_transmission(
            client, bench.camera, self.plane, SweepSettings(points), seed=self.seed, progress=progress
        )

    def maps_file(self, points: int) -> Path | None:
        """The cache's file of these units."""
        key = _Key(SweepSettings(points), self.bench_units.digest(), core_digest(), ADAPTIVE)
        return cache_path(self.plane.config_hash(), self.seed, key)

    def know(self, file: Path) -> None:
        """The host has the transmission maps: InputError for any `file`."""
        raise InputError(f"{file}: transmission maps are the host's")

    def keep(self, file: Path | None) -> None:
        """InputError for any `file`: maps of these motors are learnt beside the transmission maps."""
        raise InputError(
            "--adapt: maps of these motors are learnt beside the transmission maps; leave it out"
        )

    def about(self) -> dict[str, Any]:
        """What was put in; and a note where what spoils a real array was not."""
        about: dict[str, Any] = {"put_in": put_in(self.plane, self.camera, self.errors)}
        if self.errors.temperature.on:
            at_C = self.errors.temperature.night_C(self.seed)
            about["put_in"]["temperature of this night"] = f"{at_C:.1f} deg C"
        return about if self.errors.any() else about | {"notes": [KIND]}

    @property
    def true_plane(self) -> FocalPlane | None:
        """The layout with the true arms and fibres."""
        points = {name: self.units.points_mm(mm, name) for name, mm in self.plane.points.items()}
        return replace(self.plane, arms=self.units.arms, points=points)
