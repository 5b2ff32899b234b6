"""A survey chosen as a whole, beside greedy and beside one exposure after the other.

    python -m benchmarks.sky.survey [--out FILE.json]

Two surveys on 500 positioners of SDSS-V: 3 exposures of one field, and two fields that overlap, of 2
exposures each. Every tenth target is a place of sky, every tenth a standard. The others have
priority 0, 1 and 2 in turn and want 1, 2 and 3 visits. Minimums in each of six sectors: 3 sky, 1 standard.
"""

from __future__ import annotations

import argparse
import json
from pathlib import Path

import numpy as np

from fiberloom.assignment.visits.solve import ChosenVisits, one_by_one, solve
from fiberloom.assignment.visits.survey import (
    SurveyList,
    SurveyPlan,
    VisitSettings,
    completeness,
    plan_survey,
)
from fiberloom.errors import InputError
from fiberloom.instruments import FocalPlane
from fiberloom.targets import TargetList

SIZES = {"3 exposures": ((0.0,) * 3, 1500), "2 x 2": ((0.0, 0.0, 200.0, 200.0), 2000)}
"""Shift of the field in x in mm for each exposure, and targets."""
RADIUS_MM = 310.0


def made(
    n: int, shifts_mm: tuple[float, ...], seed: int
) -> tuple[SurveyList, list[tuple[TargetList, np.ndarray]]]:
    """A survey and the targets of each exposure."""
    rng = np.random.default_rng(seed)
    k = np.arange(n)
    wide = RADIUS_MM + 0.5 * max(shifts_mm)
    r, turn = wide * np.sqrt(rng.random(n)), rng.uniform(0.0, 2.0 * np.pi, n)
    x, y = r * np.cos(turn) + 0.5 * max(shifts_mm), r * np.sin(turn)
    role = np.where(k % 10 == 0, "sky", np.where(k % 10 == 1, "standard", "science"))
    fibre = np.where(role == "science", np.array(["", "BOSS", "APOGEE"])[k % 3], "BOSS")
    names = k.astype(np.str_)
    whole = TargetList(names, x, y, (k % 3).astype(float), fibre, np.full(n, -1))
    rows = [np.flatnonzero(np.hypot(x - s, y) < RADIUS_MM) for s in shifts_mm]
    lists = [(whole.select(r).moved([-s, 0.0]), r) for r, s in zip(rows, shifts_mm, strict=True)]
    return SurveyList(names, whole.priority, 1 + k % 3, role), lists


def row(plan: SurveyPlan, name: str, found: ChosenVisits | None) -> dict[str, object]:
    """What a choice comes to; None: the minimums were missed."""
    if found is None:
        return {"by": name, "value": None}
    done = np.bincount(plan.model.target[found.columns], minlength=len(plan.survey.visits))
    by_priority = completeness(plan.survey, done)
    return {
        "by": name,
        "value": found.value,
        "short_of_bound_percent": 100.0 * (1.0 - found.value / plan.chosen.bound),
        "proven": found.proven,
        "cpu_s": found.cpu_s,
        "visits": {f"{p['priority']:g}": f"{p['visits_done']} of {p['visits_wanted']}" for p in by_priority},
        "complete": {f"{p['priority']:g}": f"{p['complete']} of {p['targets']}" for p in by_priority},
    }


def tried(plan: SurveyPlan, solver: str) -> ChosenVisits | None:
    """A choice by another solver; None: the minimums were missed, or it is not installed."""
    try:
        return one_by_one(plan.model) if solver == "one by one" else solve(plan.model, solver)
    except InputError as error:
        print(f"{solver}: {error}")
        return None


def survey(plane: FocalPlane, name: str) -> dict[str, object]:
    """All choices of one survey."""
    shifts_mm, n = SIZES[name]
    wanted, lists = made(n, shifts_mm, seed=0)
    how = VisitSettings(minimum={"sky": 3, "standard": 1}, sectors=6)
    plan = plan_survey(plane, wanted, lists, settings=how)
    others = [row(plan, s, tried(plan, s)) for s in ("ortools", "one by one", "greedy")]
    given_up = int(plan.chosen.columns.sum()) - int(plan.visits_done.sum())
    about = {"survey": name, "candidates": len(plan.model), "bound": plan.chosen.bound, "given_up": given_up}
    return about | {"choices": [row(plan, "highs", plan.chosen), *others]}


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, help="JSON to write")
    options = parser.parse_args()
    plane = FocalPlane.of("sdssv", seed=0)
    rows = []
    for name in SIZES:
        rows.append(survey(plane, name))
        print(json.dumps(rows[-1], indent=1), flush=True)
    if options.out:
        options.out.write_text(json.dumps(rows, indent=1) + "\n")


if __name__ == "__main__":
    main()
