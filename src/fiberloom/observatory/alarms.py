"""Which alarms an array has, from what is on record of it and how the last command has ended."""

from __future__ import annotations

from collections.abc import Mapping

from fiberloom.observatory.port import ArrayAlarm
from fiberloom.operation.session.array_lock import state_of
from fiberloom.operation.session.states import SessionState
from fiberloom.store.arrays import ArrayState
from fiberloom.store.service.alarms import Severity

ARRAY = "array"


def alarms_of(row: ArrayState, failed: str, left_out: Mapping[int, str]) -> tuple[ArrayAlarm, ...]:
    """The worst first.

    `row`: the state of the array; `failed`: why the last command of this process has, empty: it has not;
    `left_out`: reason for each positioner that did not do what was asked of it.
    """
    found = [_locked(row), _gone(row), _failed(failed), *map(_left_out, left_out.items())]
    return tuple(sorted(filter(None, found), key=lambda alarm: alarm.severity.rank))


def no_store(error: object) -> tuple[ArrayAlarm, ...]:
    """Of an array of which nothing can be read."""
    advice = "look at the disk or the database; stop goes by the connection of the process that moves"
    return (ArrayAlarm("store", Severity.CRITICAL, ARRAY, str(error), advice),)


def _locked(row: ArrayState) -> ArrayAlarm | None:
    if state_of(row) is not SessionState.LOCKED:
        return None
    advice = "look at the image and the arms, then `fiberloom recover`"
    return ArrayAlarm("collision", Severity.CRITICAL, ARRAY, row.text or "arms have touched", advice)


def _gone(row: ArrayState) -> ArrayAlarm | None:
    if not row.stale:
        return None
    text = f"{row.owner} is gone; the array was {row.state}"
    return ArrayAlarm("owner", Severity.MAJOR, ARRAY, text, "stop, then give the command again")


def _failed(text: str) -> ArrayAlarm | None:
    if not text:
        return None
    return ArrayAlarm("command", Severity.MAJOR, ARRAY, text, "mend the cause, and give the command again")


def _left_out(positioner: tuple[int, str]) -> ArrayAlarm:
    number, why = positioner
    advice = "`fiberloom recover` or `home --only`; else exclude it"
    return ArrayAlarm("positioner", Severity.MINOR, f"positioner {number}", why, advice)
