"""A field of one instrument of Table 1: drawn, calibrated, assigned, planned, verified, moved, corrected."""

from __future__ import annotations

import time
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from fiberloom.assignment import Assignment, AssignSettings, assign_relaxed
from fiberloom.blocking import finish
from fiberloom.calibration.transmission.nominal import nominal_maps
from fiberloom.drive.pfs.calibration import left_out
from fiberloom.drive.way_rules import way_rule
from fiberloom.instruments import FocalPlane, generate, load_instrument
from fiberloom.instruments.model import OwnRequirement
from fiberloom.operation.loop import Loop, LoopSettings
from fiberloom.operation.motion import FieldMotion
from fiberloom.operation.move import Move
from fiberloom.operation.reference.referencing import reference
from fiberloom.operation.source import Doubting
from fiberloom.studies.paper.focal_plane.table01_rows import Row
from fiberloom.studies.paper.memory import forget_peak, peak_bytes
from fiberloom.studies.paper.no_record import NoRecord
from fiberloom.targets import random_targets
from fiberloom.twin.motors.arrays import source_of
from fiberloom.typing import Flags, Floats
from fiberloom.units import UM_PER_MM

if TYPE_CHECKING:
    from fiberloom.twin.motors.arrays import AnySource

TARGETS_PER_UNIT = 3
SWEEP_POINTS = 100
"""Of the transmission maps, where a host has them."""
BYTES_PER_GIB = 2**30
FURTHER = 3
"""Corrections beyond those that an instrument makes, where these do not do: what it would take."""


@dataclass(frozen=True)
class InstrumentRun:
    """How a field of one instrument went, as the twin knows it."""

    error_um: list[Floats]
    """After each move, of the fibres with a target whose positioners are healthy at the end."""
    assigned: int
    positioners: int
    collisions: int
    """In verified plans."""
    contacts: int
    """Of arms."""
    reconfiguration_s: float
    """From the first motion to the last image, with the search of datums and the exposures."""
    cpu_s: float
    """Of everything, calibration included."""
    memory_gib: float
    """At most; NaN where the system does not tell."""
    ended_s: list[float]
    """After each move: as `reconfiguration_s`, until its image."""
    further_um: Floats | None = None
    """As `error_um`, after `FURTHER` corrections more; None: none were made."""
    left_out: dict[str, str] = field(default_factory=dict)
    """Units, by number, that got no target: by their calibration before it they cannot be counted on; why."""

    def on_target(self, within_um: float, move: int = -1) -> float:
        """Share of all that were assigned, faulty ones included, that are so near after a `move`."""
        return float(np.sum(self.error_um[move] <= within_um)) / max(self.assigned, 1)

    def own(self, asked: OwnRequirement) -> float:
        """What the makers bound, um or a share, after the last move that ends in time; NaN: none does."""
        limit_s = np.inf if asked.within_s is None else asked.within_s
        done = int(np.searchsorted(self.ended_s, limit_s, side="right"))
        if done == 0:
            return float("nan")
        error_um = self.error_um[done - 1]
        if asked.statistic == "share":
            return self.on_target(asked.within_um, done - 1)
        return rms(error_um) if asked.statistic == "rms" else float(error_um.max())


def observe(row: Row, seed: int, n_units: int | None) -> InstrumentRun:
    """Units drawn and calibrated, targets assigned, planned, verified, moved, corrected as the preset says.

    Units that their calibration does not count on get no targets.

    `row` of the table; `seed` of everything; `n_units`: so many, None: as many as there are.
    """
    forget_peak()
    begun_s = time.process_time()
    drawn = generate(load_instrument(row.preset), seed, n_positioners=n_units)
    source = source_of(drawn, seed, row.camera)
    plane, doubted, scatter = _counted_on(drawn, source)
    targets = random_targets(plane, TARGETS_PER_UNIT * len(plane), seed)
    kept, assignment = assign_relaxed(
        plane, targets, seed=seed, settings=AssignSettings(ways=way_rule(plane, scatter))
    )
    target_mm = targets.xy_mm[np.maximum(assignment.target, 0)]
    made = _FieldRun(kept, source, assignment, target_mm)
    finish(made.observe(seed))
    cpu_s = time.process_time() - begun_s
    contacts = made.loop.motion.contacts_true
    errors_um, ended_s = made.errors_um(), made.ended_s()
    finish(made.go_further(row.requirement_um))
    return InstrumentRun(
        errors_um,
        assignment.n_assigned,
        len(plane),
        made.loop.motion.collisions_verified,
        0 if contacts is None else contacts,
        ended_s[-1],
        cpu_s,
        peak_bytes() / BYTES_PER_GIB,
        ended_s,
        made.errors_um()[-1] if len(made.loop.moves) > len(errors_um) else None,
        {str(number): why for number, why in sorted(doubted.items())},
    )


def _counted_on(plane: FocalPlane, source: AnySource) -> tuple[FocalPlane, dict[int, str], Floats | None]:
    """The plane without units that a calibration does not count on; these and why; scatter (N, 2) of all."""
    if not isinstance(source, Doubting):
        return plane, {}, None
    doubted = finish(source.doubtful())
    kept = left_out(plane, doubted, source.standing_deg()) if doubted else plane
    return kept, doubted, source.scatter()


class _FieldRun:
    """The loop of one field."""

    loop: Loop

    def __init__(
        self, plane: FocalPlane, source: AnySource, assignment: Assignment, target_mm: Floats
    ) -> None:
        self.plane, self.source, self.assignment, self.target_mm = plane, source, assignment, target_mm

    async def observe(self, seed: int) -> None:
        """As the preset says."""
        maps = nominal_maps(self.plane)
        if self.plane.instrument.drive.by_maps:
            swept = await self.source.sweep(SWEEP_POINTS, lambda done, total: None)
            maps = maps if swept is None else swept.maps
        hardware = await self.source.open()
        motion = FieldMotion(self.plane, maps, hardware, NoRecord())
        self._begun_s = motion.drive.time_s
        await motion.connect()
        await reference(motion)
        operation = self.plane.instrument.operation
        settings = LoopSettings.of(operation, images=operation.images_max, seed=seed)
        self.loop = Loop(motion, self.assignment, settings)
        await self.loop.run()

    def ended_s(self) -> list[float]:
        """Of each move until its image, by the bus and by exposures, while which that clock stands still."""
        camera = self.plane.instrument.camera
        blind = camera is None or self.loop.motion.drive.model.blind
        exposure_s = 0.0 if blind or camera is None else camera.exposure_s
        images = np.cumsum([move.measurement.images for move in self.loop.moves])
        bus_s = np.array([move.measurement.time_s for move in self.loop.moves]) - self._begun_s
        return [float(s) for s in bus_s + exposure_s * images]

    def errors_um(self) -> list[Floats]:
        """True, after each move so far, of the healthy fibres with a target."""
        return [_true_error_um(move, self.target_mm, self.loop.correctable) for move in self.loop.moves]

    async def go_further(self, requirement_um: float) -> None:
        """More corrections where the last move has not done; none for an instrument without a camera."""
        missed = bool((self.errors_um()[-1] > requirement_um).any())
        if missed and not self.loop.motion.drive.model.blind:
            await self.loop.further(FURTHER)


def _true_error_um(move: Move, target_mm: Floats, rows: Flags) -> Floats:
    if move.true_mm is None:
        raise RuntimeError("the twin knows where its fibres are")
    error: Floats = UM_PER_MM * np.hypot(*(move.true_mm - target_mm)[rows].T)
    return error


def rms(error_um: Floats) -> float:
    """Root of the mean square, um."""
    return float(np.sqrt(np.mean(error_um**2)))
