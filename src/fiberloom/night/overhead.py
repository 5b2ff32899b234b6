"""From the begin of a configuration to its first exposure: as long as it took before, by the record."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import pairwise
from statistics import median

from fiberloom.night.step import VisitState
from fiberloom.store.nights.book import NightBook, nights
from fiberloom.store.nights.records import VisitRecord

CHECK, BLIND, CORRECTION = "position: begin check", "position: blind", "position: correction "
"""Steps of a visit, as its stages are named."""


def learned_s(book: NightBook, dithered: bool) -> float | None:
    """How long a configuration will take, s; None: nothing is on record.

    `book`: of the night; `dithered`: from one place of a field to its next one. The median of this night.
    Before its first dither: as the steps say. Before its first new field: of the last night of this array.
    """
    if found_s := took_s(book, dithered):
        return median(found_s)
    if dithered:
        return _by_steps_s(book)
    return next((median(before) for before in _nights_before(book) if before), None)


def took_s(book: NightBook, dithered: bool) -> list[float]:
    """What each exposed visit of a night took, s; `dithered`: of dithers, else of new fields."""
    first = {exposure.visit_id: exposure.utc_start for exposure in reversed(book.exposures())}
    visits = book.visits()
    kinds = [False for _ in visits[:1]] + [_goes_on(*pair) for pair in pairwise(visits)]
    return [
        (start - visit.utc_start).total_seconds()
        for visit, kind in zip(visits, kinds, strict=True)
        if kind == dithered and (start := first.get(visit.id)) is not None
    ]


def _goes_on(before: VisitRecord, visit: VisitRecord) -> bool:
    """The fibres were on the same field, and stayed there."""
    return before.field == visit.field and before.state == VisitState.DONE


def _nights_before(book: NightBook) -> Iterator[list[float]]:
    """Of new fields in earlier nights with this layout, the last one first."""
    layout = book.about.config_hash
    for night in reversed(nights(book.store)):
        if night.id < book.id and night.config_hash == layout:
            yield took_s(NightBook(book.store, night.id), dithered=False)


def _by_steps_s(book: NightBook) -> float | None:
    """Of a dither: as the last visit, but its blind move is as short as a correction."""
    last = max((exposure.visit_id for exposure in book.exposures()), default=None)
    steps = [stage for stage in book.stages() if last is not None and stage.visit_id == last]
    corrections = [stage.duration_s for stage in steps if stage.name.startswith(CORRECTION)]
    if not corrections:
        return None
    checks = sum(stage.duration_s for stage in steps if stage.name == CHECK)
    return checks + median(corrections) + sum(corrections)
