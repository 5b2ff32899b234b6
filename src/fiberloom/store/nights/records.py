"""Rows of a night as they are read. Times in UTC of the night's clock."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime

from fiberloom.store.process import is_alive


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
