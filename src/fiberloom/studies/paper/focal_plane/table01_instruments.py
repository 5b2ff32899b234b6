"""Table 1: the six instruments, each with its own motors, bus, camera and operation."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass

import matplotlib.pyplot as plt
import numpy as np

from fiberloom.assignment import Assignment, AssignSettings, assign_relaxed
from fiberloom.blocking import finish
from fiberloom.calibration.transmission.nominal import nominal_maps
from fiberloom.drive.way_rules import way_rule
from fiberloom.instruments import FocalPlane, generate, load_instrument
from fiberloom.operation.loop import Loop, LoopSettings
from fiberloom.operation.motion import FieldMotion
from fiberloom.operation.move import Move
from fiberloom.operation.reference.referencing import reference
from fiberloom.studies.paper.memory import forget_peak, peak_bytes
from fiberloom.studies.paper.no_record import NoRecord
from fiberloom.studies.paper.outcome import Drawing, FigureOutcome, Settings, drawing
from fiberloom.studies.paper.quantity import Bound, Kind, Quantity, ordering, quantity
from fiberloom.targets import random_targets
from fiberloom.twin.motors.arrays import AnySource, source_of
from fiberloom.typing import Flags, Floats
from fiberloom.units import UM_PER_MM

UNITS = 57
"""A module of PFS, and as many of each other."""
TARGETS_PER_UNIT = 3
SWEEP_POINTS = 100
"""Of the transmission maps, where a host has them."""
SHARE = 0.99
"""Of healthy fibres within the requirement: an instrument with more meets it."""
BYTES_PER_GIB = 2**30
FURTHER = 3
"""Corrections beyond those that an instrument makes, where these do not do: what it would take."""


@dataclass(frozen=True)
class Row:
    """A row of Kronig 2020, Table 1, the preset that stands for it, and what is published of its field."""

    key: str
    name: str
    units: int
    l_alpha_mm: float
    l_beta_mm: float
    pitch_mm: float
    requirement_um: float
    preset: str
    published: str
    why: str = ""
    """Why it misses, where it does."""

    @property
    def reach_mm(self) -> float:
        """The longest lever of the alpha axis."""
        return self.l_alpha_mm + self.l_beta_mm

    @property
    def tolerance_mdeg(self) -> float:
        """Error of the alpha axis that uses up the requirement with the arm stretched."""
        return 1e3 * float(np.rad2deg(self.requirement_um / UM_PER_MM / self.reach_mm))


TABLE_1 = (
    Row("lamost", "LAMOST", 4000, 8.25, 8.25, 25.6, 40.0, "lamost", "at most 40 um; 1 to 2 min"),
    Row("megara", "MEGARA", 92, 5.803, 5.803, 20.1, 102.0, "megara", "64.7 s for a turn of rotor 1"),
    Row(
        "desi",
        "DESI",
        5000,
        3.0,
        3.0,
        10.4,
        5.0,
        "desi",
        "54 um rms blind, 6 to 9 measured then; 8 s and 3 s",
        "one correction by one image: its noise, scatter, and what maps do not know yet",
    ),
    Row("sdssv", "SDSS-V", 500, 7.4, 15.0, 22.4, 5.0, "sdssv", "90 % within 30 um; 2 to 3 min"),
    Row(
        "moons",
        "MOONS",
        1001,
        8.0,
        17.0,
        25.0,
        20.0,
        "moons",
        "20 um asked for; 19.3 s for the range of alpha",
    ),
    Row(
        "cobra",
        "COBRA",
        2400,
        2.375,
        2.375,
        8.0,
        5.0,
        "pfs",
        "92 % within 10 um, median 5 um; 22 s an iteration",
        "motors that scatter by half of each way need more moves",
    ),
)


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
    memory_gib: float = float("nan")
    """At most; NaN where the system does not tell."""
    further_um: Floats | None = None
    """As `error_um`, after `FURTHER` corrections more; None: none were made."""


def observe(row: Row, seed: int, n_units: int | None) -> InstrumentRun:
    """Units drawn and calibrated, targets assigned, planned, verified, moved, corrected as the preset says.

    `row` of the table; `seed` of everything; `n_units`: so many, None: as many as there are.
    """
    forget_peak()
    begun_s = time.process_time()
    plane = generate(load_instrument(row.preset), seed, n_positioners=n_units)
    targets = random_targets(plane, TARGETS_PER_UNIT * len(plane), seed)
    kept, assignment = assign_relaxed(
        plane, targets, seed=seed, settings=AssignSettings(ways=way_rule(plane))
    )
    target_mm = targets.xy_mm[np.maximum(assignment.target, 0)]
    field = _FieldRun(kept, source_of(plane, seed, "noise"), assignment, target_mm)
    finish(field.observe(seed))
    cpu_s = time.process_time() - begun_s
    contacts = field.loop.motion.contacts_true
    errors_um = field.errors_um()
    finish(field.go_further(row.requirement_um))
    return InstrumentRun(
        errors_um,
        assignment.n_assigned,
        len(plane),
        field.loop.motion.collisions_verified,
        0 if contacts is None else contacts,
        field.took_s,
        cpu_s,
        peak_bytes() / BYTES_PER_GIB,
        field.errors_um()[-1] if len(field.loop.moves) > len(errors_um) else None,
    )


class _FieldRun:
    """The loop of one field."""

    loop: Loop
    took_s: float
    """Of the bus and of exposures."""

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
        motion = FieldMotion(self.plane, maps, await self.source.open(), NoRecord())
        begun_s = motion.drive.time_s
        await motion.connect()
        await reference(motion)
        operation = self.plane.instrument.operation
        settings = LoopSettings.of(operation, images=operation.images_max, seed=seed)
        self.loop = Loop(motion, self.assignment, settings)
        await self.loop.run()
        self.took_s = motion.drive.time_s - begun_s + self._exposed_s()

    def _exposed_s(self) -> float:
        """The virtual clock stands still while images are taken."""
        camera = self.plane.instrument.camera
        images = sum(move.measurement.images for move in self.loop.moves)
        return 0.0 if camera is None or self.loop.motion.drive.model.blind else images * camera.exposure_s

    def errors_um(self) -> list[Floats]:
        """True, after each move so far, of the healthy fibres with a target."""
        return [_true_error_um(move, self.target_mm, self.loop.correctable) for move in self.loop.moves]

    async def go_further(self, requirement_um: float) -> None:
        """More corrections where the last move has not done; none for an instrument without a camera."""
        missed = _within(self.errors_um()[-1], requirement_um) < SHARE
        if missed and not self.loop.motion.drive.model.blind:
            await self.loop.further(FURTHER)


def _true_error_um(move: Move, target_mm: Floats, rows: Flags) -> Floats:
    if move.true_mm is None:
        raise RuntimeError("the twin knows where its fibres are")
    error: Floats = UM_PER_MM * np.hypot(*(move.true_mm - target_mm)[rows].T)
    return error


def run(settings: Settings) -> FigureOutcome:
    """Ours beside the requirement of each instrument."""
    n_units = None if settings.full else UNITS
    seeds = settings.seeds[:1] if settings.full else settings.seeds
    found: dict[str, list[InstrumentRun]] = {row.key: [] for row in TABLE_1}
    for row in TABLE_1:
        for seed in seeds:
            settings.say(f"Table 1: {row.name}, seed {seed}")
            found[row.key].append(observe(row, seed, n_units))
    size = "All units" if settings.full else f"{UNITS} units"
    return FigureOutcome(
        quantities=[
            _stringent(),
            *(q for row in TABLE_1 for q in _quantities(row, found[row.key])),
        ],
        drawings=[_draw_table(found), _draw(found)],
        how=(
            f"{size} of each instrument by its preset: its own motors, frames, camera, planning and "
            "corrections on the twin. Units are drawn and calibrated, targets assigned, motions planned, "
            "verified and driven over the bus. DESI's maps are empty, as before its first night. Errors are "
            "true, of healthy fibres with a target. Times have each camera's exposures in them. Where less "
            f"than {100.0 * SHARE:g} % are within, {FURTHER} corrections more tell what it would take."
        ),
        smaller=""
        if settings.full
        else f"{UNITS} units of each instead of 92 to 5000; --full runs all of them, once.",
    )


def _stringent() -> Quantity:
    strictest = min(TABLE_1, key=lambda row: row.tolerance_mdeg)
    return ordering(
        "table1.order.strictest_is_sdssv",
        "SDSS-V asks for the most accurate alpha axis of the six",
        strictest.key == "sdssv",
        Kind.IDENTITY,
        note="requirement over reach: "
        + ", ".join(f"{row.name} {row.tolerance_mdeg:.1f}" for row in TABLE_1)
        + " mdeg",
    )


def _quantities(row: Row, runs: Sequence[InstrumentRun]) -> list[Quantity]:
    last = [r.error_um[-1] for r in runs]
    within = [_within(e, row.requirement_um) for e in last]
    moves = max(len(r.error_um) for r in runs)
    worst = [float(e.max()) for e in last]
    told: list[tuple[str, str, list[float], str]] = [
        ("moves", "moves, the blind one with them", [float(len(r.error_um)) for r in runs], "1"),
        ("blind_rms_um", "blind move, true rms", [_rms(r.error_um[0]) for r in runs], "um"),
        ("rms_um", f"after {moves} moves, true rms", [_rms(e) for e in last], "um"),
        ("p95_um", f"after {moves} moves, 95 %", [float(np.percentile(e, 95)) for e in last], "um"),
        (
            "reconfiguration_s",
            "from the first motion to the last image",
            [r.reconfiguration_s for r in runs],
            "s",
        ),
        ("cpu_s", "processor time, calibration included", [r.cpu_s for r in runs], "s"),
        ("memory_gib", "most memory", [r.memory_gib for r in runs], "GiB"),
        *_further(row, runs),
    ]
    key, name = f"table1.{row.key}", row.name
    why = "; ".join(filter(None, [_by_moves(row, runs), row.why if min(within) < SHARE else ""]))
    contacts = [float(r.contacts) for r in runs]
    return [
        quantity(f"{key}.max_um", f"{name}: worst healthy fibre, true", worst, "um", Kind.REQUIREMENT,
                 paper=row.requirement_um, bound=Bound.AT_MOST, note=_note(row, runs)),
        quantity(f"{key}.within", f"{name}: share within {row.requirement_um:g} um", within, "1",
                 Kind.REQUIREMENT, paper=SHARE, bound=Bound.AT_LEAST, note=why),
        quantity(f"{key}.contacts", f"{name}: contacts of arms, in the twin's truth", contacts, "1",
                 Kind.REQUIREMENT, paper=0.0, bound=Bound.AT_MOST, beyond=True),
        *(quantity(f"{key}.{what}", f"{name}: {words}", values, unit, beyond=True)
          for what, words, values, unit in told),
    ]  # fmt: skip


def _further(row: Row, runs: Sequence[InstrumentRun]) -> list[tuple[str, str, list[float], str]]:
    """What more corrections than the instrument makes would bring, of the runs that made them."""
    further = [r.further_um for r in runs if r.further_um is not None]
    if not further:
        return []
    words = f"share within {row.requirement_um:g} um after {FURTHER} corrections more than it makes"
    return [("further_within", words, [_within(e, row.requirement_um) for e in further], "1")]


def _by_moves(row: Row, runs: Sequence[InstrumentRun]) -> str:
    """Shares within the requirement move by move, in words; empty where there is one move."""
    least = min(len(r.error_um) for r in runs)
    shares = [np.mean([_within(r.error_um[k], row.requirement_um) for r in runs]) for k in range(least)]
    return f"after each move {', '.join(f'{100.0 * s:.1f}' for s in shares)} %" if least > 1 else ""


def _within(error_um: Floats, requirement_um: float) -> float:
    return float(np.mean(error_um <= requirement_um))


def _rms(error_um: Floats) -> float:
    return float(np.sqrt(np.mean(error_um**2)))


def _note(row: Row, runs: Sequence[InstrumentRun]) -> str:
    healthy = sum(len(r.error_um[-1]) for r in runs)
    assigned, every = sum(r.assigned for r in runs), sum(r.positioners for r in runs)
    collisions, contacts = sum(r.collisions for r in runs), sum(r.contacts for r in runs)
    return (
        f"published: {row.published}. {assigned} of {every} positioners had a target, {healthy} of these "
        f"were healthy; {collisions} collisions in verified plans, {contacts} contacts in truth"
    )


COLUMNS = (
    "",
    "units",
    "required",
    "moves",
    "rms",
    "95 %",
    "worst",
    "within",
    "time",
    "CPU",
    "memory",
    "contacts",
    "published",
)


def _three_digits(value: float) -> str:
    return f"{value:.0f}" if value >= 100.0 else f"{value:.3g}"


def _cells(row: Row, runs: Sequence[InstrumentRun]) -> list[str]:
    """A line of the drawn table: means over the runs, the worst of all."""
    last = [r.error_um[-1] for r in runs]
    share = float(np.mean([_within(e, row.requirement_um) for e in last]))

    def mean(values: list[float], unit: str) -> str:
        return f"{_three_digits(float(np.mean(values)))} {unit}"

    return [
        row.name,
        f"{runs[0].positioners}",
        f"{row.requirement_um:g} µm",
        f"{max(len(r.error_um) for r in runs)}",
        mean([_rms(e) for e in last], "µm"),
        mean([float(np.percentile(e, 95)) for e in last], "µm"),
        _three_digits(max(float(e.max()) for e in last)) + " µm",
        f"{100.0 * share:.1f} %",
        mean([r.reconfiguration_s for r in runs], "s"),
        mean([r.cpu_s for r in runs], "s"),
        mean([r.memory_gib for r in runs], "GiB"),
        f"{sum(r.contacts for r in runs)}",
        row.published.replace("; ", "\n"),
    ]


def _draw_table(found: dict[str, list[InstrumentRun]]) -> Drawing:
    canvas, axes = plt.subplots(figsize=(13, 3.6), layout="constrained")
    axes.set_axis_off()
    table = axes.table(
        [_cells(row, found[row.key]) for row in TABLE_1], colLabels=COLUMNS, loc="center", cellLoc="center"
    )
    table.auto_set_font_size(False)
    table.set_fontsize(8.5)
    table.auto_set_column_width(list(range(len(COLUMNS))))
    table.scale(1.0, 2.2)
    for k, row in enumerate(TABLE_1):
        share = min(_within(r.error_um[-1], row.requirement_um) for r in found[row.key])
        table[k + 1, COLUMNS.index("within")].set_facecolor("#cfe8cf" if share >= SHARE else "#f5c6c6")
    return drawing(
        "table",
        f"All six: true errors of healthy fibres after the last move. Green: {100.0 * SHARE:g} % and more "
        "are within the requirement.",
        canvas,
    )


def _draw(found: dict[str, list[InstrumentRun]]) -> Drawing:
    canvas, axes = plt.subplots(figsize=(8, 4.6), layout="constrained")
    for k, row in enumerate(TABLE_1):
        moves = max(len(r.error_um) for r in found[row.key])
        for shift, which, colour in ((-0.18, 0, "tab:blue"), (0.18, -1, "tab:green")):
            if which == -1 and moves == 1:
                continue
            error = np.concatenate([r.error_um[which] for r in found[row.key]])
            jitter = np.linspace(-0.13, 0.13, len(error))
            axes.plot(k + shift + jitter, error, ".", color=colour, markersize=3)
        axes.plot([k - 0.4, k + 0.4], 2 * [row.requirement_um], color="crimson")
    names = [row.name for row in TABLE_1]
    axes.set(yscale="log", ylabel="true error of a fibre [µm]", xticks=range(len(names)))
    axes.set_xticklabels(names)
    axes.grid(True, axis="y", alpha=0.3)
    return drawing(
        "errors",
        "Every dot is a healthy fibre: blue after the blind move, green after the last; red: requirement.",
        canvas,
    )
