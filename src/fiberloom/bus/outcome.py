"""How a request to a positioner, or a move, ended."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from enum import Enum
from functools import partial
from typing import NamedTuple

import numpy as np

from fiberloom.bus.protocol import COMMANDS, Command, Response
from fiberloom.bus.transport import Frame
from fiberloom.timing import part
from fiberloom.typing import Flags, Ints


class Outcome(Enum):
    """Every request and every move ends in one of these."""

    DONE = "done"
    REFUSED = "refused"  # the positioner answered with a response code
    TIMED_OUT = "timed out"  # no answer, or no end of the motion, in time
    COLLIDED = "collided"
    STOPPED = "stopped"  # stopped or held back by the host because of another positioner
    MISPLACED = "misplaced"  # reports the end of its motion, but not the position asked for
    NOT_STARTED = "not started"  # a START that it missed: it is where it was
    DISCONNECTED = "disconnected"  # its link is down


_DONE = Outcome.DONE


class Result(NamedTuple):
    """What became of one positioner's request; `values` are the integers of its reply."""

    positioner: int
    outcome: Outcome
    code: Response | None = None
    values: tuple[int, ...] = ()

    @property
    def ok(self) -> bool:
        """True when it did what it was asked."""
        return self.outcome is Outcome.DONE

    def __str__(self) -> str:
        why = f" ({self.code.name})" if self.code else ""
        return f"positioner {self.positioner}: {self.outcome.value}{why}"


_NEW = partial(tuple.__new__, Result)
"""Of a tuple of all four: `Result(...)` in half the time; a sweep of 500 transmissions makes a million."""


class Results(dict[int, Result]):
    """Results by positioner, in the order in which they were asked."""

    polls = 0
    """How many a wait for the end of motions has taken."""

    @property
    def failed(self) -> Results:
        """Those that did not end in DONE."""
        return Results({i: r for i, r in self.items() if r.outcome is not _DONE})

    @property
    def ok_ids(self) -> list[int]:
        """The positioners that ended in DONE."""
        return [i for i, r in self.items() if r.outcome is _DONE]

    @property
    def ok(self) -> Flags:
        """Row by row: True where DONE."""
        return np.array([r.outcome is _DONE for r in self.values()], dtype=bool)

    def values_array(self, width: int) -> Ints:
        """The integers of the replies, one row per positioner; zeros where there is no reply."""
        none = (0,) * width
        rows = [r.values if r.outcome is _DONE and len(r.values) == width else none for r in self.values()]
        return np.array(rows, dtype=np.int64).reshape(len(self), width)

    def __str__(self) -> str:
        failed = self.failed
        if not failed:
            return f"{len(self)} positioners done"
        return f"{len(failed)} of {len(self)} failed: " + "; ".join(map(str, failed.values()))


def result_of(positioner: int, command: Command, reply: Frame | None, lost: bool) -> Result:
    """Judge one `reply` of a `positioner` to a `command`; None is a reply that never came. `lost`: no
    frame reaches it now.
    """
    if reply is None:
        return Result(positioner, Outcome.DISCONNECTED if lost else Outcome.TIMED_OUT)
    code = reply[0] & 0xF
    if code:
        return Result(positioner, Outcome.REFUSED, Response(code))
    values = COMMANDS[command].unpack(reply[1])
    if values is None:  # accepted, but not with what the table promises
        return Result(positioner, Outcome.REFUSED, Response.INCORRECT_AMOUNT_OF_DATA)
    return Result(positioner, Outcome.DONE, Response.ACCEPTED, values)


@part("bus")
def results_of(
    positioners: Sequence[int], command: Command, replies: Iterable[Frame | None], lost: set[int]
) -> list[Result]:
    """As `result_of`, for each of n `positioners` and its one of n `replies` to the same `command`.

    `lost`: those that no frame reaches now.
    """
    layout, done, accepted = COMMANDS[command].layout, Outcome.DONE, Response.ACCEPTED
    least, unpack = layout.size, layout.unpack_from
    return [
        _NEW((i, done, accepted, unpack(reply[1])))  # nearly all are so
        if reply is not None and not reply[0] & 0xF and len(reply[1]) >= least
        else result_of(i, command, reply, i in lost)
        for i, reply in zip(positioners, replies, strict=True)
    ]


@part("bus")
def all_of(positioners: Iterable[int], outcome: Outcome) -> Results:
    """The same outcome for all."""
    return Results({i: _NEW((i, outcome, None, ())) for i in positioners})
