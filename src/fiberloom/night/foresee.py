"""What a night will do if nothing fails: its next steps, with times. A forecast for people, no plan."""

from __future__ import annotations

from dataclasses import dataclass, replace
from datetime import datetime, timedelta

from fiberloom.night.queue import Queue
from fiberloom.night.step import (
    Close,
    End,
    Expose,
    NightState,
    Park,
    Pause,
    Position,
    Step,
    Visited,
    VisitState,
    Wait,
    next_step,
)

MOST = 400
"""Steps that are looked ahead."""


@dataclass(frozen=True)
class Foreseen:
    """One thing that will be done."""

    what: str
    """position, expose, wait, park."""
    field: str
    """Of the queue; empty: none."""
    begin: datetime
    end: datetime


@dataclass(frozen=True)
class Overheads:
    """How long a configuration takes, s."""

    field_s: float
    """Of a new field."""
    dither_s: float
    """From one place of a field to the next."""


def foresee(state: NightState, queue: Queue, now: datetime, takes: Overheads) -> list[Foreseen]:
    """What comes after `now`, by the rule of the night itself, until it ends.

    `state`: what was done, with nothing under way but a visit on target; `queue`: as it is; `takes`: how long
    configurations take.
    """
    found: list[Foreseen] = []
    for _ in range(MOST):
        step = next_step(state, queue, now)
        state, lasts_s = _after(step, state, queue, now, takes)
        end = now + timedelta(seconds=lasts_s)
        if lasts_s or isinstance(step, Park):
            found.append(_told(step, state, now, end))
        if isinstance(step, (End, Park)):
            break
        now = end
    return _joined(found)


def _after(
    step: Step, state: NightState, queue: Queue, now: datetime, takes: Overheads
) -> tuple[NightState, float]:
    """The state after a step that went well, and how long it took, s."""
    last = state.visits[-1] if state.visits else None
    if isinstance(step, Position):
        same = last is not None and last.field == step.field
        visit = Visited(*step.part, VisitState.READY)
        return NightState((*state.visits, visit)), takes.dither_s if same else takes.field_s
    if isinstance(step, Expose):
        assert last is not None
        entry = queue.entry(last.field)
        assert entry is not None
        return state.with_last(replace(last, exposed=last.exposed + 1)), entry.exposure_s
    if isinstance(step, Close):
        assert last is not None
        return state.with_last(replace(last, state=step.state)), 0.0
    if isinstance(step, Wait):
        return state, max((step.until - now).total_seconds(), 1.0)
    return state, takes.field_s if isinstance(step, Park) else 0.0


def _told(step: Step, state: NightState, begin: datetime, end: datetime) -> Foreseen:
    names = {Position: "position", Expose: "expose", Wait: "wait", Pause: "wait", Park: "park"}
    field = state.visits[-1].field if isinstance(step, (Position, Expose)) else ""
    return Foreseen(names[type(step)], field, begin, end)


def _joined(steps: list[Foreseen]) -> list[Foreseen]:
    """Waits one after the other are one; so are exposures of one place."""
    found: list[Foreseen] = []
    for step in steps:
        before = found[-1] if found else None
        if (
            before is not None
            and (before.what, before.field) == (step.what, step.field)
            and step.what != "position"
        ):
            found[-1] = replace(before, end=step.end)
        else:
            found.append(step)
    return found
