"""A night as the page shows it: from its record, and from the runner that carries it out."""

from __future__ import annotations

from dataclasses import replace
from datetime import datetime, timedelta
from typing import Any

from fiberloom.night.foresee import Foreseen, Overheads, foresee
from fiberloom.night.on_record import state_of
from fiberloom.night.overhead import learned_s
from fiberloom.night.queue import Queue
from fiberloom.night.runner import NightRunner
from fiberloom.night.stages import Lap
from fiberloom.night.step import NightState, VisitState, field_states
from fiberloom.store.nights.book import NightBook
from fiberloom.store.nights.records import VisitRecord
from fiberloom.store.service.alarms import Alarm, Severity

MOST_ALARMS = 30
OF_THE_ARRAY = ("alarm", "collision", "camera", "dead")
"""Alarms that the array itself has too."""


def night_view(runner: NightRunner, queue: Queue, rate: float, goes_on: bool) -> dict[str, Any]:
    """All that is shown of a night, as JSON can hold it. Times in s since 1970, by the night's clock.

    `runner`: carries it out; `queue`: as its next step will have it; `rate`: seconds of that clock a second;
    `goes_on`: it is carried out now.
    """
    book, now, control = runner.book, runner.clock.now(), runner.control
    visits, about = book.visits(), book.about
    return {
        "id": about.id,
        "name": about.name,
        "status": about.status,
        "note": about.note,
        "goes_on": goes_on,
        "paused_by": control.paused_by,
        "parked_by": control.parked_by,
        "begin": about.utc_start.timestamp(),
        "dawn": queue.dawn.timestamp(),
        "now": now.timestamp(),
        "rate": rate,
        "bars": _bars(book, visits, runner.stages.under_way if goes_on else None),
        "next": [_foreseen(step) for step in _ahead(book, queue, now)] if goes_on else [],
        "fields": _fields(queue, visits, field_states(state_of(book, queue.require), queue, now)),
        "alarms": [alarm.as_dict() for alarm in open_alarms(book)],
        "commands": [c.as_dict() for c in book.commands()[-12:][::-1]],
    }


def open_alarms(book: NightBook) -> list[Alarm]:
    """Of a night, those that are not acknowledged, the worst first; without those of the array itself."""
    found = [a for a in book.alarms() if a.acknowledged is None and a.code not in OF_THE_ARRAY]
    return sorted(found, key=lambda a: (Severity(a.severity).rank, -a.last.timestamp()))[:MOST_ALARMS]


# what was done


def _bars(book: NightBook, visits: list[VisitRecord], lap: Lap | None) -> list[dict[str, Any]]:
    """Stages that have ended, and the one under way."""
    field = {visit.id: visit.field for visit in visits}
    found = [
        _bar(s.name, field.get(s.visit_id or 0, ""), s.utc_start, s.duration_s, s.outcome)
        for s in book.stages()
        if ": " not in s.name
    ]
    if lap is not None:
        found.append(_bar(lap.name, field.get(lap.visit or 0, ""), lap.utc, None, ""))
    return found


def _bar(name: str, field: str, begin: datetime, lasts_s: float | None, outcome: str) -> dict[str, Any]:
    begin_s = begin.timestamp()
    end_s = None if lasts_s is None else begin_s + lasts_s
    return {"name": name, "field": field, "begin": begin_s, "end": end_s, "outcome": outcome}


def _fields(
    queue: Queue, visits: list[VisitRecord], states: dict[str, tuple[VisitState, str]]
) -> list[dict[str, Any]]:
    last = {visit.field: visit for visit in visits}
    return [
        {
            "name": entry.id,
            "state": states[entry.id][0].value,
            "reason": states[entry.id][1],
            "priority": entry.priority,
            "exposures": f"{len(entry.parts) * entry.exposures} x {entry.exposure_s:g} s",
            **_measured(last.get(entry.id)),
        }
        for entry in queue.fields
    ]


def _measured(visit: VisitRecord | None) -> dict[str, Any]:
    names = ("on_target", "assigned", "rms_um", "plan_from")
    return {name: None if visit is None else getattr(visit, name) for name in names}


# what comes


def _ahead(book: NightBook, queue: Queue, now: datetime) -> list[Foreseen]:
    takes = _overheads(book, queue)
    state, now = _when_free(book, queue, now, takes)
    return foresee(state, queue, now, takes)


def _overheads(book: NightBook, queue: Queue) -> Overheads:
    field_s, dither_s = (learned_s(book, dithered) for dithered in (False, True))
    field_s = queue.overhead_s if field_s is None else field_s
    return Overheads(field_s, field_s if dither_s is None else dither_s)


def _when_free(book: NightBook, queue: Queue, now: datetime, takes: Overheads) -> tuple[NightState, datetime]:
    """As it will be when what is under way has gone well."""
    state = state_of(book, queue.require)
    if not state.visits:
        return state, now
    last, record = state.visits[-1], book.visits()[-1]
    if last.state in (VisitState.PREPARED, VisitState.POSITIONING):
        ready = record.utc_start + timedelta(seconds=takes.field_s)
        return state.with_last(replace(last, state=VisitState.READY)), max(ready, now)
    shut = [e for e in book.exposures() if e.visit_id == record.id and e.utc_start and e.utc_end is None]
    if last.state is VisitState.EXPOSING and shut:
        end = (shut[-1].utc_start or now) + timedelta(seconds=shut[-1].asked_s)
        return state.with_last(replace(last, exposed=last.exposed + 1)), max(end, now)
    return state, now


def _foreseen(step: Foreseen) -> dict[str, Any]:
    times = {"begin": step.begin.timestamp(), "end": step.end.timestamp()}
    return {"name": step.what, "field": step.field, **times}
