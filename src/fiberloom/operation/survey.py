"""Moving a whole focal plane through configurations for its calibration (Kronig 2020, Section 4.2).

The positioners stay mounted among their neighbours. Every configuration is free of collisions, and every
way to it is planned and verified with arms thicker than they are, because the positions of the arms are
not known yet. The next configuration is the one that reduces the errors of the fit most, given the
measured ones.
"""

from __future__ import annotations

import asyncio
import json
from collections.abc import Callable
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from fiberloom.calibration.fibres.backlit import offsets_of_backlit
from fiberloom.calibration.fibres.offsets import FibreOffsets
from fiberloom.calibration.focal_plane.arms_file import MEASURED_C, save_arms
from fiberloom.calibration.focal_plane.bundle import calibrate_fiducials
from fiberloom.calibration.focal_plane.convergence import convergence
from fiberloom.calibration.focal_plane.design import Design, candidates
from fiberloom.calibration.focal_plane.fiducials import Fiducials
from fiberloom.calibration.focal_plane.fit import (
    N_GEOMETRY,
    FitSettings,
    FocalPlaneFit,
    fit_focal_plane,
    layout_parameters,
)
from fiberloom.calibration.focal_plane.survey_data import SurveyData
from fiberloom.calibration.transmission.maps import TransmissionMaps
from fiberloom.errors import InputError
from fiberloom.hardware import Hardware
from fiberloom.health.status import FibreStatus
from fiberloom.instruments import FocalPlane, write_layout
from fiberloom.operation.care.thermometer import felt, has_thermometer
from fiberloom.operation.motion import ROUND_FAULTS, FieldMotion, MotionMaker
from fiberloom.operation.move import Goals, Move, Recorder
from fiberloom.operation.reference.referencing import reference
from fiberloom.operation.surveying.backlit import Backlit
from fiberloom.operation.surveying.looks import LookBook
from fiberloom.planning.placing import place_by_worth
from fiberloom.report.convergence import plot_convergence
from fiberloom.store import Store
from fiberloom.store.database import Columns
from fiberloom.store.run import START, STOPPED
from fiberloom.typing import Flags, Floats
from fiberloom.wholefile import write_whole

_UNTOLD = frozenset({FibreStatus.LYING, FibreStatus.ASTRAY, FibreStatus.DEAD})
"""Faults with which the motor position is not that of the arms: such measurements are left out."""
_TEMPERATURE = "temperature"
"""Kind of the event that notes it."""


@dataclass(frozen=True)
class SurveySettings:
    """Number of configurations, distance between arms, and settings of the fit."""

    configurations: int = 40
    safety_mm: float = 0.5
    """By which the radius of every arm is larger than the instrument's collision buffer."""
    seed: int = 0
    """Of candidates, places and planner."""
    fit: FitSettings = field(default_factory=FitSettings)
    motion: MotionMaker = FieldMotion
    """Of the field; a session gives its own."""
    rotator_deg: float = 0.0
    """Between the configurations the rotator is turned, over so many deg in all: it tells lens from
    fiducials. 0: it stays, and fiducials are taken to be where their table has them."""
    rotate: Callable[[float], None] = lambda _: None
    """Turns a rotator to so many deg, and returns when it is there; the twin's turns with its camera."""
    backlit: tuple[str, ...] = ()
    """Science fibres that are lit in every configuration, one after the other, to find where they are."""
    lamp: Callable[[str], None] = lambda _: None
    """Lights a science fibre of all positioners from behind, "" none; the twin's is lit with its camera."""


async def survey(
    plane: FocalPlane,
    maps: TransmissionMaps,
    hardware: Hardware,
    settings: SurveySettings,
    recorder: Recorder,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> SurveyData:
    """Measures a field of N positioners in S configurations; then every positioner folds.

    `plane`: the layout so far; `maps`: transmission maps of its positioners; `hardware`: bus and camera;
    `settings`: S, the distance between arms, the seed; `recorder`: keeps every move; `progress`: called
    with the configurations done and S. Returns angles in deg and positions in mm, (N, S, 2). Raises
    InputError where no positioner answers or most fibres are not seen, UnsafePlanError where the verifier
    refuses a plan.
    """
    wide = plane.with_collision_buffer(plane.collision_buffer_mm + settings.safety_mm)
    motion = settings.motion(wide, maps, hardware, recorder, lambda _: None)
    motion.state.looser_mm = settings.safety_mm  # the layout is not known yet; arms are thicker by it
    design, looks = Design(plane, settings.fit), LookBook(hardware.camera, plane)
    science = Backlit(plane, hardware.camera, settings.lamp, settings.backlit)
    turns_deg = settings.rotator_deg * (np.arange(settings.configurations) / settings.configurations - 0.5)
    rng = np.random.default_rng([settings.seed, 0x5A])
    try:
        await motion.connect()
        await reference(motion)
        at_C = await _felt_C(motion)
        for number in range(settings.configurations):
            options = candidates(wide, rng)
            worth = design.worth(options)
            goal = place_by_worth(motion.state.obstacles(), options, worth, settings.seed + number)
            if settings.rotator_deg:
                await asyncio.to_thread(_turn, hardware.camera, settings, turns_deg[number])
            await motion.go(Goals.without_targets(wide, goal), settings.seed)
            theta, xy = _told(motion.moves[-1], maps)
            design.add(np.nan_to_num(theta), np.isfinite(xy[:, 0]))
            looks.keep(number, motion.moves[-1].measurement.images, np.isfinite(xy[:, 0]))
            await science.look(motion, theta)
            progress(number + 1, settings.configurations)
        folded = plane.park_deg
        await motion.go(Goals.without_targets(wide, folded), settings.seed)
        if settings.rotator_deg:
            await asyncio.to_thread(_turn, hardware.camera, settings, 0.0)
    finally:
        looks.close()
        await motion.close()
    told = [_told(move, maps) for move in motion.moves[:-1] if not move.interrupted]
    theta, xy = (np.stack(column, axis=1) for column in zip(*told, strict=True))
    return SurveyData(theta, xy, design.sigma(), looks.looks(), science.apart_mm(), at_C)


def _summary(science: FibreOffsets) -> dict[str, Any]:
    said = science.reason[~science.ok].tolist()
    return {
        "calibrated": int(science.ok.sum()),
        "of": len(science),
        "offset_rms_um": science.rms_um,
        "formal_um": science.formal_um,
        "refused": {reason: said.count(reason) for reason in sorted(set(said))},
    }


def _turn(camera: Any, settings: SurveySettings, turned_deg: float) -> None:
    settings.rotate(turned_deg)
    if (turn := getattr(camera, "turn", None)) is None:
        raise InputError("this camera takes no images: it cannot be turned; leave out --rotator")
    turn(turned_deg)


async def _felt_C(motion: FieldMotion) -> float | None:
    """The temperature of the positioners, which goes on record; None where they do not tell it."""
    instrument = motion.plane.instrument
    if not has_thermometer(instrument):
        return None
    said = await felt(motion.client, instrument)
    motion.recorder.event(_TEMPERATURE, said.why if said.at_C is None else f"{said.at_C:.3f} deg C")
    return said.at_C


def _noted_C(store: Store, run_id: int) -> float | None:
    """What a survey has noted of it."""
    rows = store.events(run_id)
    said = rows["text"][rows["kind"] == _TEMPERATURE]
    return float(said[0].split()[0]) if len(said) and said[0].endswith("deg C") else None


def survey_of_store(store: Store, plane: FocalPlane, maps: TransmissionMaps) -> SurveyData:
    """The measurements of the last run of a store, also of one that was interrupted or killed.

    `plane` and `maps`: of the N positioners of that run. Raises InputError where the store has no run, or
    its last run no measurement.
    """
    runs = [run for run in store.runs() if run.n_measurements]
    if not runs:
        raise InputError(f"{store.name}: no run in it; 'fiberloom calibrate focal-plane' makes one")
    rows = store.measurements(runs[-1].id)
    # what was reported before the field was referenced is off by motor turns
    begun = rows["move_id"][rows["kind"] == START].max(initial=0)
    seen = (rows["kind"] != STOPPED) & (rows["move_id"] >= begun)
    rows = {name: column[seen] for name, column in rows.items()}
    moves, first = np.unique(rows["move_id"], return_index=True)
    kinds = rows["kind"][first]
    # a move before one round faults was stopped before its end
    whole = np.append([not kind.startswith(ROUND_FAULTS) for kind in kinds[1:]], True)
    told = [_stored(rows, rows["move_id"] == m, plane, maps) for m in moves[whole]]
    if not told:
        raise InputError(f"{store.name}: its last run has measured nothing")
    theta, xy = (np.stack(column, axis=1) for column in zip(*told, strict=True))
    sigma = np.full((plane.n, N_GEOMETRY), np.nan)
    return SurveyData(theta, xy, sigma, at_C=_noted_C(store, runs[-1].id))


def _stored(rows: Columns, move: Flags, plane: FocalPlane, maps: TransmissionMaps) -> tuple[Floats, Floats]:
    """As `_told`, from the rows of one move."""
    theta, xy = np.full((plane.n, 2), np.nan), np.full((plane.n, 2), np.nan)
    at = plane.index_of(rows["positioner_id"][move])
    wire = np.column_stack([rows["wire_alpha_deg"][move], rows["wire_beta_deg"][move]])
    theta[at] = maps.to_output(wire, index=at)
    good = rows["seen"][move].astype(bool) & ~np.isin(rows["status"][move], [s.value for s in _UNTOLD])
    seen = np.column_stack([rows["x_mm"][move], rows["y_mm"][move]])
    xy[at] = np.where(good[:, None], seen, np.nan)
    return theta, xy


def _told(move: Move, maps: TransmissionMaps) -> tuple[Floats, Floats]:
    """Angles in deg and positions in mm (N, 2) of a move; positions NaN where they are left out."""
    theta_deg = maps.to_output(move.wire_deg)
    untold = np.array([status in _UNTOLD for status in move.status])
    seen = move.measurement.seen & ~untold
    return theta_deg, np.where(seen[:, None], move.measurement.xy_mm, np.nan)


@dataclass(frozen=True)
class FocalPlaneCalibration:
    """Centre, arms and zeros of all positioners, as measured where they are mounted."""

    guess: FocalPlane
    """The layout before."""
    fit: FocalPlaneFit
    convergence: list[dict[str, Any]]
    """Errors in um by number of configurations."""
    marks: dict[str, Any]
    """Version, seed, instrument, configuration hash, UTC."""
    camera_um: float
    """Noise of the camera, 2-D rms."""
    fiducials: Fiducials | None = None
    """Where they really are; None: as their table has them."""
    science: FibreOffsets | None = None
    """Of the fibres that were lit; None: none was."""

    @classmethod
    def of(
        cls,
        guess: FocalPlane,
        data: SurveyData,
        settings: SurveySettings,
        marks: dict[str, Any],
        truth: FocalPlane | None = None,
    ) -> FocalPlaneCalibration:
        """Fits centre, arms and zeros to the measurements of a survey (Eq. 26).

        `guess`: layout of the N positioners, within 0.2 mm and 1 deg of the truth; `data`: (N, S, 2)
        angles in deg and positions in mm; `settings`: of the fit; `marks`: for the files; `truth`: the
        true layout of a twin, for the errors of the fit. A positioner that cannot be calibrated keeps
        the guess, with a reason in `fit`.
        """
        fit = fit_focal_plane(guess, data.theta_deg, data.xy_mm, settings.fit)
        fiducials: Fiducials | None = None
        if settings.rotator_deg and data.looks is not None and guess.instrument.camera is not None:
            table_um = guess.instrument.camera.fiducial_sigma_um
            fiducials, xy_mm = calibrate_fiducials(guess, fit, data.theta_deg, data.looks, table_um)
            data = replace(data, xy_mm=xy_mm)
            fit = fit_focal_plane(guess, data.theta_deg, xy_mm, settings.fit)
        science = None
        if data.apart_mm:
            science = offsets_of_backlit(fit.plane(guess), data.theta_deg, data.apart_mm)
        true = None if truth is None else layout_parameters(truth)
        rows = convergence(guess, data, settings.fit, true)
        warm = {} if data.at_C is None else {MEASURED_C: data.at_C}
        return cls(guess, fit, rows, marks | warm, settings.fit.camera_um, fiducials, science)

    @property
    def plane(self) -> FocalPlane:
        """The layout as calibrated."""
        arms = self.fit.plane(self.guess)
        return arms if self.fiducials is None else self.fiducials.applied(arms)

    def summary(self) -> dict[str, Any]:
        """The content of focal_plane.json."""
        fit = self.fit
        refused = {int(p): r for p, r in zip(fit.positioner_id, fit.reason, strict=True) if r}
        return (
            self.marks
            | {
                "positioners": self.guess.n,
                "calibrated": int(fit.ok.sum()),
                "refused": refused,
                "lowest_rank": int(fit.rank.min()),
                "parameters": fit.parameters.shape[1],
                "outliers": int(fit.n_outliers.sum()),
                "residual_rms_um": float(np.sqrt((fit.rms_um[fit.ok] ** 2).mean())) if fit.ok.any() else None,
                "angles_mdeg": [1e3 * a for a in fit.angles_deg],
                "convergence": self.convergence,
            }
            | ({} if self.fiducials is None else {"fiducials": self.fiducials.summary()})
            | ({} if self.science is None else {"science_fibres": _summary(self.science)})
        )

    def save(self, out: Path) -> None:
        """Writes arms, layout, figure and focal_plane.json into a folder that exists."""
        known = {} if self.fiducials is None else self.fiducials.to_meta()
        save_arms(out / "arms.ecsv", self.fit, self.marks | known)
        write_layout(self.plane, out / "layout")
        if self.science is not None:
            self.science.write(out / "fibres.ecsv", self.marks)
        plot_convergence(out / "convergence.png", self.convergence, self.guess.n, self.camera_um)
        write_whole(out / "focal_plane.json", json.dumps(self.summary(), indent=2) + "\n")
