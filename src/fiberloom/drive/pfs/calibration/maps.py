"""Motor maps from moves of known steps (ics_cobraCharmer, calculus: the weighting of bins).

A move of N steps that makes a way w touches some bins. Each of these gets its speed w / N with the weight
f = (part of the way in the bin)^2 / w. With a map known before, it is the ratio of w to what that map
says that is averaged so, and the shape within a move stays as it was known. Moves that begin or end within
5 deg of a stop do not count, and bins that no move has touched get the nearest that has.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from fiberloom.drive.piezo import FORWARD, REVERSE, MotorMaps, pulse_factor
from fiberloom.typing import Flags, Floats, Ints

NEAR_STOP_DEG = 5.0
FEWEST_MOVES = 3
"""That count, in each direction, for a map to be believed."""
LEAST_STEP_DEG, MOST_STEP_DEG = 0.003, 0.6
"""[A] A motor that is slower or faster has failed."""
ODD_STEPS = f"steps are not between {LEAST_STEP_DEG:g} and {MOST_STEP_DEG:g} deg"
LEAST_RATIO, MOST_RATIO = 0.05, 20.0
UNIT_SD, HERE_SD = 0.2, 0.1
"""[A] How far maps were off before, of a motor and direction, and of a place beside that."""


@dataclass(frozen=True, eq=False)
class MapFit:
    """Maps of M motors, and how good they are."""

    maps: MotorMaps
    scatter: Floats
    """(M,) of a move about its map, as a share of its way; NaN where it was not seen twice."""
    reason: list[str]
    """(M,) why the map of a motor is not a new one; empty: it is."""


@dataclass(frozen=True, eq=False)
class Moves:
    """K moves of M motors, and where they were seen."""

    steps: Ints
    """(K, M) signed."""
    pulse_us: Floats
    """(K, M)."""
    places_deg: Floats
    """(K + 1, M) from the counter-clockwise stop; NaN where not seen."""
    passes: int = 1
    """The same moves so often."""


def fit_maps(before: MotorMaps, curve_us: Floats, moves: Moves, range_deg: Floats) -> MapFit:
    """New maps of M motors.

    `before`: maps that were known, or flat ones; `curve_us` (M,): p1 of their pulses; `moves` that were
    made; `range_deg` (M,): from stop to stop, inf where it is not known.
    """
    start, way, sent = _joined(moves.steps, moves.places_deg)
    moved = _counts(start, way, range_deg) & (sent * way > 0.0)
    pulse_us = moves.pulse_us
    step_deg, reason = before.step_deg.copy(), [""] * before.motors
    ratios, by_direction = np.full(way.shape, np.nan), []
    for direction in (FORWARD, REVERSE):
        rows = np.arange(before.motors)
        factor = pulse_factor(pulse_us, before.pulse_us[rows, direction], curve_us)
        known = np.nan_to_num(start)
        told = np.array([before.way_deg(s, n) for s, n in zip(known, sent * factor, strict=True)])
        use = moved & ((way < 0.0) == (direction == REVERSE)) & (told * way > 0.0)
        ratio = np.where(use, way / np.where(use, told, 1.0), np.nan)
        ratios = np.where(use, ratio, ratios)
        by_direction.append(ratio)
    scatter = _scatter(ratios, moves.passes)
    for direction, ratio in zip((FORWARD, REVERSE), by_direction, strict=True):
        found, bad = _bins(before, start, way, ratio)
        believed = _believed(found, way, ratio, scatter, moves.passes)
        step_deg[:, direction] = before.step_deg[:, direction] * believed
        for row in np.flatnonzero(bad):
            way_name = ("forward", "reverse")[direction]
            reason[row] = reason[row] or f"fewer than {FEWEST_MOVES} moves {way_name} count"
    reason = _odd(step_deg, reason)
    kept = np.array([bool(r) for r in reason])
    step_deg[kept] = before.step_deg[kept]
    return MapFit(MotorMaps(step_deg, before.bin_deg, before.pulse_us), scatter, reason)


def _believed(found: Floats, way: Floats, ratio: Floats, scatter: Floats, passes: int) -> Floats:
    """(M, B) ratios of bins as far as a motor's `scatter` (M,) lets them be believed; NaN: as `found`.

    A bin has few moves, the mean of a motor many; both are weighed against how far maps are usually off.
    """
    known = np.isfinite(ratio)
    count = np.maximum(known.sum(axis=0), 1)
    # by how far they went: a slow place has many moves and says nothing of the others
    weight = np.where(known, np.abs(way), 0.0)
    mean = (weight * np.nan_to_num(ratio)).sum(axis=0) / np.maximum(weight.sum(axis=0), 1e-9)
    share = UNIT_SD**2 / (UNIT_SD**2 + np.square(scatter) / count)
    motor = np.where(known.any(axis=0), 1.0 + share * (mean - 1.0), 1.0)[:, None]
    here = (HERE_SD**2 / (HERE_SD**2 + np.square(scatter) / passes))[:, None]
    return np.where(np.isfinite(here), motor * (1.0 + here * (found / motor - 1.0)), found)


def _joined(steps: Ints, places: Floats) -> tuple[Floats, Floats, Floats]:
    """Start, way and steps (K, M) of moves; a place that was not seen joins the two moves beside it."""
    start, sent = places[:-1].copy(), steps.astype(np.float64)
    for k in range(1, len(start)):
        gone = np.isnan(start[k]) & (np.sign(sent[k]) == np.sign(sent[k - 1]))
        start[k] = np.where(gone, start[k - 1], start[k])
        sent[k] = np.where(gone, sent[k] + sent[k - 1], sent[k])
    return start, places[1:] - start, sent


def _counts(start: Floats, way: Floats, range_deg: Floats) -> Flags:
    """(K, M) moves that neither begin nor end beside a stop."""
    low, high = np.minimum(start, start + way), np.maximum(start, start + way)
    counts: Flags = (low > NEAR_STOP_DEG) & (high < range_deg - NEAR_STOP_DEG)
    return counts


def _bins(before: MotorMaps, start: Floats, way: Floats, ratio: Floats) -> tuple[Floats, Flags]:
    """(M, B) ratios to the map before, and (M,) motors with too few moves."""
    edges = before.bin_deg * np.arange(before.step_deg.shape[2] + 1)
    weight, total = np.zeros((2, before.motors, len(edges) - 1))
    for begin, length, one in zip(start, way, ratio, strict=True):
        low, high = np.minimum(begin, begin + length)[:, None], np.maximum(begin, begin + length)[:, None]
        part = np.clip(np.minimum(high, edges[1:]) - np.maximum(low, edges[:-1]), 0.0, None)
        used = np.isfinite(one)
        f = np.where(used[:, None], part**2, 0.0) / np.where(used, np.abs(length), 1.0)[:, None]
        weight += f
        total += f * np.where(used, one, 0.0)[:, None]
    found = np.where(weight > 0.0, total / np.where(weight > 0.0, weight, 1.0), np.nan)
    few = (np.isfinite(ratio).sum(axis=0) < FEWEST_MOVES) | np.isnan(found).all(axis=1)
    found[few] = 1.0
    return np.clip(_with_nearest(found), LEAST_RATIO, MOST_RATIO), few


def _with_nearest(found: Floats) -> Floats:
    """(M, B) with each empty bin as the nearest that is not."""
    out = found.copy()
    places = np.arange(found.shape[1])
    for row in np.flatnonzero(np.isnan(found).any(axis=1)):
        known = np.flatnonzero(np.isfinite(found[row]))
        nearest = known[np.abs(places[:, None] - known[None, :]).argmin(axis=1)]
        out[row] = found[row, nearest]
    return out


def _odd(step_deg: Floats, reason: list[str]) -> list[str]:
    """With those motors named whose steps are no steps."""
    mean = step_deg.mean(axis=2)
    odd = np.any((mean < LEAST_STEP_DEG) | (mean > MOST_STEP_DEG), axis=1)
    return [r or (ODD_STEPS if o else "") for r, o in zip(reason, odd, strict=True)]


def _scatter(ratios: Floats, passes: int) -> Floats:
    """(M,) rms by which moves of one pass differ from the same of the others, of their ratio."""
    if passes < 2:
        return np.full(ratios.shape[1], np.nan)
    by_pass = ratios.reshape(passes, -1, ratios.shape[1])
    seen = np.isfinite(by_pass)
    mean = np.where(seen, by_pass, 0.0).sum(axis=0) / np.maximum(seen.sum(axis=0), 1)
    off2 = np.where(seen, (by_pass / np.where(mean == 0.0, 1.0, mean) - 1.0) ** 2, 0.0)
    free = (seen.sum(axis=0) - 1).clip(min=0).sum(axis=0)
    spread: Floats = np.sqrt(off2.sum(axis=(0, 1)) / np.maximum(free, 1))
    return np.where(free > 0, spread, np.nan)
