"""Rows of a night as they are read. Times in UTC of the night's clock."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, fields
from datetime import datetime
from typing import Any, TypeVar

from fiberloom.store.process import is_alive
from fiberloom.store.sums import as_utc

Record = TypeVar("Record")


@dataclass(frozen=True)
class NightRecord:
    """One night."""

    id: int
    utc_start: datetime
    utc_end: datetime | None
    name: str
    queue: str
    array: str
    instrument: str
    config_hash: str
    seed: int
    version: str
    command_line: str
    status: str
    note: str
    host: str
    pid: int
    process_start: str

    @property
    def goes_on(self) -> bool:
        """A process has it that is not certainly gone."""
        return self.status == "running" and is_alive(self.host, self.pid, self.process_start)


@dataclass(frozen=True)
class FieldRecord:
    """One field of the queue."""

    id: int
    name: str
    entry: str
    state: str
    reason: str


@dataclass(frozen=True)
class VisitRecord:
    """One try to put the fibres on a field."""

    id: int
    field: str
    repeat: int
    dither: int
    attempt: int
    state: str
    utc_start: datetime
    utc_end: datetime | None
    run_id: int | None
    plan_digest: str | None
    plan_from: str | None
    on_target: int | None
    assigned: int | None
    rms_um: float | None
    note: str


@dataclass(frozen=True)
class StageRecord:
    """One stage that has ended."""

    id: int
    visit_id: int | None
    name: str
    utc_start: datetime
    duration_s: float
    wall_s: float
    outcome: str


@dataclass(frozen=True)
class ExposureRecord:
    """One exposure."""

    id: int
    visit_id: int
    number: int
    key: str
    asked_s: float
    utc_start: datetime | None
    utc_end: datetime | None


@dataclass(frozen=True)
class CommandRecord:
    """One command."""

    id: int
    utc: datetime
    who: str
    command: str
    key: str | None
    result: str


@dataclass(frozen=True)
class AlarmRecord:
    """One alarm."""

    id: int
    code: str
    severity: str
    subject: str
    text: str
    since: datetime
    last: datetime
    count: int
    cleared: datetime | None
    acknowledged: datetime | None
    acknowledged_by: str

    @property
    def open(self) -> bool:
        """Its cause is there, or it was not acknowledged."""
        return self.cleared is None or self.acknowledged is None


def record_of(kind: type[Record], row: Mapping[Any, Any]) -> Record:
    """The record of a row: `kind` names its columns."""
    names = [field.name for field in fields(kind)]  # type: ignore[arg-type]
    values = {name: row[name] for name in names}
    return kind(**{k: as_utc(v) if isinstance(v, datetime) else v for k, v in values.items()})
