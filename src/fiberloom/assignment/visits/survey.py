"""A survey: who takes which target in each exposure, for most visits of the highest priorities."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from fiberloom.assignment.assign import Assignment, finished, screened
from fiberloom.assignment.candidates import Block, Candidates, WayRule, check_targets, find_candidates
from fiberloom.assignment.choose import LEVEL_WEIGHT, conflicts, levels_of
from fiberloom.assignment.placement import Placement, Rules, Say, silent
from fiberloom.assignment.visits.model import Choices, VisitModel, build
from fiberloom.assignment.visits.solve import ChosenVisits, one_by_one, solve
from fiberloom.assignment.ways import Preference
from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane
from fiberloom.sky.sky_targets import GUIDE
from fiberloom.targets import TargetList
from fiberloom.targets.target_list import FREE
from fiberloom.typing import Floats, Ints

SCIENCE = "science"
MOST_LEVELS = 5
"""Priorities that are told apart: weights from 1 to 1e4 keep the sums exact for the solvers."""


@dataclass(frozen=True)
class VisitSettings:
    """How to choose over many exposures."""

    minimum: Mapping[str, int] = field(default_factory=dict)
    """By role: least number of fibres in every sector of every exposure."""
    sectors: int = 1
    """Of equal angle about the centre of the focal plane, from +x counter-clockwise."""
    solver: str = "highs"
    margin_mm: float = 0.2
    """Between two arms, beyond touching, mm."""
    ways: WayRule | None = None
    progress: Say = silent


@dataclass(frozen=True, eq=False)
class SurveyList:
    """n targets of a survey; arrays (n,)."""

    target_id: NDArray[np.str_]
    priority: Floats
    visits: Ints
    """That are wanted, 1 or more; of calibration targets it does not count."""
    role: NDArray[np.str_]
    """`science`, or a role that has a minimum, such as `sky` and `standard`."""


@dataclass(frozen=True, eq=False)
class SurveyPlan:
    """What each of E exposures does, and how good the choice is."""

    survey: SurveyList
    lists: tuple[TargetList, ...]
    """Targets of each exposure."""
    rows: tuple[Ints, ...]
    """Of each: rows of its targets in the list of the survey."""
    assignments: tuple[Assignment, ...]
    model: VisitModel
    chosen: ChosenVisits
    settings: VisitSettings
    seed: int

    @property
    def visits_done(self) -> Ints:
        """(n,) exposures in which each target has a positioner, once all others are parked."""
        done = np.zeros(len(self.survey.visits), dtype=np.int64)
        for rows, assignment in zip(self.rows, self.assignments, strict=True):
            done[rows[assignment.target[assignment.target >= 0]]] += 1
        return done

    def by_role(self, plane: FocalPlane) -> dict[str, list[list[int]]]:
        """Fibres of each role in each sector of each exposure of the `plane`, by role."""
        sector, told = sectors_of(plane, self.settings.sectors), {}
        for role in self.settings.minimum:
            told[role] = [
                np.bincount(
                    sector[has := a.target >= 0][self.survey.role[rows[a.target[has]]] == role],
                    minlength=self.settings.sectors,
                ).tolist()
                for rows, a in zip(self.rows, self.assignments, strict=True)
            ]
        return told

    def others(self) -> dict[str, ChosenVisits | None]:
        """The same choice by greedy, and one exposure after the other; None: the minimums were missed."""
        return {
            "greedy": _or_none(lambda: solve(self.model, "greedy", self.seed)),
            "one by one": _or_none(lambda: one_by_one(self.model, self.seed)),
        }

    def completeness(self) -> list[dict[str, Any]]:
        """For each priority, the highest first: targets, those complete, visits wanted and done."""
        return completeness(self.survey, self.visits_done)


def _or_none(make: Any) -> ChosenVisits | None:
    try:
        found: ChosenVisits = make()
    except InputError:
        return None
    return found


def completeness(survey: SurveyList, done: Ints) -> list[dict[str, Any]]:
    """For each priority of the science targets of `survey`: targets, complete ones, visits; `done` (n,)."""
    science = survey.role == SCIENCE
    rows = []
    for priority in np.unique(survey.priority[science])[::-1].tolist():
        mine = science & (survey.priority == priority)
        rows.append(
            {
                "priority": priority,
                "targets": int(mine.sum()),
                "complete": int((done[mine] >= survey.visits[mine]).sum()),
                "visits_wanted": int(survey.visits[mine].sum()),
                "visits_done": int(done[mine].sum()),
            }
        )
    return rows


def sectors_of(plane: FocalPlane, sectors: int) -> Ints:
    """(N,) sector of each positioner of the `plane`, from 0 up: angle about (0, 0) from +x, in `sectors`."""
    around = np.arctan2(plane.centres_mm[:, 1], plane.centres_mm[:, 0]) % (2.0 * np.pi)
    return np.minimum((around / (2.0 * np.pi) * sectors).astype(np.int64), sectors - 1)


def plan_survey(
    plane: FocalPlane,
    survey: SurveyList,
    exposures: Sequence[tuple[TargetList, Ints]],
    *,
    seed: int = 0,
    settings: VisitSettings | None = None,
) -> SurveyPlan:
    """Choose the targets of all exposures together.

    A visit of a priority level is worth ten of the next lower one. Arms keep their distances as in `assign`:
    the same candidates, bodies and margins.

    Parameters
    ----------
    plane : FocalPlane
        N positioners.
    survey : SurveyList
        n targets, with the visits that each wants.
    exposures : sequence
        For each the targets that are in its field, in mm, and their rows in the survey.
    seed : int
        Decides between equally good choices; the same input and seed give the same one.
    settings : VisitSettings, optional
        Minimums per sector, solver, margin.

    Returns
    -------
    SurveyPlan
        An assignment for each exposure, the bound of the solver, and what there was to choose from.

    Raises
    ------
    InputError
        A minimum that cannot be had; a target that demands a positioner; ortools where it is asked for and
        not installed.
    """
    settings = settings or VisitSettings()
    _check(survey, settings)
    made = [_ExposureChoice(plane, targets, rows, settings, k) for k, (targets, rows) in enumerate(exposures)]
    level = levels_of(survey.priority, MOST_LEVELS)
    science = survey.role == SCIENCE
    value = np.where(science, LEVEL_WEIGHT**level, 0.0)
    visits = np.where(science, survey.visits, max(1, len(made)))
    sector = sectors_of(plane, settings.sectors)
    choices = [one.choices(sector) for one in made]
    model = build(choices, value, visits, survey.role, dict(settings.minimum), settings.sectors)
    settings.progress(f"choosing among {len(model)} candidates in {len(made)} exposures")
    chosen = solve(model, settings.solver, seed)
    parts = np.split(chosen.columns, np.cumsum([len(c.target) for c in choices])[:-1])
    assignments = tuple(one.settle(part) for one, part in zip(made, parts, strict=True))
    lists, rows = (tuple(x) for x in zip(*exposures, strict=True))
    return SurveyPlan(survey, lists, rows, assignments, model, chosen, settings, seed)


def _check(survey: SurveyList, settings: VisitSettings) -> None:
    known = {SCIENCE, GUIDE, *settings.minimum}
    for row in np.flatnonzero(~np.isin(survey.role, list(known)))[:1].tolist():
        raise InputError(
            f"target {survey.target_id[row]}: role '{survey.role[row]}' has no minimum; "
            f"roles are {', '.join(sorted(known))}"
        )
    for row in np.flatnonzero(survey.visits < 1)[:1].tolist():
        raise InputError(f"target {survey.target_id[row]}: visits = {survey.visits[row]}: must be 1 or more")


class _ExposureChoice:
    """Candidates of one exposure, and its assignment once they are chosen."""

    def __init__(
        self, plane: FocalPlane, targets: TargetList, rows: Ints, settings: VisitSettings, number: int
    ) -> None:
        check_targets(plane, targets)
        for row in np.flatnonzero(targets.positioner_id != FREE)[:1].tolist():
            raise InputError(
                f"target {targets.target_id[row]}: demands a positioner; the list of a survey demands none"
            )
        settings.progress(f"exposure {number + 1}: finding who reaches which of {len(targets)} targets")
        approach_deg = plane.instrument.approach_deg
        self.plane, self.targets, self.rows = plane, targets, rows
        self.rules = Rules.of(plane, approach_deg, settings.margin_mm)
        self.placement = Placement(plane, np.full(plane.n, approach_deg))
        self.by = Preference(False, None, plane.instrument.approach_sides, settings.ways)
        self.found = find_candidates(plane, targets)
        self.segments, self.block = screened(self.placement, self.found, self.rules, self.by)
        self.open = np.flatnonzero(self.block == Block.NONE)

    def choices(self, sector: Ints) -> Choices:
        """What there is to choose from; `sector` (N,) of each positioner."""
        some: Candidates = self.found.select(self.open)
        pairs = conflicts(self.plane, some, self.segments[self.open], self.rules.pair_mm, self.by.ways)
        return Choices(some.positioner, self.rows[some.target], sector[some.positioner], pairs)

    def settle(self, chosen: NDArray[np.bool_]) -> Assignment:
        """Puts the chosen ones of the open candidates, and parks the others."""
        rows, found = self.open[chosen], self.found
        self.placement.put(
            found.positioner[rows],
            found.goal_deg[rows],
            self.segments[rows],
            self.rules.approach_deg,
            found.target[rows],
            found.fibre[rows],
        )
        return finished(self.placement, self.targets, found, self.block, self.rules, self.by)
