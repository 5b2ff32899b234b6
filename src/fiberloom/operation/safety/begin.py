"""The begin check: before anything moves, what positioners report is held against an image.

A positioner moves only where it is certain that it is where it reports. Every other one is an obstacle:
where it is seen, or as large as the whole reach of its arm where it is not.

For each positioner the places that an image could show are weighed (Bayes):

    right       as reported, within the scatter of the maps
    turns       off by whole motor turns of one axis: counts lost where the hall sensors were read anew
    datum       one axis anywhere, the other as reported: its datum is wrong
    swapped     as another one reports, and that one as this: two numbers on the bus exchanged
    elsewhere   anywhere within reach

The name with the highest probability is told to the operator. Whether it may move is another question: how
far its arm may be from where it reports, anywhere on its way. The miss that is seen now grows with the
arm stretched, since a wrong alpha turns the whole arm.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

import numpy as np
from scipy.spatial import cKDTree

from fiberloom.instruments import FocalPlane
from fiberloom.instruments.axis import DriveTable
from fiberloom.metrology import Measurement
from fiberloom.operation.safety.seen import SCATTER_MM, where_seen
from fiberloom.planning import Plan, Trajectory, verify
from fiberloom.planning.bodies import travel_rad
from fiberloom.typing import Flags, Floats, Ints
from fiberloom.units import rad_to_deg

ALLOWED_MM = DriveTable().allowed_mm
"""How far an arm may be from where it reports, where no instrument says."""

TURNS = 5
"""Motor turns that are looked at on either side."""

BEYOND_DEG = 2.0
"""Past what plans use of an axis: maps are measured so far, and not farther."""

DEEP_SHARE = 0.5
"""Of the collision buffer: bodies nearer than this share of it cannot be, whatever the calibration."""

PRIOR = {"turns": 2e-3, "datum": 2e-3, "swapped": 1e-3, "elsewhere": 1e-3}
"""Shares of positioners at the begin of a run; the rest is right."""


class Standing(StrEnum):
    """What the begin check says of one positioner."""

    RIGHT = "right"  # seen where it reports
    TURNS = "turns"  # off by whole motor turns
    DATUM = "datum"  # one axis off, the other as reported
    SWAPPED = "swapped"  # it and another one report each other's place
    ELSEWHERE = "elsewhere"  # seen where no simple error puts it
    VOUCHED = "vouched"  # not seen, but its datum was searched since power came on
    DARK = "dark"  # not seen: nothing says that its report is right
    BLIND = "blind"  # seen there, but on its alpha axis, where nothing shows alpha; no datum on record
    UNCLEAR = "unclear"  # spots, but not for certain its own
    SILENT = "silent"  # does not answer; where it is seen, where it is is known
    BEYOND = "beyond"  # seen where it reports, but beyond the range of an axis, where no map holds
    OVERLAPS = "overlaps"  # reports to be where another arm is
    OFFLINE = "offline"  # switched off: where the layout says


NAMED = frozenset({Standing.TURNS, Standing.DATUM, Standing.SWAPPED, Standing.ELSEWHERE})
"""Of positioners that answer and are seen, but are not taken to be where they report."""


@dataclass(frozen=True, eq=False)
class Report:
    """What is known before anything moves. Arrays over N positioners."""

    angles_deg: Floats
    """(N, 2) as reported, through the maps."""
    answered: Flags
    """(N,) which have answered."""
    image: Measurement
    vouched: Flags
    """(N,) datum searched since power came on, and recorded: believed where the fibre is dark."""
    scatter_mm: float = SCATTER_MM
    """Of healthy positioners about where they report, per coordinate."""
    to_stops: bool = False
    """Motors are known as far as their hard stops, at which they may begin; else as far as plans go."""


@dataclass(frozen=True, eq=False)
class Beginning:
    """What the begin check found. Arrays over N positioners."""

    standing: list[Standing]
    probability: Floats
    """(N,) of that standing, among those that the image could show."""
    where_deg: Floats
    """(N, 2) alpha and beta: as reported where certain, else as seen; as reported where neither."""
    certain: Flags
    """(N,) may move."""
    somewhere: Flags
    """(N,) anywhere within reach, as far as is known."""
    text: list[str]
    """For each positioner: what is wrong and what to do; empty where it may move."""

    @property
    def alarms(self) -> list[int]:
        """Rows of those that report the impossible."""
        return [i for i, s in enumerate(self.standing) if s is Standing.OVERLAPS]


def begin_check(
    plane: FocalPlane, report: Report, allowed_mm: float = ALLOWED_MM, layout_mm: float = 0.0
) -> Beginning:
    """Who may move, where the others are, and what to do about them.

    Parameters
    ----------
    plane : FocalPlane
        N positioners.
    report : Report
        Angles in deg as reported, who answered, an image, and whose datum is on record.
    allowed_mm : float
        How far an arm may be from where it reports, anywhere in its range.
    layout_mm : float
        By how much the layout may be off besides, the same wherever an arm points: allowed to those whose
        datum is on record.

    Returns
    -------
    Beginning
        For every positioner its standing, and whether it may move.
    """
    seen_mm = report.image.xy_mm
    reported_mm = plane.forward(*report.angles_deg.T)
    standing, probability, partner = _named(plane, report, reported_mm)
    miss_mm = np.hypot(*(seen_mm - reported_mm).T)
    most_mm = allowed_miss_mm(plane, reported_mm, allowed_mm)
    most_mm = np.where(report.vouched, most_mm + layout_mm, most_mm)
    # so near the alpha axis that nothing can be seen of alpha: the record of its datum has to say it
    blind = most_mm < 3.0 * report.scatter_mm
    near = miss_mm <= np.where(blind, 3.0 * report.scatter_mm, most_mm)
    seen_right = report.answered & report.image.seen & near & (~blind | report.vouched)
    past = _past_range(plane, report)
    for i in range(len(plane)):
        standing[i] = _standing(i, plane, report, seen_right[i], standing[i])
        if near[i] and blind[i] and standing[i] in NAMED:
            standing[i] = Standing.BLIND
        if standing[i] in (Standing.RIGHT, Standing.TURNS, Standing.VOUCHED) and past[i]:
            standing[i] = Standing.BEYOND
    right = np.array([s in (Standing.RIGHT, Standing.VOUCHED) for s in standing])
    certain = right | (seen_right & np.array([s is Standing.TURNS for s in standing]))
    _overlaps(plane, report, standing, certain)
    beyond = np.array([s is Standing.BEYOND for s in standing]) & seen_right
    where_deg, placed = _places(plane, report, certain | beyond)
    placed |= beyond
    still = np.array([s is Standing.OFFLINE for s in standing])
    return Beginning(
        standing=standing,
        probability=probability,
        where_deg=where_deg,
        certain=certain,
        somewhere=~(certain | placed | still),
        text=[
            "" if certain[i] else _text(plane, i, standing[i], miss_mm[i], partner[i])
            for i in range(len(plane))
        ],
    )


def _past_range(plane: FocalPlane, report: Report) -> Flags:
    """(N,) who reports angles that no plan goes to: the elbow on the other side, or past an end."""
    low_deg, high_deg = rad_to_deg(travel_rad(plane)).T
    if report.to_stops:
        low_deg, high_deg = np.moveaxis(plane.stops_of(), -1, 0)
    angles_deg = report.angles_deg
    past: Flags = ((angles_deg < low_deg - BEYOND_DEG) | (angles_deg > high_deg + BEYOND_DEG)).any(axis=1)
    return past


def allowed_miss_mm(plane: FocalPlane, reported_mm: Floats, allowed_mm: float = ALLOWED_MM) -> Floats:
    """(N,) largest miss seen now, in mm, of a positioner that is nowhere off by more than `allowed_mm`.

    A wrong alpha shifts the fibre in proportion to its distance from the alpha axis, and most with the
    arm stretched; near that axis nothing can be seen of it, so nothing is certain beyond the scatter.
    """
    radius_mm = np.hypot(*(reported_mm - plane.centres_mm).T)
    stretched_mm = plane.l_alpha_mm + plane.l_beta_mm
    return np.asarray(allowed_mm * np.minimum(1.0, radius_mm / stretched_mm), dtype=np.float64)


def _standing(row: int, plane: FocalPlane, report: Report, seen_right: bool, named: Standing) -> Standing:
    """What is said of one positioner, once its place is named."""
    if plane.offline[row]:
        return Standing.OFFLINE
    if not report.answered[row]:
        return Standing.SILENT
    if report.image.seen[row]:
        # a name that fits better than `right` does not make a small miss a danger, nor the reverse
        if named is Standing.TURNS:
            return named
        if seen_right:
            return Standing.RIGHT
        return Standing.ELSEWHERE if named is Standing.RIGHT else named
    if report.vouched[row]:
        return Standing.VOUCHED
    unclear = report.image.ambiguous is not None and bool(report.image.ambiguous[row])
    return Standing.UNCLEAR if unclear else Standing.DARK


def _named(plane: FocalPlane, report: Report, reported_mm: Floats) -> tuple[list[Standing], Floats, Ints]:
    """The likeliest hypothesis of each seen positioner, its probability, and its partner (-1: none)."""
    weights = {
        Standing.RIGHT: (1.0 - sum(PRIOR.values()))
        * _normal(report.image.xy_mm - reported_mm, report.scatter_mm),
        Standing.TURNS: PRIOR["turns"] * _turns(plane, report),
        Standing.DATUM: PRIOR["datum"] * _one_axis(plane, report),
        Standing.ELSEWHERE: PRIOR["elsewhere"] / _reach_mm2(plane),
    }
    exchanged, partner = _swapped(plane, report, reported_mm)
    weights[Standing.SWAPPED] = PRIOR["swapped"] * exchanged
    table = np.nan_to_num(np.stack(list(weights.values())))
    best = table.argmax(axis=0)
    names = list(weights)
    share = table.max(axis=0) / np.maximum(table.sum(axis=0), np.finfo(float).tiny)
    return [names[k] for k in best], np.asarray(share), partner


def _normal(miss_mm: Floats, scatter_mm: float) -> Floats:
    """Density (per mm2) of a miss (..., 2) of a place that is known."""
    chi2 = (miss_mm**2).sum(axis=-1) / scatter_mm**2
    return np.asarray(np.exp(-0.5 * chi2) / (2.0 * np.pi * scatter_mm**2))


def _normal_1d(miss_mm: Floats, scatter_mm: float) -> Floats:
    return np.asarray(np.exp(-0.5 * (miss_mm / scatter_mm) ** 2) / (np.sqrt(2.0 * np.pi) * scatter_mm))


def _turns(plane: FocalPlane, report: Report) -> Floats:
    """Mean density over so many motor turns of either axis."""
    steps = np.array([k for k in range(-TURNS, TURNS + 1) if k])
    density = np.zeros(len(plane))
    for column, axis in enumerate(plane.instrument.axes):
        for k in steps:
            angles_deg = report.angles_deg.copy()
            angles_deg[:, column] += k * 360.0 / axis.gear
            density += _normal(report.image.xy_mm - plane.forward(*angles_deg.T), report.scatter_mm)
    return density / (2 * len(steps))


def _one_axis(plane: FocalPlane, report: Report) -> Floats:
    """Density where one axis is anywhere: on the circle about the alpha axis, or about the elbow."""
    seen_mm = report.image.xy_mm
    elbow_mm = plane.elbows_mm(report.angles_deg[:, 0])
    density = np.zeros(len(plane))
    reported_mm = plane.forward(*report.angles_deg.T)
    for about_mm in (plane.centres_mm, elbow_mm):
        radius_mm = np.maximum(np.hypot(*(reported_mm - about_mm).T), report.scatter_mm)
        off_mm = np.hypot(*(seen_mm - about_mm).T) - radius_mm
        density += 0.5 * _normal_1d(off_mm, report.scatter_mm) / (2.0 * np.pi * radius_mm)
    return density


def _swapped(plane: FocalPlane, report: Report, reported_mm: Floats) -> tuple[Floats, Ints]:
    """Density of a place as another one reports it, where that one is as this one reports."""
    density, partner = np.zeros(len(plane)), np.full(len(plane), -1)
    off = report.image.seen & ~(np.hypot(*(report.image.xy_mm - reported_mm).T) < 4.0 * report.scatter_mm)
    rows = np.flatnonzero(off)
    if len(rows) < 2:
        return density, partner
    reach_mm = 2.0 * float(plane.body_reach_mm.max())
    for a, b in cKDTree(plane.centres_mm[rows]).query_pairs(reach_mm):
        i, j = rows[a], rows[b]
        pair = np.array([i, j])
        alpha_deg, beta_deg = report.angles_deg[pair[::-1]].T
        places_mm = plane.forward(alpha_deg, beta_deg, index=pair)
        both = _normal(report.image.xy_mm[pair] - places_mm, report.scatter_mm)
        if both.min() > density[pair].max():
            density[pair], partner[pair] = both, pair[::-1]
    return density, partner


def _reach_mm2(plane: FocalPlane) -> Floats:
    alpha, beta = plane.l_alpha_mm, plane.l_beta_mm
    return np.asarray(np.pi * ((alpha + beta) ** 2 - (alpha - beta) ** 2))


def _overlaps(plane: FocalPlane, report: Report, standing: list[Standing], certain: Flags) -> None:
    """Arms that overlap as reported cannot be: who is not seen to be right there does not move."""
    robots = tuple(
        Trajectory(int(p), np.zeros(1), a[:1], a[1:])
        for p, a in zip(plane.positioner_id, report.angles_deg, strict=True)
    )
    buffer_mm = plane.collision_buffer_mm
    for contact in verify(plane, Plan(plane.instrument.name, buffer_mm, robots)).contacts:
        pair = [contact.positioner_id] + ([int(contact.other)] if contact.other.isdigit() else [])
        if contact.depth <= len(pair) * (1.0 - DEEP_SHARE) * buffer_mm:
            continue  # each of the arms has so much around it
        rows = plane.index_of(pair)
        if not (report.answered | plane.offline)[rows].all():
            continue  # a place that was not reported
        for row in rows:
            # the one that is seen where it reports is there; the other one is not
            if standing[row] is not Standing.RIGHT and not plane.offline[row]:
                standing[row], certain[row] = Standing.OVERLAPS, False


def _places(plane: FocalPlane, report: Report, certain: Flags) -> tuple[Floats, Flags]:
    """Angles (N, 2) of where each is, and of which of those that may not move the place is known."""
    where_deg = np.where(plane.offline[:, None], plane.offline_position_deg, report.angles_deg)
    placed = ~certain & report.image.seen
    rows = np.flatnonzero(placed)
    where_deg[rows], placed[rows] = where_seen(plane, rows, report.image.xy_mm[rows], report.angles_deg[rows])
    return where_deg, placed


def _text(plane: FocalPlane, row: int, standing: Standing, miss_mm: float, partner: int) -> str:
    other = plane.positioner_id[partner] if partner >= 0 else 0
    datum = "search its datum with the neighbours clear, or exclude it"
    text = {
        Standing.OFFLINE: "",
        Standing.TURNS: f"seen {miss_mm:.2f} mm from where it reports, whole motor turns off; {datum}",
        Standing.DATUM: f"seen {miss_mm:.2f} mm from where it reports, one axis is off; {datum}",
        Standing.SWAPPED: f"is where positioner {other} reports to be, and that one where this does; check "
        "the numbers on the bus against the layout",
        Standing.ELSEWHERE: f"seen {miss_mm:.2f} mm from where it reports; {datum}",
        Standing.RIGHT: "",
        Standing.VOUCHED: "",
        Standing.DARK: f"its fibre is not seen, and nothing else says where it is; {datum}",
        Standing.BLIND: "folded onto its alpha axis, where nothing shows alpha, and no datum is on record; "
        "search its datum, or unfold it with the neighbours clear",
        Standing.BEYOND: f"where it reports an axis is beyond its range, where no map holds; {datum}",
        Standing.UNCLEAR: f"its spot cannot be told from others; {datum}",
        Standing.SILENT: "does not answer on the bus",
        Standing.OVERLAPS: f"reports to be where another arm is, which cannot be; {datum}",
    }
    return text[standing]
