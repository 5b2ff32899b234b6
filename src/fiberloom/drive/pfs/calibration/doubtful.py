"""Cobras that by their own calibration cannot be counted on to arrive: they get no targets.

Moves of a motor miss by a normal share, rms s, of their way, and it aims at g = 1 / (1 + s^2) of what is
left (`LearningLaw.aimed_deg`). Phi, which goes out among neighbours, aims at less where it could miss by more
than the room that an assignment leaves beyond a target (`ways_out.leg_share`). Where its map is off by a
share e, a move makes of a distance d the distance d |1 - g (1 + e) (1 + s z)|, z normal: a random walk of
log d, which ends below `REST_SHARE` of what is asked for. From the reach of the arm the walk tells how likely
the fibre is there in the moves that an instrument makes. Cobras below `SURE` are named, and those of which
the calibration says that a motor has failed. What a field brings, or the twin knows, is not asked.
"""

import numpy as np
from numpy.polynomial.hermite_e import hermegauss
from scipy.special import ndtr

from fiberloom.drive.pfs.calibration.maps import ODD_STEPS
from fiberloom.drive.pfs.calibration.measure import STANDS, CobraCalibration
from fiberloom.drive.pfs.drive import CobraSettings
from fiberloom.drive.piezo.cobras import CobraArms, stops_deg
from fiberloom.drive.piezo.learning import LearningSettings
from fiberloom.drive.piezo.stages import PHI, THETA, StageSettings
from fiberloom.drive.piezo.ways_out import ROOM_DEG, ROOM_OF_SCATTER_DEG, leg_share
from fiberloom.instruments import FocalPlane
from fiberloom.typing import Floats
from fiberloom.units import UM_PER_MM, rad_to_deg

NAMES = ("theta", "phi")
FAILED = (ODD_STEPS, STANDS)
SURE = 0.99
"""[A] A cobra arrives in so many fields, or it is not counted on."""
BEFORE = 2
"""Moves that turn theta and open phi: they bring a fibre no nearer (the published via points are as many)."""
REST_SHARE = CobraSettings.rest_share
"""Of the requirement: a fibre that is believed to be so near stays."""
MAP_OFF = LearningSettings.drift_sigma
"""By so much of a way maps are off at a place, rms, after a calibration."""
NODES = 5
"""Of the mean over what maps are off by: with 9 shares change by less than 0.1 %."""
LOG_STEP = 0.1
"""Of the walk's distances: halved, it changes shares by less than 0.1 %."""
HALVINGS = 14
NOT_AT_STOPS_MM = 0.1
"""[A] A fibre farther from where it is at the stops is not there: nearer, it shows nothing of theta."""


def arriving(scatter: float, reach_mm: float, within_um: float, moves: int, axis: int = PHI) -> float:
    """Share of fields in which a motor of this `scatter`, rms of the way, dimensionless, arrives.

    `reach_mm`: the distance at first; `within_um` of its target a fibre has arrived; `moves`: all of a field,
    the first `BEFORE` bring it no nearer; `axis`: PHI keeps to its room, THETA turns free.
    """
    far = np.log(reach_mm * UM_PER_MM / within_um)
    edges = np.arange(np.log(REST_SHARE), far + np.log(2.0) + LOG_STEP, LOG_STEP)
    middle = 0.5 * (edges[:-1] + edges[1:])
    aim = _aim(scatter, np.exp(middle - far), axis)
    ratio = np.exp(edges[None, :] - middle[:, None])
    off, weight = hermegauss(NODES)
    shares = [_walked(_below(ratio, scatter, aim * (1.0 + MAP_OFF * e)), middle, far, moves) for e in off]
    return float(np.average(shares, weights=weight))


def _aim(scatter: float, distance: Floats, axis: int) -> Floats:
    """(m,) shares of the way that are aimed at, where fibres lack a `distance` (m,), of the reach."""
    if axis == THETA:
        return np.full(len(distance), 1.0 / (1.0 + scatter**2))
    left_deg = rad_to_deg(2.0 * np.arcsin(np.minimum(distance, 1.0)))  # of phi, between two links alike
    told_deg = left_deg / (1.0 + scatter**2)
    room_deg = np.full(len(left_deg), max(ROOM_DEG, ROOM_OF_SCATTER_DEG * scatter))
    tube_deg = StageSettings.sigmas * scatter * told_deg
    return told_deg / left_deg * leg_share(left_deg, told_deg, tube_deg, room_deg)


def _walked(below: Floats, middle: Floats, far: float, moves: int) -> float:
    """Share that arrives in `moves` from log `far`; `below` (m, m + 1): of a move from logs `middle` (m,)."""
    rests, below[:, -1] = below[:, 0].copy(), 1.0  # nothing is farther than twice the reach
    walk, there = np.zeros(len(middle)), 0.0
    walk[np.abs(middle - far).argmin()] = 1.0
    for _ in range(max(moves - BEFORE, 0)):
        there += float(walk @ rests)
        walk = walk @ np.diff(below, axis=1)
    return there + float(walk[middle < 0.0].sum())


def _below(ratio: Floats, scatter: float, aim: Floats) -> Floats:
    """(m, k) share of moves that leave less than a `ratio` (m, k) of the way; they go for `aim` (m,)."""
    goes = aim[:, None]
    out: Floats = ndtr((ratio - 1.0 + goes) / (goes * scatter)) - ndtr(
        (-ratio - 1.0 + goes) / (goes * scatter)
    )
    return out


def most_scatter(reach_mm: float, within_um: float, moves: int, axis: int = PHI) -> float:
    """The largest scatter, rms of the way, dimensionless, of a motor that is counted on (`SURE`).

    `reach_mm`, `within_um`, `moves` and `axis` as of `arriving`.
    """
    low, high = 0.01, 2.0
    for _ in range(HALVINGS):
        middle = 0.5 * (low + high)
        sure = arriving(middle, reach_mm, within_um, moves, axis) >= SURE
        low, high = (middle, high) if sure else (low, middle)
    return low


def doubtful(found: CobraCalibration, plane: FocalPlane, moves: int | None = None) -> dict[int, str]:
    """Cobras, by number, that cannot be counted on to arrive in a field, and why.

    `found` by the calibration of a `plane` of n cobras; `moves` of the field, None: those of its instrument,
    as is the requirement. In fewer moves it is these that do not suffice, and not a motor: it is judged as of
    those of the instrument.
    """
    operation = plane.instrument.operation
    reach_mm = float(np.max(plane.l_alpha_mm + plane.l_beta_mm))
    moves = max(1 + operation.corrections_max, moves or 0)
    limits = [most_scatter(reach_mm, operation.requirement_um, moves, axis) for axis in (THETA, PHI)]
    why: dict[int, str] = {}
    for motor, (scatter, reason) in enumerate(
        zip(found.motors.scatter.tolist(), found.motors.reason, strict=True)
    ):
        row, axis = divmod(motor, 2)
        if reason in FAILED:
            why.setdefault(int(plane.positioner_id[row]), f"{NAMES[axis]}: {reason}")
        elif scatter > limits[axis]:
            most = f"{limits[axis]:.2f} at most can arrive"
            text = f"{NAMES[axis]}: moves miss by {scatter:.2f} of their way, {most}"
            why.setdefault(int(plane.positioner_id[row]), f"{text} in {moves} moves")
    return why


def standing_deg(plane: FocalPlane, xy_mm: Floats) -> Floats:
    """(N, 2) alpha and beta in deg where cobras stand after they have searched their stops.

    `xy_mm` (N, 2) of their fibres in an image then, NaN where not seen. A motor that hardly moves has not
    come to its stop, and its arm may still be out.
    """
    arms, at_stops = CobraArms.of(plane), np.zeros((len(plane), 2))
    off_mm = np.hypot(*(xy_mm - arms.xy_mm(at_stops)).T)
    seen = np.where(np.isfinite(xy_mm), xy_mm, arms.xy_mm(at_stops))
    out = arms.angles_deg(seen, at_stops)
    return stops_deg(plane)[0] + np.where((off_mm > NOT_AT_STOPS_MM)[:, None], out, at_stops)


def left_out(plane: FocalPlane, why: dict[int, str], at_deg: Floats) -> FocalPlane:
    """The `plane` without the cobras of `why` (by number), which stay where they are.

    `at_deg` (N, 2): alpha and beta of all, as of `standing_deg`.
    """
    rows = plane.index_of(np.array(sorted(why), dtype=np.int64))
    return plane.with_offline(sorted(why), at_deg[rows])
