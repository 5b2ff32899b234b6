"""What was done in a night, by its record."""

from __future__ import annotations

from datetime import datetime, timedelta

from fiberloom.night.step import NightState, Visited, VisitState
from fiberloom.store.nights.book import NightBook


def state_of(book: NightBook, require: float, parked: bool = False) -> NightState:
    """What was done in a night, by its `book`.

    `require`: share of the assigned fibres that are to be on target, 0 to 1; `parked`: it was folded since
    the last visit.
    """
    ended = [exposure.visit_id for exposure in book.exposures() if exposure.utc_end is not None]
    visits = [
        Visited(
            *(v.field, v.repeat, v.dither, VisitState(v.state), ended.count(v.id)),
            shortfall(v.on_target, v.assigned, require),
        )
        for v in book.visits()
    ]
    return NightState(tuple(visits), parked)


def shortfall(on_target: int | None, assigned: int | None, require: float) -> str:
    """How many fibres are `on_target`, where that is less than the share `require` of those `assigned`; empty
    where it is enough, or neither is known yet."""
    if on_target is None or assigned is None or on_target >= require * assigned:
        return ""
    return f"{on_target} of {assigned} fibres are within the requirement"


def last_time(book: NightBook) -> datetime | None:
    """The latest time on record of a night that has begun; None: it has not."""
    ends = [stage.utc_start + timedelta(seconds=stage.duration_s) for stage in book.stages()]
    ends += [visit.utc_start for visit in book.visits()]
    ends += [when for exposure in book.exposures() for when in (exposure.utc_start, exposure.utc_end) if when]
    return max(ends, default=None)
