"""Hours that a list of targets takes: exposures that are chosen together until enough visits are made."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np

from fiberloom.assignment.candidates import find_candidates
from fiberloom.assignment.visits.survey import SCIENCE, SurveyList, VisitSettings, plan_survey
from fiberloom.design.survey.tiling import FieldTargets
from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane
from fiberloom.targets import TargetList
from fiberloom.typing import Floats

SECONDS_PER_HOUR = 3600.0
MOST_EXPOSURES = 40


@dataclass(frozen=True)
class HoursSettings:
    """What is asked of a survey.

    Raises
    ------
    InputError
        Numbers out of range.
    """

    visits: int = 1
    """That each target wants."""
    share: float = 0.95
    """Of the visits to targets in reach that are to be made, 0 to 1."""
    exposure_s: float = 900.0
    overhead_s: float = 60.0
    """From one exposure to the next: readout, move, corrections."""
    most: int = 12
    """Exposures at most."""
    turns: int = 3
    """Orientations of the list on the array, drawn; each is one sample of the error."""
    seed: int = 0
    fields: int = 12
    """Of a list that is larger than the array: at most so many of each orientation are planned, drawn; the
    sums are scaled to all."""

    def __post_init__(self) -> None:
        if self.fields < 1:
            raise InputError(f"survey: {self.fields} fields planned: at least 1")
        if self.visits < 1 or self.turns < 2 or not 1 <= self.most <= MOST_EXPOSURES:
            raise InputError(
                f"survey: {self.visits} visits, {self.turns} turns, {self.most} exposures: at least 1, 2, 1; "
                f"exposures up to {MOST_EXPOSURES}"
            )
        if not 0.0 < self.share <= 1.0:
            raise InputError(f"survey: share {self.share:g} of the visits: above 0, 1 at most")
        if not self.exposure_s > 0.0 or not self.overhead_s >= 0.0:
            raise InputError(
                f"survey: exposures of {self.exposure_s:g} s and {self.overhead_s:g} s between: above 0; not "
                "below"
            )

    def hours(self, exposures: float) -> float:
        """Time in hours of so many `exposures`, dimensionless."""
        return exposures * (self.exposure_s + self.overhead_s) / SECONDS_PER_HOUR


@dataclass(frozen=True)
class SurveyStep:
    """After so many exposures: means over the orientations, with their standard errors."""

    exposures: int
    hours: float
    done: float
    """Share of the wanted visits to targets in reach, 0 to 1."""
    done_error: float
    used: float
    """Share of the working fibres on a target, mean of the exposures."""
    used_error: float


@dataclass(frozen=True)
class TiledSurvey:
    """What a list of many fields takes: means over the orientations, with their standard errors."""

    fields: float
    """That hold a target."""
    fields_error: float
    planned: int
    """Fields that were planned, in all."""
    exposures: float | None
    """Of all fields together, until the share is done; None: not within the most in each."""
    exposures_error: float | None
    reachable: float
    """Share of the targets that a working fibre reaches in their fields; visits are counted of those."""
    used: float
    """Share of the working fibres on a target, mean of these exposures."""


@dataclass(frozen=True)
class SurveyTime:
    """What a list takes."""

    steps: tuple[SurveyStep, ...]
    exposures: float | None
    """Until the share is done, mean over the orientations and interpolated; None: not within the most."""
    exposures_error: float | None
    reachable: float
    """Share of the targets that a working fibre reaches, mean; visits are counted of those alone."""


def survey_time(
    plane: FocalPlane,
    targets: TargetList,
    settings: HoursSettings,
    progress: Callable[[int, int], None] = lambda *_: None,
) -> SurveyTime:
    """Exposures of one field, each number of them chosen together (`fiberloom.assignment.visits`).

    The list is turned about the middle of the `plane` by angles that are drawn; `targets`: n in mm, none of
    them with a positioner of its own; `settings`: visits, share, times; `progress` is told the steps done
    and their number.

    Raises
    ------
    InputError
        An empty list, one that no fibre reaches, or one that demands positioners.
    """
    if not len(targets):
        raise InputError("survey: the list of targets is empty; give it at least one")
    rng = np.random.default_rng([settings.seed, 0x5E7])
    angles = rng.uniform(0.0, 2.0 * np.pi, settings.turns)
    turned = [_turned(plane, targets, float(angle)) for angle in angles]
    shares: list[Floats] = []
    reachable = [_reachable(plane, one) for one in turned]
    if not min(reachable) > 0.0:
        raise InputError(
            f"survey: no fibre of {plane.instrument.name} reaches a target of the list; is it in mm?"
        )
    for exposures in range(1, settings.most + 1):
        progress(exposures, settings.most)
        made = np.array([_shares(plane, one, exposures, settings) for one in turned])
        shares.append(made / np.column_stack([reachable, np.ones(settings.turns)]))
        if (shares[-1][:, 0] >= settings.share).all():
            break
    done = np.stack(shares)[:, :, 0]
    needed = np.array([_needed(curve, settings.share) for curve in done.T])
    mean, error = _mean(needed)
    sure = bool(np.isfinite(needed).all())
    return SurveyTime(
        _steps(np.stack(shares), settings),
        mean if sure else None,
        error if sure else None,
        float(np.mean(reachable)),
    )


def larger_than(plane: FocalPlane, targets: TargetList) -> bool:
    """Is a list in mm larger than one field of the `plane`, however it is turned? `targets`: the list."""
    middle_mm = plane.centres_mm.mean(axis=0)
    reach_mm = np.hypot(*(plane.centres_mm - middle_mm).T) + plane.body_reach_mm
    return bool(np.hypot(*(targets.xy_mm - middle_mm).T).max(initial=0.0) > reach_mm.max())


Tiling = Callable[[float, Floats], Iterable[FieldTargets]]
"""Fields of a list for an angle of the array and a phase (2,) of the lattice."""


def tiled_survey(
    plane: FocalPlane,
    wanted: TargetList,
    tiling: Tiling,
    settings: HoursSettings,
    progress: Callable[[int, int], None] = lambda *_: None,
) -> TiledSurvey:
    """Exposures of a list of many fields: always the exposure that makes most visits, until enough are made.

    Each field is the list's own part of a hexagon that the `plane` covers; each number of its exposures is
    chosen together. A target is observed in one field alone. `wanted`: priorities and fibres of the list,
    whose places `tiling` gives (`fiberloom.design.survey.tiling`); `settings`: as of `survey_time`, `most` of
    each field; `progress` is told the fields done and their number.

    Raises
    ------
    InputError
        No fibre reaches any target.
    """
    rng = np.random.default_rng([settings.seed, 0x711E])
    found = []
    for turn in range(settings.turns):
        fields = list(tiling(float(rng.uniform(0.0, 2.0 * np.pi)), rng.uniform(size=2)))
        drawn = sorted(rng.permutation(len(fields))[: settings.fields])
        curves, n_targets = [], 0
        for done, k in enumerate(drawn):
            progress(turn * len(drawn) + done, settings.turns * len(drawn))
            curves.append(_curve(plane, wanted, fields[k], settings))
            n_targets += len(fields[k].rows)
        found.append((len(fields), len(drawn), *_merged(plane, curves, n_targets, settings)))
    n_fields, drawn_, exposures, reachable, used = (
        np.array(column, dtype=float) for column in zip(*found, strict=True)
    )
    if not reachable.max() > 0.0:
        raise InputError(
            f"survey: no fibre of {plane.instrument.name} reaches a target of the list; is it in mm, or the "
            "--scale right?"
        )
    mean, error = _mean(exposures * n_fields / drawn_)
    sure = math.isfinite(mean)
    return TiledSurvey(
        *_mean(n_fields),
        int(drawn_.sum()),
        mean if sure else None,
        error if sure else None,
        float(reachable.mean()),
        float(used.mean()),
    )


def _curve(
    plane: FocalPlane, wanted: TargetList, own: FieldTargets, settings: HoursSettings
) -> tuple[Floats, int]:
    """Visits made after 0, 1, ... exposures of one field, and how many are wanted of targets in reach."""
    x_mm, y_mm = (own.xy_mm + plane.centres_mm.mean(axis=0)).T
    targets = replace(wanted.select(own.rows), x_mm=x_mm, y_mm=y_mm)
    reachable = round(_reachable(plane, targets) * len(targets)) * settings.visits
    made = [0.0]
    while made[-1] < reachable and len(made) <= settings.most:
        share, _ = _shares(plane, targets, len(made), settings)
        made.append(share * settings.visits * len(targets))
    return np.array(made), reachable


def _merged(
    plane: FocalPlane, curves: list[tuple[Floats, int]], n_targets: int, settings: HoursSettings
) -> tuple[float, float, float]:
    """Exposures until the share of all is made, NaN: never; share in reach; share of the fibres used."""
    wanted = sum(of_field for _, of_field in curves)
    gains = np.sort(np.concatenate([np.diff(made) for made, _ in curves]))[::-1]
    made = np.cumsum(gains)
    enough = np.flatnonzero(made >= settings.share * wanted - 1e-9)
    reachable = wanted / (settings.visits * n_targets)
    if not len(enough) or not wanted:
        return math.nan, reachable, 0.0
    exposures = int(enough[0]) + 1
    return float(exposures), reachable, float(made[enough[0]]) / (exposures * max(1, _working(plane)))


def _working(plane: FocalPlane) -> int:
    return int((~plane.offline).sum())


def _turned(plane: FocalPlane, targets: TargetList, angle_rad: float) -> TargetList:
    middle_mm = plane.centres_mm.mean(axis=0)
    c, s = math.cos(angle_rad), math.sin(angle_rad)
    x_mm, y_mm = ((targets.xy_mm - middle_mm) @ np.array([[c, s], [-s, c]]) + middle_mm).T
    return replace(targets, x_mm=x_mm, y_mm=y_mm)


def _shares(
    plane: FocalPlane, targets: TargetList, exposures: int, settings: HoursSettings
) -> tuple[float, float]:
    """Of the visits to all targets that are made, and of the fibres that are used."""
    n = len(targets)
    survey = SurveyList(
        targets.target_id, targets.priority, np.full(n, settings.visits), np.full(n, SCIENCE).astype(np.str_)
    )
    fields = [(targets, np.arange(n))] * exposures
    found = plan_survey(plane, survey, fields, seed=settings.seed, settings=VisitSettings())
    made = int(np.minimum(found.visits_done, settings.visits).sum())
    fibres = sum(int((one.target >= 0).sum()) for one in found.assignments)
    return made / (settings.visits * n), fibres / (exposures * max(1, _working(plane)))


def _reachable(plane: FocalPlane, targets: TargetList) -> float:
    """Share of the targets that a working fibre reaches, 0 to 1."""
    found = find_candidates(plane, targets)
    working = ~plane.offline[found.positioner]
    return len(np.unique(found.target[working])) / len(targets)


def _needed(done: Floats, share: float) -> float:
    """Exposures until this share is done, by a straight line between two numbers of them; NaN: never."""
    known = np.concatenate([[0.0], done])
    beyond = np.flatnonzero(known >= share)
    if not len(beyond):
        return math.nan
    k = int(beyond[0])
    return float(k - 1 + (share - known[k - 1]) / (known[k] - known[k - 1]))


def _mean(values: Floats) -> tuple[float, float]:
    return float(values.mean()), float(values.std(ddof=1)) / math.sqrt(len(values))


def _steps(shares: Floats, settings: HoursSettings) -> tuple[SurveyStep, ...]:
    """`shares` (exposures, turns, 2)."""
    return tuple(
        SurveyStep(k, settings.hours(k), *_mean(of_step[:, 0]), *_mean(of_step[:, 1]))
        for k, of_step in enumerate(shares, 1)
    )
