"""What a store keeps of a night. Every call is one transaction: the intent before the deed, the result after.

Times are given by the caller: a night has a clock of its own.
"""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from datetime import datetime
from typing import Any

from sqlalchemy import Connection, Table, select

from fiberloom.errors import InputError
from fiberloom.store.database import Store
from fiberloom.store.nights.records import (
    ExposureRecord,
    FieldRecord,
    NightRecord,
    StageRecord,
    VisitRecord,
)
from fiberloom.store.process import host_name, process_start
from fiberloom.store.run import RUNNING
from fiberloom.store.schema import (
    ALARMS,
    COMMANDS,
    EXPOSURES,
    FIELDS,
    NIGHTS,
    STAGES,
    VISITS,
)
from fiberloom.store.service.alarms import Alarm, Severity
from fiberloom.store.service.commands import CommandRecord
from fiberloom.store.sums import Record, change, checked, put, put_one, record_of
from fiberloom.version import __version__


def _this_process() -> dict[str, Any]:
    return {"host": host_name(), "pid": os.getpid(), "process_start": process_start(os.getpid())}


def nights(store: Store) -> list[NightRecord]:
    """All nights of a store, oldest first."""
    with store.transaction() as connection:
        return [record_of(NightRecord, row) for row in checked(connection, NIGHTS)]


def night_of(store: Store, number: int | None = None) -> NightRecord:
    """A night by its number, the last one without. InputError where there is none."""
    found = [night for night in nights(store) if number in (None, night.id)]
    if not found:
        which = "no night in it" if number is None else f"no night {number} in it"
        raise InputError(f"{store.name}: {which}; `fiberloom night QUEUE` begins one")
    return found[-1]


class NightBook:
    """The record of one night, read and written."""

    def __init__(self, store: Store, night: int) -> None:
        """`store`: that it is in; `night`: its number."""
        self.store, self.id = store, night

    @classmethod
    def begin(cls, store: Store, utc: datetime, about: Mapping[str, Any]) -> NightBook:
        """A new night from `utc` on.

        `about`: columns name, queue, array, instrument, config_hash, seed, command_line.
        """
        own = {"utc_start": utc, "version": __version__, "status": RUNNING, "note": ""}
        with store.transaction() as connection:
            return cls(store, put_one(connection, NIGHTS, {**about, **own, **_this_process()}))

    def take_over(self) -> None:
        """This process goes on with it. InputError where another one has it that is not certainly gone."""
        night = self.about
        if night.goes_on:
            raise InputError(
                f"night {self.id} goes on in process {night.pid} on {night.host}; wait for its end"
            )
        self._change(NIGHTS, self.id, {"status": RUNNING, "utc_end": None, **_this_process()})

    def end(self, utc: datetime, status: str, note: str = "") -> None:
        """Books the end: `status` finished, failed or interrupted, and a `note`."""
        self._change(NIGHTS, self.id, {"utc_end": utc, "status": status, "note": note})

    @property
    def about(self) -> NightRecord:
        """The night itself."""
        with self.store.transaction() as connection:
            (row,) = checked(connection, NIGHTS, NIGHTS.c.id == self.id)
            return record_of(NightRecord, row)

    # queue and visits

    def note_field(self, name: str, entry: str, state: str, reason: str = "") -> None:
        """A field of the queue: its `name`, its `entry` as JSON, its `state`, and the `reason` of that."""
        values = {"entry": entry, "state": state, "reason": reason}
        mine = (FIELDS.c.night_id == self.id) & (FIELDS.c.name == name)
        with self.store.transaction() as connection:
            if not change(connection, FIELDS, mine, values):
                put(connection, FIELDS, [{"night_id": self.id, "name": name, **values}])

    def begin_visit(self, utc: datetime, state: str, which: Mapping[str, Any]) -> int:
        """A visit that is about to begin; its number. `which`: field, repeat, dither, attempt."""
        return self._put(VISITS, {**which, "state": state, "utc_start": utc, "note": ""})

    def change_visit(self, visit: int, **values: Any) -> None:
        """New `values` of a `visit`, by column."""
        self._change(VISITS, visit, values)

    def note_stage(self, utc: datetime, stage: Mapping[str, Any]) -> None:
        """A stage that began at `utc` and has ended: visit_id, name, duration_s, wall_s, outcome."""
        self._put(STAGES, {**stage, "utc_start": utc})

    # exposures

    def ask_exposure(self, visit: int, number: int, key: str, asked_s: float) -> int:
        """An exposure that is about to be asked for; its number in the store.

        `visit`: that it belongs to; `number`: from 1; `key`: unique; `asked_s`: its duration, s.
        """
        values = {"visit_id": visit, "number": number, "key": key, "asked_s": asked_s}
        return self._put(EXPOSURES, values)

    def change_exposure(self, exposure: int, **values: Any) -> None:
        """New `values` of an `exposure`: utc_start when the shutter has opened, utc_end when it is closed."""
        self._change(EXPOSURES, exposure, values)

    # commands and alarms

    def note_command(self, utc: datetime, who: str, command: str, result: str, key: str = "") -> bool:
        """A `command` of `who` at `utc`, and its `result`; False where one with its `key` is on record."""
        with self.store.transaction() as connection:
            query = select(COMMANDS.c.id).where(COMMANDS.c.key == key)
            if key and connection.execute(query).first() is not None:
                return False
            said = {"author": who, "role": "", "command": command, "parameters": "{}", "key": key}
            ended = {"utc": utc, "utc_end": utc, "result": result, "text": ""}
            put(connection, COMMANDS, [{**self._whose(connection), **said, **ended}])
        return True

    def raise_alarm(self, utc: datetime, code: str, severity: Severity, subject: str, text: str) -> None:
        """An alarm, or one more count of the same that is not cleared.

        `utc`: now; `code`: its kind; `severity`: how much it matters; `subject`: what it is about;
        `text`: what is wrong and what to do.
        """
        with self.store.transaction() as connection:
            mine = (ALARMS.c.night_id == self.id) & (ALARMS.c.code == code) & (ALARMS.c.subject == subject)
            there = checked(connection, ALARMS, mine & ALARMS.c.gone.is_(None))
            if there:
                values = {"last": utc, "count": there[-1]["count"] + 1, "text": text}
                change(connection, ALARMS, ALARMS.c.id == there[-1]["id"], values)
                return
            alarm = Alarm(code, severity.value, subject, text, advice="", since=utc, last=utc)
            put(connection, ALARMS, [{**self._whose(connection), **alarm.columns()}])

    def clear_alarm(self, utc: datetime, code: str, subject: str) -> None:
        """The cause of an alarm is gone: of this `code` and `subject`."""
        mine = (ALARMS.c.night_id == self.id) & (ALARMS.c.code == code) & (ALARMS.c.subject == subject)
        with self.store.transaction() as connection:
            change(connection, ALARMS, mine & ALARMS.c.gone.is_(None), {"gone": utc})

    def acknowledge(self, alarm: int, utc: datetime, who: str) -> None:
        """`who` has seen an `alarm`; the first one counts."""
        mine = (ALARMS.c.id == alarm) & ALARMS.c.acknowledged.is_(None)
        with self.store.transaction() as connection:
            change(connection, ALARMS, mine, {"acknowledged": utc, "acknowledged_by": who})

    # all of it

    def fields(self) -> list[FieldRecord]:
        """The queue as it was last read, in its order."""
        return self._all(FIELDS, FieldRecord)

    def visits(self) -> list[VisitRecord]:
        """In their order."""
        return self._all(VISITS, VisitRecord)

    def stages(self) -> list[StageRecord]:
        """In the order in which they ended."""
        return self._all(STAGES, StageRecord)

    def exposures(self) -> list[ExposureRecord]:
        """In their order."""
        return self._all(EXPOSURES, ExposureRecord)

    def commands(self) -> list[CommandRecord]:
        """In their order."""
        return self._all(COMMANDS, CommandRecord)

    def alarms(self) -> list[Alarm]:
        """In their order."""
        return self._all(ALARMS, Alarm)

    def _whose(self, connection: Connection) -> dict[str, Any]:
        """The columns of a row of this night and its array."""
        array = connection.execute(select(NIGHTS.c.array).where(NIGHTS.c.id == self.id)).scalar_one()
        return {"night_id": self.id, "address": array}

    def _all(self, table: Table, kind: type[Record]) -> list[Record]:
        with self.store.transaction() as connection:
            rows: Sequence[Mapping[Any, Any]] = checked(connection, table, table.c.night_id == self.id)
            return [record_of(kind, values) for values in rows]

    def _put(self, table: Table, values: Mapping[str, Any]) -> int:
        with self.store.transaction() as connection:
            return put_one(connection, table, {"night_id": self.id, **values})

    def _change(self, table: Table, number: int, values: Mapping[str, Any]) -> None:
        with self.store.transaction() as connection:
            change(connection, table, table.c.id == number, values)
