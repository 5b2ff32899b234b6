"""The figures of a night, from its record alone."""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Iterable, Sequence
from dataclasses import asdict, dataclass
from datetime import timedelta
from typing import Any

import numpy as np

from fiberloom.errors import InputError
from fiberloom.store import Store
from fiberloom.store.nights.book import NightBook
from fiberloom.store.nights.records import ExposureRecord, StageRecord, VisitRecord
from fiberloom.typing import Floats

WORST = 10
"""Positioners that are named."""
EARLIER = 20
"""Runs before the night that tell how a positioner was."""
COMPUTING = ("assigning", "planning")
"""Steps that take time of this machine and none of a virtual clock."""


@dataclass(frozen=True)
class VisitErrors:
    """What the images of a visit have shown."""

    visit: int
    field: str
    rms_um: list[float | None]
    """After each move, of the fibres with a target."""
    positioner_id: list[int]
    error_um: Floats
    """After the last move; NaN: not seen, or without a target."""
    status: list[str]


def night_figures(book: NightBook) -> dict[str, Any]:
    """All that a report of a night says, as JSON can hold it. Times in s of the night's clock."""
    night, visits, stages, exposures = book.about, book.visits(), book.stages(), book.exposures()
    errors = [found for visit in visits if (found := _errors(book.store, visit)) is not None]
    return {
        "night": {k: _plain(v) for k, v in asdict(night).items()},
        "totals": _totals(visits, stages, exposures),
        "fields": _fields(book, visits, exposures),
        "visits": [_visit(visit, stages, exposures) for visit in visits],
        "steps": _steps(stages),
        "convergence": [{"visit": e.visit, "field": e.field, "rms_um": e.rms_um} for e in errors],
        "worst_positioners": _worst(errors, _before(book.store, visits)),
        "alarms": [{k: _plain(v) for k, v in asdict(alarm).items()} for alarm in book.alarms()],
        "commands": [{k: _plain(v) for k, v in asdict(command).items()} for command in book.commands()],
        "timeline": _timeline(visits, stages, exposures),
    }


def _plain(value: Any) -> Any:
    return value.isoformat(timespec="milliseconds") if hasattr(value, "isoformat") else value


def _totals(
    visits: Sequence[VisitRecord], stages: Sequence[StageRecord], exposures: Sequence[ExposureRecord]
) -> dict[str, Any]:
    ended = [e for e in exposures if e.utc_start is not None and e.utc_end is not None]
    open_s = sum(_open_s(e) for e in ended)
    night_s = _span_s(stages)
    gaps_s = list(shutter_to_ready_s(visits, stages, exposures).values())
    ahead = sum(visit.plan_from == "ahead" for visit in visits)
    return {
        "visits": len(visits),
        "exposures": len(ended),
        "shutter_open_s": open_s,
        "night_s": night_s,
        "share_open": open_s / night_s if night_s else None,
        "shutter_to_ready_s": {
            "n": len(gaps_s),
            "median": float(np.median(gaps_s)) if gaps_s else None,
            "max": max(gaps_s, default=None),
        },
        "planned_ahead": ahead,
        "planned_now": sum(visit.plan_from not in (None, "ahead") for visit in visits),
        "computing_wall_s": sum(s.wall_s for s in stages if _is_computing(s)),
    }


def _is_computing(stage: StageRecord) -> bool:
    return stage.name.partition(": ")[2].startswith(COMPUTING)


def _open_s(exposure: ExposureRecord) -> float:
    assert exposure.utc_start is not None
    assert exposure.utc_end is not None
    return (exposure.utc_end - exposure.utc_start).total_seconds()


def _span_s(stages: Sequence[StageRecord]) -> float:
    if not stages:
        return 0.0
    end = max(stage.utc_start + timedelta(seconds=stage.duration_s) for stage in stages)
    return (end - min(stage.utc_start for stage in stages)).total_seconds()


def shutter_to_ready_s(
    visits: Sequence[VisitRecord], stages: Sequence[StageRecord], exposures: Sequence[ExposureRecord]
) -> dict[int, float]:
    """From the end of the last exposure to fibres on the next field, by visit; waits are left out.

    `visits`, `stages`, `exposures`: of one night. Only visits that came on target, after an exposure.
    """
    found = {}
    for visit in visits:
        ended = [e.utc_end for e in exposures if e.utc_end is not None and e.utc_end <= visit.utc_start]
        ready = [
            s.utc_start + timedelta(seconds=s.duration_s)
            for s in stages
            if (s.visit_id, s.name, s.outcome) == (visit.id, "position", "done")
        ]
        if ended and ready:
            waited = sum(
                s.duration_s for s in stages if s.name == "wait" and max(ended) <= s.utc_start < ready[0]
            )
            found[visit.id] = (ready[0] - max(ended)).total_seconds() - waited
    return found


def _fields(
    book: NightBook, visits: Sequence[VisitRecord], exposures: Sequence[ExposureRecord]
) -> list[dict[str, Any]]:
    rows = []
    for field in book.fields():
        mine = [visit for visit in visits if visit.field == field.name]
        ids = {visit.id for visit in mine}
        last = next((v for v in reversed(mine) if v.assigned is not None), None)
        asked = json.loads(field.entry or "{}")
        rows.append(
            {
                "field": field.name,
                "state": field.state,
                "reason": field.reason,
                "priority": asked.get("priority", 0.0),
                "visits": len(mine),
                "failed": sum(visit.state == "failed" for visit in mine),
                "exposures": sum(e.visit_id in ids and e.utc_end is not None for e in exposures),
                "on_target": None if last is None else last.on_target,
                "assigned": None if last is None else last.assigned,
                "rms_um": None if last is None else last.rms_um,
                "notes": asked.get("notes", ""),
            }
        )
    return rows


def _visit(
    visit: VisitRecord, stages: Sequence[StageRecord], exposures: Sequence[ExposureRecord]
) -> dict[str, Any]:
    took = {s.name: s.duration_s for s in stages if s.visit_id == visit.id}
    exposed = sum(e.visit_id == visit.id and e.utc_end is not None for e in exposures)
    return {k: _plain(v) for k, v in asdict(visit).items()} | {"seconds": took, "exposures": exposed}


def _steps(stages: Sequence[StageRecord]) -> list[dict[str, Any]]:
    """How long each kind of step took, all visits together."""
    by_name: dict[str, list[StageRecord]] = defaultdict(list)
    for stage in stages:
        by_name["expose" if stage.name.startswith("expose") else stage.name].append(stage)
    return [
        {
            "step": name,
            "n": len(mine),
            "median_s": float(np.median([s.duration_s for s in mine])),
            "max_s": max(s.duration_s for s in mine),
            "total_s": sum(s.duration_s for s in mine),
            "wall_s": sum(s.wall_s for s in mine),
            "not_done": sum(s.outcome != "done" for s in mine),
        }
        for name, mine in by_name.items()
    ]


def _errors(store: Store, visit: VisitRecord) -> VisitErrors | None:
    """Of the images of a visit; None where it made no move."""
    if visit.run_id is None:
        return None
    return _errors_of_run(store, visit.run_id, visit.id, visit.field)


def _errors_of_run(store: Store, run: int, visit: int, field: str) -> VisitErrors | None:
    rows = store.measurements(run)
    moves = [number for number in np.unique(rows["move"]).tolist() if number > 0]
    if not moves:
        return None
    last = rows["move"] == moves[-1]
    errors = [rows["error_um"][rows["move"] == number].astype(float) for number in moves]
    return VisitErrors(
        visit,
        field,
        [_rms(one) for one in errors],
        rows["positioner_id"][last].astype(int).tolist(),
        errors[-1],
        rows["status"][last].tolist(),
    )


def _rms(error_um: Floats) -> float | None:
    good = error_um[np.isfinite(error_um)]
    return float(np.sqrt(np.mean(good**2))) if len(good) else None


def _before(store: Store, visits: Iterable[VisitRecord]) -> dict[int, float]:
    """Median error of each positioner in the last runs before the night, um; empty where there are none."""
    mine = {visit.run_id for visit in visits if visit.run_id is not None}
    first = min(mine, default=0)
    earlier = [run.id for run in store.runs() if run.id < first and run.n_measurements][-EARLIER:]
    seen: dict[int, list[float]] = defaultdict(list)
    for run in earlier:
        try:
            found = _errors_of_run(store, run, 0, "")
        except InputError:  # that run is damaged, the night is not
            continue
        for positioner, error_um in zip(*_of(found), strict=True):
            seen[positioner].append(error_um)
    return {p: float(np.nanmedian(e)) for p, e in seen.items() if np.isfinite(e).any()}


def _of(found: VisitErrors | None) -> tuple[list[int], list[float]]:
    return ([], []) if found is None else (found.positioner_id, found.error_um.tolist())


def _worst(errors: Sequence[VisitErrors], before: dict[int, float]) -> list[dict[str, Any]]:
    """Positioners with flags, then those of the largest median error of the night."""
    history: dict[int, list[float | None]] = defaultdict(list)
    flags: dict[int, set[str]] = defaultdict(set)
    for one in errors:
        for positioner, error_um, status in zip(
            one.positioner_id, one.error_um.tolist(), one.status, strict=True
        ):
            history[positioner].append(error_um if error_um == error_um else None)
            flags[positioner] |= {status} - {"on_target", "parked", ""}
    rows = [
        {
            "positioner_id": positioner,
            "error_um": seen,
            "median_um": float(np.median(known)) if (known := [e for e in seen if e is not None]) else None,
            "before_um": before.get(positioner),
            "flags": sorted(flags[positioner]),
        }
        for positioner, seen in history.items()
    ]
    return sorted(rows, key=_badness)[:WORST]


def _badness(row: dict[str, Any]) -> tuple[bool, float]:
    return not row["flags"], -(row["median_um"] if row["median_um"] is not None else np.inf)


def _timeline(
    visits: Sequence[VisitRecord], stages: Sequence[StageRecord], exposures: Sequence[ExposureRecord]
) -> list[dict[str, Any]]:
    """Bars: what, of which field, from when, how long. The steps within a stage take its place."""
    field = {visit.id: visit.field for visit in visits}
    bars = [
        {
            "what": stage.name,
            "field": field.get(stage.visit_id or 0, ""),
            "begin": _plain(stage.utc_start),
            "duration_s": stage.duration_s,
            "outcome": stage.outcome,
        }
        for stage in stages
        if stage.name != "position" and not stage.name.startswith("expose")
    ]
    bars += [
        {
            "what": f"exposure {e.number}",
            "field": field[e.visit_id],
            "begin": _plain(e.utc_start),
            "duration_s": _open_s(e),
            "outcome": "done",
        }
        for e in exposures
        if e.utc_start is not None and e.utc_end is not None
    ]
    return sorted(bars, key=lambda bar: str(bar["begin"]))
