"""The lifetime test of Kronig 2020, Section 4.3, on the statistical twin.

A cycle is 15260 moves: an automatic calibration, then random targets, each approached blind and
corrected nine times by Eq. 25. (244 targets five times, as in Fig. 19, are 12200 moves; they leave 3060
for the calibration. How the paper splits them it does not say. Targets here are 1220 different ones.)
Five ways to know the gear make the same blind moves on the same worn units:

- linear: the nominal ratio and one offset per axis;
- fixed: the map calibrated in the first cycle;
- adaptive_paper: that map, then Eq. 27 to 33 as printed;
- adaptive: that map, then the improved estimator;
- recalibrated: a map calibrated in every cycle;

and beside them, recalibrated_fine: the same with four times the points, as dense as the knots of the
improved estimator.

`lifetime` is an experiment for `fiberloom.studies.campaign`.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np
from numpy.typing import ArrayLike

from fiberloom.calibration import SweepSettings
from fiberloom.calibration.adaptive.calibration import AdaptiveCalibration, AdaptiveSettings
from fiberloom.calibration.transmission.evaluate import CalibrationReport, evaluate
from fiberloom.calibration.transmission.maps import Provenance, TransmissionMaps
from fiberloom.errors import InputError
from fiberloom.instruments import METROLOGY, FocalPlane
from fiberloom.instruments.arms import CENTRE, L_ALPHA
from fiberloom.operation.correction import plain_update
from fiberloom.twin.bench import bench_units
from fiberloom.twin.errors.switches import GearSpectrum
from fiberloom.twin.faults.ailments import chosen_ailments, loosened
from fiberloom.twin.noise import UnitNoise
from fiberloom.twin.statistical import StatisticalTwin, sweeps
from fiberloom.twin.wear import Wear, WearModel
from fiberloom.typing import Array, Floats, Ints
from fiberloom.units import GEAR, MM_PER_UM, UM_PER_MM, deg_to_rad, rad_to_deg

WAYS = ("linear", "fixed", "adaptive_paper", "adaptive", "recalibrated", "recalibrated_fine")
DELTAS = ("true", "recalibrated", "adaptive", "adaptive_paper")
"""Curves of delta that are kept: Fig. 22 and 25."""
MOVES_PER_CYCLE = 15260
DELTA_POINTS = 361
FINER = 4
_LEARNT = (0,)
"""Images of an approach that the adaptive ways learn from: that of the blind move. Those of the nine
corrections end micrometres beside it and would tell nearly the same again."""
_CLEAR_MM = 0.1
"""Targets keep this far from the ends of the reach."""


@dataclass(frozen=True)
class LifetimeSettings:
    """What a lifetime test does."""

    instrument: str = "sdssv"
    cycles: int = 100
    points: int = 200
    """Of a calibration, per axis and direction."""
    repeats: int = 3
    """Sweeps of a calibration, averaged."""
    approaches: int = 1220
    """Targets a cycle."""
    corrections: int = 9
    batch: int = 244
    """Approaches between two updates of the adaptive maps: a night's, say."""
    cycle_step: int = 1
    """Every so many cycles are simulated; wear goes on in between."""
    snapshots: tuple[int, ...] = (1, 10, 50, 100)
    """Cycles whose delta is kept."""
    wear: WearModel = field(default_factory=WearModel)
    gears: GearSpectrum = "stages"
    """Which orders the gears have: the ripple that a map of so many points cannot see depends on it."""
    faults: str = ""
    """Ailments of the first units, "kind=count,..."; a unit that no longer follows its commands drops out."""
    fault_cycle: int = 0
    """When they begin; 0: half-way."""

    def __post_init__(self) -> None:
        for name in ("cycles", "repeats", "approaches", "batch", "cycle_step"):
            if getattr(self, name) < 1:
                raise InputError(f"lifetime: {name} = {getattr(self, name)}, must be at least 1")

    @property
    def simulated(self) -> Ints:
        """Cycles that are simulated: the first and the last among them."""
        return np.unique(np.append(np.arange(1, self.cycles + 1, self.cycle_step), self.cycles))

    @property
    def breaks(self) -> int:
        """Move at which ailments begin."""
        return MOVES_PER_CYCLE * (self.fault_cycle or max(self.cycles // 2, 1))

    @property
    def kept(self) -> list[int]:
        """Snapshots that are simulated."""
        return [c for c in self.snapshots if c in self.simulated]


class MotorMap(Protocol):
    """What turns angles into wire positions."""

    def to_wire(self, theta_deg: ArrayLike, index: ArrayLike | None = None) -> Floats:
        """Wire positions (N, 2, M) in deg for output angles."""
        ...


def lifetime(units: range, seed: int, settings: LifetimeSettings) -> dict[str, Array]:
    """Rows of a campaign, one for each unit.

    (N, ways, cycles) `measured_um` and `true_um`, rms of the blind moves, and `corrected_um`, true rms
    after the last correction; (N, cycles, 2) `arms_mm` as calibrated and `true_arms_mm`: alpha, beta;
    (N, snapshots, curves, 2 axes, points) `delta_deg` at `delta_angles_deg`.
    """
    test = _Test(units, seed, settings)
    for k, cycle in enumerate(settings.simulated):
        test.cycle(k, int(cycle))
    return test.rows


def delta_angles_deg(plane: FocalPlane) -> Floats:
    """(2, points) output angles at which delta is kept."""
    low, high = plane.limits_deg.T
    return np.linspace(low, high, DELTA_POINTS, axis=1)


class _Test:
    """The state of a chunk of units through its cycles."""

    def __init__(self, units: range, seed: int, settings: LifetimeSettings) -> None:
        self.settings = settings
        self.layout, new = bench_units(settings.instrument, seed, units, settings.gears)
        self.wear = Wear(new, seed, settings.wear)
        self.ailments = chosen_ailments(new, seed, settings.faults, settings.breaks)
        self.loose = UnitNoise(seed, 0x1005, new.number)
        self.twin = StatisticalTwin(self.layout, new, seed=seed)
        self.targets = UnitNoise(seed, 0x7A26, new.number)
        self.camera = UnitNoise(seed, 0xCA3E, new.number)
        self.sigma_mm = self.layout.instrument.metrology.noise_rms_um * MM_PER_UM / np.sqrt(2.0)
        self.learners: dict[str, AdaptiveCalibration] = {}
        n, c = len(new), len(settings.simulated)
        self.rows: dict[str, Array] = {
            name: np.full((n, len(WAYS), c), np.nan) for name in ("measured_um", "true_um", "corrected_um")
        }
        self.rows |= {name: np.empty((n, c, 2)) for name in ("arms_mm", "true_arms_mm")}
        self.rows["delta_deg"] = np.empty((n, len(settings.kept), len(DELTAS), 2, DELTA_POINTS))

    def cycle(self, k: int, cycle: int) -> None:
        """Calibration, then targets."""
        self.move = cycle * MOVES_PER_CYCLE
        ill = self.ailments.units_at(self.wear.at(cycle), self.move)
        self.twin.set_units(ill)
        maps, plane, report = calibrate(self.twin, self.settings, self.look)
        if k == 0:
            self.first, self.first_plane = maps, plane
            self.learners = {
                "adaptive_paper": AdaptiveCalibration(plane, maps, AdaptiveSettings(method="paper")),
                "adaptive": AdaptiveCalibration(plane, maps, AdaptiveSettings()),
            }
        target = self._draw_targets()
        fine = replace(self.settings, points=FINER * self.settings.points, repeats=1)
        ways: dict[str, tuple[MotorMap, FocalPlane]] = {
            "linear": (self.first.linear(), self.first_plane),
            "fixed": (self.first, self.first_plane),
            "recalibrated": (maps, plane),
            "recalibrated_fine": calibrate(self.twin, fine, self.look)[:2],
        }
        for name, (source, known) in ways.items():
            self._book(name, k, self._approach(source, known, target, corrections=0))
        for name, learner in self.learners.items():
            self._book(name, k, self._learn(learner, target))
        self._note(k, cycle, maps, report)
        out = self.ailments.out_at(ill, self.move)
        for name in ("measured_um", "true_um", "corrected_um"):
            self.rows[name][out, :, k] = np.nan

    def look(self, xy_mm: Floats) -> Floats:
        """What the camera makes of (N, 2, ...) true positions."""
        seen: Floats = xy_mm + self.sigma_mm * self.camera.normal(*xy_mm.shape[1:])
        return seen

    def _draw_targets(self) -> Floats:
        """(N, 2, M) mm, evenly over the area that the metrology fibre reaches."""
        l_alpha, l_beta = _lengths_mm(self.layout)
        low, high = np.abs(l_alpha - l_beta) + _CLEAR_MM, l_alpha + l_beta - _CLEAR_MM
        share, turn = np.moveaxis(self.targets.uniform(2, self.settings.approaches), 1, 0)
        reach = np.sqrt(low[:, None] ** 2 + share * (high**2 - low**2)[:, None])
        off = reach[:, None] * np.stack([np.cos(2 * np.pi * turn), np.sin(2 * np.pi * turn)], axis=1)
        target: Floats = self.layout.centres_mm[..., None] + off
        return target

    def _approach(
        self, source: MotorMap, plane: FocalPlane, target_mm: Floats, corrections: int
    ) -> _Approach:
        """Blind moves to (N, 2, M) targets, and corrections by Eq. 25; all images, (moves, N, 2, M)."""
        command, made = target_mm, []
        for _ in range(1 + corrections):
            wire = source.to_wire(angles_deg(plane, command))
            true = self._rest(wire)
            measured = self.look(true)
            made.append((wire, true, measured))
            command = plain_update(command, target_mm, measured)
        wires, trues, seen = (np.stack(column) for column in zip(*made, strict=True))
        return _Approach(target_mm, wires, trues, seen)

    def _rest(self, wire_deg: Floats) -> Floats:
        """(N, 2, M) mm: where the metrology fibres come to rest."""
        theta = self.twin.stand(wire_deg)
        longer = self.ailments.loose_mm_at(self.move)[:, None] * self.loose.normal(theta.shape[2])
        return loosened(self.twin.units, self.twin.fibre_xy(METROLOGY, theta), theta, longer)

    def _learn(self, learner: AdaptiveCalibration, target_mm: Floats) -> _Approach:
        """Batch by batch: approach with the maps as they are, then learn."""
        s, parts = self.settings, []
        for first in range(0, target_mm.shape[-1], s.batch):
            batch = target_mm[..., first : first + s.batch]
            made = self._approach(learner, learner.plane, batch, s.corrections)
            learner.update(*made.learnt(), moves=made.moves * s.cycle_step)
            parts.append(made)
        return _Approach.joined(parts)

    def _book(self, name: str, k: int, made: _Approach) -> None:
        way = WAYS.index(name)
        self.rows["measured_um"][:, way, k] = _rms_um(made.measured_mm[0] - made.target_mm)
        self.rows["true_um"][:, way, k] = _rms_um(made.true_mm[0] - made.target_mm)
        if len(made.true_mm) > 1:
            self.rows["corrected_um"][:, way, k] = _rms_um(made.true_mm[-1] - made.target_mm)

    def _note(self, k: int, cycle: int, maps: TransmissionMaps, report: CalibrationReport) -> None:
        self.rows["arms_mm"][:, k] = np.column_stack([report.l_alpha_mm, report.l_beta_mm])
        units = self.twin.units
        longer = units.points_mm(self.layout.points[METROLOGY])
        self.rows["true_arms_mm"][:, k] = np.column_stack([units.arms[:, L_ALPHA], np.hypot(*longer.T)])
        if cycle not in self.settings.kept:
            return
        theta = np.broadcast_to(delta_angles_deg(self.layout), (len(units), 2, DELTA_POINTS))
        true_wire = rad_to_deg(self.twin.gears.gear_of(deg_to_rad(theta))) / GEAR
        known = [maps.to_wire(theta), *(self.learners[d].to_wire(theta) for d in DELTAS[2:])]
        place = self.settings.kept.index(cycle)
        self.rows["delta_deg"][:, place] = np.stack([true_wire, *known], axis=1) - theta[:, None]


@dataclass(frozen=True)
class _Approach:
    """Approaches to (N, 2, M) targets: wire positions, true and measured places, (moves, N, 2, M)."""

    target_mm: Floats
    wire_deg: Floats
    true_mm: Floats
    measured_mm: Floats

    @property
    def moves(self) -> int:
        """Of a positioner, in all."""
        return int(self.wire_deg.shape[0] * self.wire_deg.shape[-1])

    def learnt(self) -> tuple[Floats, Floats]:
        """(N, moves, 2) wire positions and images to learn from, in the order of the moves."""
        chosen = sorted({i % len(self.wire_deg) for i in _LEARNT})
        return _in_order(self.wire_deg[chosen]), _in_order(self.measured_mm[chosen])

    @staticmethod
    def joined(parts: list[_Approach]) -> _Approach:
        """One after the other."""
        columns = zip(*((p.target_mm, p.wire_deg, p.true_mm, p.measured_mm) for p in parts), strict=True)
        return _Approach(*(np.concatenate(column, axis=-1) for column in columns))


def _in_order(column: Floats) -> Floats:
    moves, n, _, m = column.shape
    return column.transpose(1, 3, 0, 2).reshape(n, m * moves, 2)


def _rms_um(off_mm: Floats) -> Floats:
    """(N,) 2-D rms over moves of (N, 2, M)."""
    rms: Floats = UM_PER_MM * np.sqrt(np.mean(np.sum(off_mm**2, axis=1), axis=-1))
    return rms


def _lengths_mm(plane: FocalPlane) -> tuple[Floats, Floats]:
    return plane.l_alpha_mm, plane.l_beta_mm


def angles_deg(plane: FocalPlane, xy_mm: Floats) -> Floats:
    """(N, 2, M) arm angles that put the metrology fibres on (N, 2, M) points. Eq. 2."""
    n, _, m = xy_mm.shape
    found = plane.inverse(xy_mm.swapaxes(1, 2).reshape(-1, 2), index=np.repeat(np.arange(n), m))
    return np.stack([found.alpha_deg, found.beta_deg]).reshape(2, n, m).swapaxes(0, 1)


def calibrate(
    twin: StatisticalTwin, settings: LifetimeSettings, look: object = None
) -> tuple[TransmissionMaps, FocalPlane, CalibrationReport]:
    """The automatic calibration of a cycle: maps, and the layout with the lengths it measured."""
    sweep = SweepSettings(settings.points)
    made = [sweeps(twin, sweep, look) for _ in range(settings.repeats)]
    data = replace(made[0], xy_mm=np.mean([m.xy_mm for m in made], axis=0))
    provenance = Provenance(gear=GEAR, note=f"{settings.points} points, {settings.repeats} times")
    _, report = evaluate(twin.plane, data, sweep.seen_at_least, provenance)
    if not report.ok.all():
        row = int(np.argmin(report.ok))
        raise InputError(
            f"lifetime: unit {report.positioner_id[row]} cannot be calibrated: {report.reason[row]}"
        )
    plane = measured_plane(twin.plane, report)
    maps, report = evaluate(plane, data, sweep.seen_at_least, provenance)
    return maps, plane, report


def measured_plane(plane: FocalPlane, report: CalibrationReport) -> FocalPlane:
    """The layout with centres and lengths as a calibration measured them."""
    arms = plane.arms.copy()
    arms[:, CENTRE], arms[:, L_ALPHA] = report.centre_mm, report.l_alpha_mm
    scale = report.l_beta_mm / plane.l_beta_mm
    longer = plane.points[METROLOGY] * (scale - 1.0)[:, None]
    return replace(plane, arms=arms, points={name: xy + longer for name, xy in plane.points.items()})
