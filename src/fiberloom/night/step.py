"""What a night does next: a pure function of what was done, the queue and the time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from datetime import datetime, timedelta
from enum import StrEnum
from typing import TypeAlias

from fiberloom.night.queue import FieldEntry, Queue

LOOK_AGAIN_S = 60.0
"""Where a field waits for its airmass."""


class VisitState(StrEnum):
    """Of a visit, and of a field in the queue."""

    QUEUED = "queued"
    PREPARED = "prepared"  # on record, nothing has moved yet
    POSITIONING = "positioning"
    READY = "ready"  # fibres are on target, the shutter is closed
    EXPOSING = "exposing"
    DONE = "done"
    FAILED = "failed"
    SKIPPED = "skipped"  # its time is over, or an operator leaves it out
    INTERRUPTED = "interrupted"  # the process was gone, or an operator stopped it


ON_TARGET = frozenset({VisitState.READY, VisitState.EXPOSING})
OVER = frozenset({VisitState.DONE, VisitState.FAILED, VisitState.INTERRUPTED})


@dataclass(frozen=True)
class FieldPart:
    """A place of a field, in one of its repeats."""

    field: str
    repeat: int
    dither: int

    @property
    def part(self) -> tuple[str, int, int]:
        """Field, repeat, dither."""
        return self.field, self.repeat, self.dither


@dataclass(frozen=True)
class Visited(FieldPart):
    """A visit as far as it has come."""

    state: VisitState
    exposed: int = 0
    """Exposures of it that have ended."""
    short: str = ""
    """How many fibres were on target, where that is fewer than the queue requires; empty: enough."""


@dataclass(frozen=True)
class NightState:
    """What was done so far."""

    visits: tuple[Visited, ...] = ()
    """In their order; the last one may be under way."""
    parked: bool = False
    """Since the last visit."""

    @property
    def underway(self) -> Visited | None:
        """The visit whose fibres are on target."""
        last = self.visits[-1] if self.visits else None
        return last if last is not None and last.state in ON_TARGET else None

    def exposed(self, part: tuple[str, int, int]) -> int:
        """Exposures of a place that have ended, of all its visits with enough fibres on target."""
        return sum(visit.exposed for visit in self.visits if visit.part == part and not visit.short)

    def made(self, visit: Visited) -> int:
        """Exposures that a visit has no need to make, also where its own ones do not count."""
        return self.exposed(visit.part) + (visit.exposed if visit.short else 0)

    def fell_short(self, part: tuple[str, int, int]) -> int:
        """How many visits of a place had too few fibres on target."""
        return sum(visit.part == part and bool(visit.short) for visit in self.visits)

    def with_last(self, visit: Visited) -> NightState:
        """With another one in the place of the last visit."""
        return replace(self, visits=(*self.visits[:-1], visit))

    def failed(self, part: tuple[str, int, int]) -> int:
        """How often a place has failed; an interruption is no failure."""
        return sum(visit.part == part and visit.state is VisitState.FAILED for visit in self.visits)


@dataclass(frozen=True)
class Position(FieldPart):
    """Put the fibres on a place of a field."""


@dataclass(frozen=True)
class Expose:
    """Open the shutter for exposure `number`, from 1, of the visit under way."""

    number: int


@dataclass(frozen=True)
class Close:
    """The visit under way is over."""

    state: VisitState
    why: str


@dataclass(frozen=True)
class Wait:
    """Nothing can be done before `until`."""

    until: datetime
    why: str


@dataclass(frozen=True)
class Pause:
    """Nothing begins until an operator says so."""

    who: str


@dataclass(frozen=True)
class Park:
    """Fold the array."""

    why: str


@dataclass(frozen=True)
class End:
    """The night is over."""

    why: str


Step: TypeAlias = Position | Expose | Close | Wait | Pause | Park | End


def next_step(state: NightState, queue: Queue, now: datetime) -> Step:
    """What to do next.

    Parameters
    ----------
    state : NightState
        What was done so far.
    queue : Queue
        As it is now.
    now : datetime
        UTC.

    Returns
    -------
    Step
        The same for the same arguments. Of the fields that may be begun now the one of the highest priority;
        among equals first those whose place has not had too few fibres on target, then the one that was
        begun, then the one whose time is over first, then the queue's order.
    """
    if state.underway is not None:
        return _of_visit(state, state.underway, queue, now)
    open_parts = list(_open_parts(state, queue))
    ready = [(entry, part) for entry, part in open_parts if _may_begin(entry, queue, now)]
    if ready:
        entry, (repeat, dither) = min(ready, key=lambda one: _rank(one[0], one[1], state, queue))
        return Position(entry.id, repeat, dither)
    later = [when for entry, _ in open_parts if (when := _next_look(entry, queue, now)) is not None]
    if later:
        return Wait(min(later), "no field may be begun before")
    why = "dawn" if open_parts and now >= queue.dawn else "nothing left that fits"
    why = why if open_parts else "the queue is done"
    return End(why) if state.parked or not state.visits else Park(why)


def _of_visit(state: NightState, visit: Visited, queue: Queue, now: datetime) -> Step:
    entry, done = queue.entry(visit.field), state.made(visit)
    if entry is None:
        return Close(VisitState.DONE if done else VisitState.FAILED, "taken out of the queue")
    again = state.failed(visit.part) + 1 < queue.attempts
    if visit.short and (again or done >= entry.exposures):
        return Close(VisitState.FAILED, _of_short(visit, again))
    if done >= entry.exposures:
        return Close(VisitState.DONE, "")
    if entry.skip:
        return Close(VisitState.INTERRUPTED, f"skipped: {entry.skip}")
    end = min(queue.dawn, entry.not_after or queue.dawn)
    if now + timedelta(seconds=entry.exposure_s) > end:
        return Close(VisitState.FAILED, f"{done} of {entry.exposures} exposures before its time was over")
    return Expose(done + 1)


def _of_short(visit: Visited, again: bool) -> str:
    """What became of a visit with too few fibres on target: the last one that is tried is exposed."""
    became = "exposed, and not counted as done" if visit.exposed else "not exposed"
    return f"{visit.short}: {became}{'; made again later' if again else ''}"


def _open_parts(state: NightState, queue: Queue) -> Iterator[tuple[FieldEntry, tuple[int, int]]]:
    """The next place of each field that is neither exposed nor given up."""
    for entry in queue.fields:
        for part in () if entry.skip else entry.parts:
            of = (entry.id, *part)
            if state.exposed(of) < entry.exposures and state.failed(of) < queue.attempts:
                yield entry, part
                break


def _may_begin(entry: FieldEntry, queue: Queue, now: datetime) -> bool:
    early = entry.not_before is not None and now < entry.not_before
    return not early and now <= queue.last_begin(entry) and queue.is_up(entry, now)


def _next_look(entry: FieldEntry, queue: Queue, now: datetime) -> datetime | None:
    """When a field that may not be begun now may be; None: not any more."""
    if now > queue.last_begin(entry):
        return None
    if entry.not_before is not None and now < entry.not_before:
        return entry.not_before if entry.not_before <= queue.last_begin(entry) else None
    again = now + timedelta(seconds=LOOK_AGAIN_S)
    return again if again <= queue.last_begin(entry) else None


def _rank(
    entry: FieldEntry, part: tuple[int, int], state: NightState, queue: Queue
) -> tuple[float, int, bool, datetime, int]:
    last = state.visits[-1] if state.visits else None
    begun = last is not None and last.field == entry.id and not last.short
    short = state.fell_short((entry.id, *part))
    return -entry.priority, short, not begun, queue.last_begin(entry), queue.fields.index(entry)


def as_asked(step: Step, state: NightState, paused_by: str, parked_by: str) -> Step:
    """What to do in place of a `step`, in this `state` of the night, where people have asked for it.

    `paused_by`, `parked_by`: who has; empty: none. A night that is over stays so.
    """
    if parked_by and not isinstance(step, End):
        why = f"parked by {parked_by}"
        if state.underway is not None:
            return Close(VisitState.INTERRUPTED, why)
        return End(why) if state.parked else Park(why)
    return Pause(paused_by) if paused_by and not isinstance(step, End) else step


def field_states(state: NightState, queue: Queue, now: datetime) -> dict[str, tuple[VisitState, str]]:
    """State of every field of the queue, and the reason where there is one to tell."""
    return {entry.id: _field_state(entry, state, queue, now) for entry in queue.fields}


def _field_state(entry: FieldEntry, state: NightState, queue: Queue, now: datetime) -> tuple[VisitState, str]:
    last = state.visits[-1] if state.visits else None
    if last is not None and last.field == entry.id and last.state not in OVER:
        return last.state, ""
    parts = [(entry.id, *part) for part in entry.parts]
    done = sum(state.exposed(part) >= entry.exposures for part in parts)
    if done == len(parts):
        return VisitState.DONE, ""
    if entry.skip:
        return VisitState.SKIPPED, f"{entry.skip}; {done} of {len(parts)} places done"
    if any(state.failed(part) >= queue.attempts for part in parts):
        light = [
            visit.short for visit in state.visits if visit.part in parts and visit.short and visit.exposed
        ]
        told = f"; exposed, and not counted: {light[-1]}" if light else ""
        return VisitState.FAILED, f"{done} of {len(parts)} places done{told}"
    if _next_look(entry, queue, now) is None:
        return VisitState.SKIPPED, f"its time is over; {done} of {len(parts)} places done"
    return VisitState.QUEUED, ""
