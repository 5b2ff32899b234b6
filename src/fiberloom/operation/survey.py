"""Driving a whole focal plane through configurations for its calibration (Kronig 2020, Section 4.2).

The positioners stay where they are mounted, among their neighbours: every configuration is one that all
can stand in, and every way there is planned and verified, with arms taken to be thicker than they are,
because where the arms are is what is not known yet. Each next configuration is the one that tells most
after those that were measured.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from fiberloom.assignment import Assignment
from fiberloom.calibration.focal_plane.design import Design, candidates
from fiberloom.calibration.focal_plane.fit import N_GEOMETRY, FitSettings
from fiberloom.calibration.focal_plane.survey_data import SurveyData
from fiberloom.calibration.transmission.maps import TransmissionMaps
from fiberloom.errors import InputError
from fiberloom.hardware import Hardware
from fiberloom.health.status import Status
from fiberloom.instruments import FocalPlane
from fiberloom.operation.loop import ROUND_FAULTS, Loop, LoopSettings, Move, Recorder
from fiberloom.planning.placing import place_by_worth
from fiberloom.store import Store
from fiberloom.store.database import Columns
from fiberloom.typing import Floats

_UNTOLD = frozenset({Status.LYING, Status.ASTRAY, Status.DEAD})
"""Their motors do not say where the arms are: nothing to be learnt of the arms."""


@dataclass(frozen=True)
class SurveySettings:
    """How many configurations, and how wide the berth."""

    configurations: int = 40
    safety_mm: float = 0.5
    """By which every arm's radius is larger than the instrument's collision buffer."""
    seed: int = 0
    fit: FitSettings = field(default_factory=FitSettings)


async def survey(
    plane: FocalPlane,
    maps: TransmissionMaps,
    hardware: Hardware,
    settings: SurveySettings,
    recorder: Recorder,
    progress: Callable[[int, int], None] = lambda done, total: None,
) -> SurveyData:
    """Moves and looks, `configurations` times; then everybody folds."""
    wide = plane.with_collision_buffer(plane.collision_buffer_mm + settings.safety_mm)
    loop = Loop(wide, _goals(wide, wide.offline_position_deg), maps, hardware, _one_move(settings), recorder)
    design = Design(plane, settings.fit)
    rng = np.random.default_rng([settings.seed, 0x5A])
    try:
        await loop.connect()
        for number in range(settings.configurations):
            options = candidates(wide, rng)
            goal = place_by_worth(loop.obstacles(), options, design.worth(options), settings.seed + number)
            await _visit(loop, goal)
            theta, xy = _told(loop.moves[-1], maps)
            design.add(np.nan_to_num(theta), np.isfinite(xy[:, 0]))
            progress(number + 1, settings.configurations)
        folded = np.tile(plane.instrument.positioner.park_deg, (plane.n, 1))
        await _visit(loop, folded)
    finally:
        await loop.client.close()
    told = [_told(move, maps) for move in loop.moves[:-1] if not move.interrupted]
    theta, xy = (np.stack(column, axis=1) for column in zip(*told, strict=True))
    return SurveyData(theta, xy, design.sigma())


def survey_of_store(store: Store, plane: FocalPlane, maps: TransmissionMaps) -> SurveyData:
    """What the last run of a store has measured: also one that was interrupted or killed."""
    runs = [run for run in store.runs() if run.n_moves]
    if not runs:
        raise InputError(f"{store.name}: no run in it; 'fiberloom calibrate focal-plane' makes one")
    rows = store.measurements(runs[-1].id)
    moves, first = np.unique(rows["move_id"], return_index=True)
    kinds = rows["kind"][first]
    # a move that was followed by a way round faults had been stopped before its end
    whole = np.append([not kind.startswith(ROUND_FAULTS) for kind in kinds[1:]], True)
    told = [_stored(rows, rows["move_id"] == m, plane, maps) for m in moves[whole]]
    if not told:
        raise InputError(f"{store.name}: its last run has measured nothing")
    theta, xy = (np.stack(column, axis=1) for column in zip(*told, strict=True))
    return SurveyData(theta, xy, np.full((plane.n, N_GEOMETRY), np.nan))


def _stored(
    rows: Columns, move: NDArray[np.bool_], plane: FocalPlane, maps: TransmissionMaps
) -> tuple[Floats, Floats]:
    """As `_told`, from the rows of one move."""
    theta, xy = np.full((plane.n, 2), np.nan), np.full((plane.n, 2), np.nan)
    at = plane.index_of(rows["positioner_id"][move])
    wire = np.column_stack([rows["wire_alpha_deg"][move], rows["wire_beta_deg"][move]])
    theta[at] = maps.to_output(wire, index=at)
    good = rows["seen"][move].astype(bool) & ~np.isin(rows["status"][move], [s.value for s in _UNTOLD])
    seen = np.column_stack([rows["x_mm"][move], rows["y_mm"][move]])
    xy[at] = np.where(good[:, None], seen, np.nan)
    return theta, xy


def _one_move(settings: SurveySettings) -> LoopSettings:
    return LoopSettings(moves=1, seed=settings.seed)


async def _visit(loop: Loop, goal_deg: Floats) -> None:
    loop.assignment = _goals(loop.plane, goal_deg)
    await loop.blind_move()


def _goals(plane: FocalPlane, goal_deg: Floats) -> Assignment:
    """Goals without targets."""
    n = plane.n
    return Assignment(
        target=np.full(n, -1),
        fibre=np.full(n, ""),
        alpha_deg=goal_deg[:, 0],
        beta_deg=goal_deg[:, 1],
        approach_deg=np.full(n, max(axis.approach_deg for axis in plane.instrument.axes)),
        clearance_mm=np.full(n, np.inf),
        unassigned={},
        notes=[],
    )


def _told(move: Move, maps: TransmissionMaps) -> tuple[Floats, Floats]:
    """Angles and positions (N, 2) of a move, NaN for whoever tells nothing."""
    theta_deg = maps.to_output(move.wire_deg)
    untold = np.array([status in _UNTOLD for status in move.status])
    seen = move.measurement.seen & ~untold
    return theta_deg, np.where(seen[:, None], move.measurement.xy_mm, np.nan)
