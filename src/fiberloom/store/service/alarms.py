"""Alarms of an array in its store: they outlive the process that raised them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from enum import StrEnum
from typing import Any

from fiberloom.store.arrays import ArrayBook
from fiberloom.store.schema import ALARMS
from fiberloom.store.sums import change, checked, put_one, record_of


class Severity(StrEnum):
    """How much an alarm matters; the first is the worst."""

    CRITICAL = "critical"  # arms may be damaged: nothing moves before a person has looked
    MAJOR = "major"  # a motion or a measurement did not work
    MINOR = "minor"  # one positioner is lost to the field
    ADVICE = "advice"  # a proposal to a person

    @property
    def rank(self) -> int:
        """0 is the worst."""
        return list(Severity).index(self)


@dataclass(frozen=True)
class Alarm:
    """One alarm. It is over when its cause is gone and it was acknowledged."""

    code: str
    severity: str
    subject: str
    """A positioner's number, or a part of the array."""
    text: str
    advice: str
    """What to do."""
    since: datetime = field(default_factory=lambda: datetime.now(UTC))
    last: datetime = field(default_factory=lambda: datetime.now(UTC))
    count: int = 1
    gone: datetime | None = None
    """When its cause went; None: it is there."""
    acknowledged: datetime | None = None
    acknowledged_by: str = ""
    id: int = 0
    """In the store; 0: not yet."""

    @property
    def over(self) -> bool:
        """Its cause is gone, and a person knows of it."""
        return self.gone is not None and self.acknowledged is not None

    def columns(self) -> dict[str, Any]:
        """Its columns in the store, but its number."""
        return {name: value for name, value in self.__dict__.items() if name != "id"}

    def as_dict(self) -> dict[str, Any]:
        """For JSON; times as ISO 8601, UTC."""
        values = dict(self.__dict__)
        return {k: v.isoformat() if isinstance(v, datetime) else v for k, v in values.items()}


class AlarmTable:
    """The alarms of one array in its store; those of its nights are in the record of each night."""

    def __init__(self, book: ArrayBook) -> None:
        self._store, self._address = book.store, book.address

    def write(self, alarm: Alarm) -> Alarm:
        """Writes an alarm as it is now, in place of what was known of it; with its number."""
        values = alarm.columns()
        with self._store.transaction() as connection:
            if alarm.id:
                change(connection, ALARMS, ALARMS.c.id == alarm.id, values)
                return alarm
            return replace(alarm, id=put_one(connection, ALARMS, {"address": self._address, **values}))

    def open(self) -> list[Alarm]:
        """Those that are not over, by number."""
        return [alarm for alarm in self.all() if not alarm.over]

    def all(self) -> list[Alarm]:
        """All that were raised, by number."""
        with self._store.transaction() as connection:
            rows = checked(connection, ALARMS)
        mine = (row for row in rows if row["address"] == self._address and row["night_id"] is None)
        return [record_of(Alarm, row) for row in mine]
