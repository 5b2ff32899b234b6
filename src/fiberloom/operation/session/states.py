"""The states of an array, and which command is legal in which: two tables, and nothing else decides.

A state outlives the process: it is in the store, and the next command begins with it.
"""

from __future__ import annotations

from enum import StrEnum

from fiberloom.errors import InputError


class SessionState(StrEnum):
    """What an array is doing."""

    OFF = "off"  # nothing is known of it
    CONNECTING = "connecting"
    UNKNOWN = "unknown"  # connected, or left so: where positioners are has to be seen first
    IDLE = "idle"  # at rest, the begin check is done
    MOVING = "moving"
    LOOKING = "looking"
    STOPPED = "stopped"  # stopped on the way; where each was left is on record
    LOCKED = "locked"  # after a collision: moves only to recover
    RECOVERING = "recovering"  # at that; locked again unless nothing touches any more
    PARKED = "parked"  # at rest and folded


class Deed(StrEnum):
    """A command to an array."""

    OBSERVE = "observe"
    CALIBRATE = "calibrate"
    PARK = "park"
    HOME = "home"
    RECOVER = "recover"
    STOP = "stop"
    STATUS = "status"
    EXCLUDE = "exclude"
    DOCTOR = "doctor"


class Step(StrEnum):
    """What happens to an array in the course of a command."""

    CONNECT = "connect"
    ANSWER = "answer"  # positioners have answered
    LOOK = "look"
    BEGIN = "begin"  # the begin check has said which may move
    MOVE = "move"
    REST = "rest"
    FOLD = "fold"  # at rest, and folded
    STOP = "stop"
    COLLIDE = "collide"
    FREE = "free"  # nothing touches any more
    LOSE = "lose"  # the command ends, and where positioners are is not known


S = SessionState

AT_REST = frozenset({S.OFF, S.UNKNOWN, S.IDLE, S.STOPPED, S.PARKED})
ALWAYS = frozenset(S)

LEGAL: dict[Deed, frozenset[SessionState]] = {
    Deed.OBSERVE: AT_REST,
    Deed.CALIBRATE: AT_REST,
    Deed.PARK: AT_REST,
    Deed.HOME: AT_REST,
    Deed.RECOVER: AT_REST | {S.LOCKED},
    Deed.STOP: ALWAYS,
    Deed.STATUS: ALWAYS,
    Deed.EXCLUDE: ALWAYS,
    Deed.DOCTOR: ALWAYS,
}
"""States of an array that no process owns, in which a command may begin."""

INSTEAD = {
    S.LOCKED: "`fiberloom recover` shows which arms touch and moves them apart",
    S.CONNECTING: "wait, or `fiberloom stop`",
    S.MOVING: "wait, or `fiberloom stop`",
    S.LOOKING: "wait, or `fiberloom stop`",
    S.RECOVERING: "wait, or `fiberloom stop`",
}
"""What to do where a command is not legal."""

_ANYWHERE = {Step.STOP: S.STOPPED, Step.COLLIDE: S.LOCKED, Step.LOSE: S.UNKNOWN}

NEXT: dict[SessionState, dict[Step, SessionState]] = {
    S.OFF: {Step.CONNECT: S.CONNECTING},
    S.CONNECTING: {Step.ANSWER: S.UNKNOWN, **_ANYWHERE},
    S.UNKNOWN: {Step.CONNECT: S.CONNECTING, Step.LOOK: S.LOOKING, Step.BEGIN: S.IDLE, **_ANYWHERE},
    S.IDLE: {
        **{Step.CONNECT: S.CONNECTING, Step.LOOK: S.LOOKING, Step.MOVE: S.MOVING},
        **{Step.REST: S.IDLE, Step.FOLD: S.PARKED, Step.FREE: S.IDLE, **_ANYWHERE},
    },
    S.MOVING: {Step.LOOK: S.LOOKING, Step.REST: S.IDLE, **_ANYWHERE},
    S.LOOKING: {
        **{Step.LOOK: S.LOOKING, Step.BEGIN: S.IDLE, Step.REST: S.IDLE, Step.MOVE: S.MOVING},
        **_ANYWHERE,
    },
    S.STOPPED: {Step.CONNECT: S.CONNECTING, **_ANYWHERE},
    S.LOCKED: {Step.CONNECT: S.RECOVERING, **dict.fromkeys(_ANYWHERE, S.LOCKED)},
    S.RECOVERING: {
        **dict.fromkeys(
            (Step.CONNECT, Step.ANSWER, Step.LOOK, Step.BEGIN, Step.MOVE, Step.REST), S.RECOVERING
        ),
        **{Step.FREE: S.IDLE, **dict.fromkeys(_ANYWHERE, S.LOCKED)},
    },
    S.PARKED: {Step.CONNECT: S.CONNECTING, **_ANYWHERE},
}
"""Which step leads where; a step that is not in the row of a state is a mistake of the program."""


def after(state: SessionState, step: Step) -> SessionState:
    """The state after a step. Raises RuntimeError for one that the table does not have."""
    found = NEXT[state].get(step)
    if found is None:
        raise RuntimeError(f"an array that is {state} cannot {step}")
    return found


def require_legal(deed: Deed, state: SessionState, address: str, why: str = "") -> None:
    """Raises InputError, which names the state and what to do, where a command is not legal.

    `deed`: the command; `state`: of the array; `address`: of its bus; `why`: it is in that state.
    """
    if state in LEGAL[deed]:
        return
    because = f" ({why})" if why else ""
    raise InputError(f"{address} is {state}{because}: {deed} is not possible now; {INSTEAD[state]}")
