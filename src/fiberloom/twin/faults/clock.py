"""Faults that begin and end in the time of a twin in this process."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Protocol, TypeVar

import numpy as np

from fiberloom.twin.faults.faults import Fault
from fiberloom.twin.faults.kinds import ServiceKind
from fiberloom.twin.faults.schedule import ScheduledFault


class Breakable(Protocol):
    """A twin in which something can break."""

    @property
    def time_s(self) -> float:
        """Virtual time."""
        ...

    def inject(self, fault: Fault) -> None:
        """It begins now."""
        ...

    def clear(self, fault: Fault) -> None:
        """It ends now."""
        ...


_Reply = TypeVar("_Reply")


class FaultClock:
    """Applies a schedule to a twin as its time passes; those from the beginning at once.

    `seed`: of the replies that are lost.
    """

    def __init__(self, twin: Breakable, schedule: Iterable[ScheduledFault], seed: int) -> None:
        self._twin = twin
        faults = tuple(schedule)
        self._due = sorted(
            [(f.start_s, True, f) for f in faults] + [(f.end_s, False, f) for f in faults],
            key=lambda entry: entry[0],
        )
        self._losses: list[ScheduledFault] = []
        self._rng = np.random.default_rng([seed, 0x105E])
        self.follow()

    @property
    def next_s(self) -> float:
        """When the next one begins or ends; infinity: never."""
        return self._due[0][0] if self._due else np.inf

    def follow(self) -> None:
        """Begins and ends what is due by now."""
        while self._due and self._due[0][0] <= self._twin.time_s:
            _, begins, fault = self._due.pop(0)
            if fault.kind == ServiceKind.LOST:
                (self._losses.append if begins else self._losses.remove)(fault)
            else:
                (self._twin.inject if begins else self._twin.clear)(fault.fault)

    def carried(self, replies: Sequence[_Reply]) -> list[_Reply]:
        """The replies that arrive."""
        if not self._losses:
            return list(replies)
        return [reply for reply in replies if not self._loses()]

    def _loses(self) -> bool:
        return any(self._rng.random() < fault.share for fault in self._losses)
