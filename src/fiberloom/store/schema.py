"""The tables. Lengths in mm, errors in um, angles in deg, times in UTC or in s of the run's clock.

NULL is "not known": a fibre that was not seen has no place, a parked positioner no target.
"""

from __future__ import annotations

from datetime import datetime
from typing import Any, ClassVar

from sqlalchemy import BigInteger, DateTime, Double, ForeignKey, Index, LargeBinary, MetaData
from sqlalchemy.orm import DeclarativeBase, Mapped, mapped_column

SCHEMA_VERSION = 6
"""2: what was learnt of the maps in operation. 3: arrays: exclusions, state and owner, places. 4: sums of
rows. 5: sums also of rows that change, the folder of a run, and what its files are made of. 6: nights;
commands and alarms of arrays. The steps from one to the next are in `upkeep/revisions`. Rows of before
version 5 have no sums until they change."""


class Base(DeclarativeBase):
    """Common metadata of all tables."""

    metadata = MetaData()
    type_annotation_map: ClassVar[dict[Any, Any]] = {float: Double()}  # one type with every SQLAlchemy


class Summed:
    """Rows with a sum over all else, so that a flipped bit is found on reading."""

    row_sum: Mapped[int | None] = mapped_column(BigInteger)  # none: of an older version


class SchemaRow(Base):
    """One row: the version of the tables."""

    __tablename__ = "fiberloom_schema"

    version: Mapped[int] = mapped_column(primary_key=True)


class RunRow(Summed, Base):
    """One command that moved or measured something."""

    __tablename__ = "runs"

    id: Mapped[int] = mapped_column(primary_key=True)
    utc_start: Mapped[datetime] = mapped_column(DateTime(timezone=True))
    utc_end: Mapped[datetime | None] = mapped_column(DateTime(timezone=True))
    command_line: Mapped[str]
    instrument: Mapped[str]
    config_hash: Mapped[str]
    seed: Mapped[int | None]
    version: Mapped[str]
    status: Mapped[str]  # running, finished, failed, interrupted
    note: Mapped[str]
    # who is running: tells a run that goes on from one whose process was killed
    host: Mapped[str]
    pid: Mapped[int]
    process_start: Mapped[str]
    folder: Mapped[str | None]  # of its files, from that of the store; none: of an older version


class MoveRow(Summed, Base):
    """One move of the whole field."""

    __tablename__ = "moves"

    id: Mapped[int] = mapped_column(primary_key=True)
    run_id: Mapped[int] = mapped_column(ForeignKey("runs.id"), index=True)
    number: Mapped[int]
    kind: Mapped[str]
    utc: Mapped[datetime] = mapped_column(DateTime(timezone=True))
    time_s: Mapped[float | None]  # of the twin or bus
    plan_digest: Mapped[str]
    n_measured: Mapped[int | None]  # measurements that belong to it; none: written before version 4


class MeasurementRow(Summed, Base):
    """One positioner after one move."""

    __tablename__ = "measurements"

    id: Mapped[int] = mapped_column(primary_key=True)
    run_id: Mapped[int] = mapped_column(ForeignKey("runs.id"))
    move_id: Mapped[int] = mapped_column(ForeignKey("moves.id"), index=True)
    positioner_id: Mapped[int]
    x_mm: Mapped[float | None]
    y_mm: Mapped[float | None]
    seen: Mapped[bool]
    alpha_deg: Mapped[float | None]  # commanded
    beta_deg: Mapped[float | None]
    wire_alpha_deg: Mapped[float | None]
    wire_beta_deg: Mapped[float | None]
    target_id: Mapped[str | None]
    x_target_mm: Mapped[float | None]
    y_target_mm: Mapped[float | None]
    error_um: Mapped[float | None]
    status: Mapped[str | None]

    __table_args__ = (Index("measurements_of_positioner", "run_id", "positioner_id"),)


class CalibrationRow(Summed, Base):
    """Which calibration of a positioner's axis a run made or used."""

    __tablename__ = "calibrations"

    id: Mapped[int] = mapped_column(primary_key=True)
    run_id: Mapped[int] = mapped_column(ForeignKey("runs.id"), index=True)
    positioner_id: Mapped[int]
    axis: Mapped[str]
    kind: Mapped[str]
    file: Mapped[str]
    hash: Mapped[str]
    utc: Mapped[datetime] = mapped_column(DateTime(timezone=True))


class EventRow(Summed, Base):
    """Something an operator wants to know later: a collision, a flag, a remark."""

    __tablename__ = "events"

    id: Mapped[int] = mapped_column(primary_key=True)
    run_id: Mapped[int] = mapped_column(ForeignKey("runs.id"), index=True)
    utc: Mapped[datetime] = mapped_column(DateTime(timezone=True))
    time_s: Mapped[float | None]
    positioner_id: Mapped[int | None]
    kind: Mapped[str]
    text: Mapped[str]


class PartRow(Summed, Base):
    """One of the things that the result files of a run are made of, beside moves and measurements."""

    __tablename__ = "parts"

    id: Mapped[int] = mapped_column(primary_key=True)
    run_id: Mapped[int] = mapped_column(ForeignKey("runs.id"), index=True)
    move_id: Mapped[int | None] = mapped_column(ForeignKey("moves.id"))  # none: of the whole run
    name: Mapped[str]
    data: Mapped[bytes] = mapped_column(LargeBinary)  # as `store.parts` packs it


class GenerationRow(Summed, Base):
    """One step of learning: an observation that taught something, or a step back."""

    __tablename__ = "learnt_generations"

    id: Mapped[int] = mapped_column(primary_key=True)
    utc: Mapped[datetime] = mapped_column(DateTime(timezone=True))
    origin: Mapped[str] = mapped_column(index=True)  # digest of the calibration that it builds on
    kind: Mapped[str]  # observe, undo
    instrument: Mapped[str]
    config_hash: Mapped[str]
    seed: Mapped[int | None]
    version: Mapped[str]
    note: Mapped[str]


class LearntRow(Summed, Base):
    """What is known of one positioner since a generation; earlier rows stay."""

    __tablename__ = "learnt_states"

    id: Mapped[int] = mapped_column(primary_key=True)
    generation_id: Mapped[int] = mapped_column(ForeignKey("learnt_generations.id"))
    positioner_id: Mapped[int]
    moves: Mapped[int]  # learnt from since the calibration
    shift_mdeg: Mapped[float]  # rms change of both maps by this generation
    data: Mapped[bytes | None] = mapped_column(LargeBinary)  # none: the calibration itself

    __table_args__ = (Index("learnt_of_positioner", "generation_id", "positioner_id", unique=True),)


class ExclusionRow(Summed, Base):
    """One positioner of an array that must not be moved, until it is cleared or the time is over."""

    __tablename__ = "exclusions"

    id: Mapped[int] = mapped_column(primary_key=True)
    address: Mapped[str] = mapped_column(index=True)  # of the array: that of its bus
    positioner_id: Mapped[int]
    since: Mapped[datetime] = mapped_column(DateTime(timezone=True))
    until: Mapped[datetime | None] = mapped_column(DateTime(timezone=True))  # none: until it is cleared
    who: Mapped[str]
    why: Mapped[str]
    cleared: Mapped[datetime | None] = mapped_column(DateTime(timezone=True))
    cleared_by: Mapped[str]


class ArrayStateRow(Summed, Base):
    """The state of an array and the process that owns it: one motion at a time."""

    __tablename__ = "array_state"

    address: Mapped[str] = mapped_column(primary_key=True)
    state: Mapped[str]
    since: Mapped[datetime] = mapped_column(DateTime(timezone=True))
    text: Mapped[str]  # why it is in this state
    # the owner: no token, no owner
    token: Mapped[str]
    command: Mapped[str]
    host: Mapped[str]
    pid: Mapped[int]
    process_start: Mapped[str]
    heartbeat: Mapped[datetime | None] = mapped_column(DateTime(timezone=True))
    # what another process asks of the owner
    stop_asked_by: Mapped[str]  # empty: nothing


class PlaceRow(Summed, Base):
    """Where one positioner of an array was last, and how that is known."""

    __tablename__ = "places"

    address: Mapped[str] = mapped_column(primary_key=True)
    positioner_id: Mapped[int] = mapped_column(primary_key=True)
    utc: Mapped[datetime] = mapped_column(DateTime(timezone=True))
    alpha_deg: Mapped[float]
    beta_deg: Mapped[float]
    wire_alpha_deg: Mapped[float | None]  # none: it did not answer
    wire_beta_deg: Mapped[float | None]
    how: Mapped[str]  # seen, reported, unknown
    datum: Mapped[bool]  # searched since power came on, as far as is known


class NightRow(Summed, Base):
    """One night: a queue of fields that is worked through. Times are of the night's clock."""

    __tablename__ = "nights"

    id: Mapped[int] = mapped_column(primary_key=True)
    utc_start: Mapped[datetime] = mapped_column(DateTime(timezone=True))
    utc_end: Mapped[datetime | None] = mapped_column(DateTime(timezone=True))
    name: Mapped[str]
    queue: Mapped[str]  # its file
    array: Mapped[str]  # address of its bus
    instrument: Mapped[str]
    config_hash: Mapped[str]
    seed: Mapped[int]
    version: Mapped[str]
    command_line: Mapped[str]
    status: Mapped[str]  # running, finished, failed, interrupted
    note: Mapped[str]
    # which process has it: a night that was left is told from one that goes on
    host: Mapped[str]
    pid: Mapped[int]
    process_start: Mapped[str]


class FieldRow(Summed, Base):
    """One field of a night's queue, as it was last read, and what became of it."""

    __tablename__ = "fields"

    id: Mapped[int] = mapped_column(primary_key=True)
    night_id: Mapped[int] = mapped_column(ForeignKey("nights.id"), index=True)
    name: Mapped[str]
    entry: Mapped[str]  # JSON
    state: Mapped[str]  # queued, prepared, positioning, ready, exposing, done, failed, skipped
    reason: Mapped[str]


class VisitRow(Summed, Base):
    """One try to put the fibres on a field; written before anything moves for it."""

    __tablename__ = "visits"

    id: Mapped[int] = mapped_column(primary_key=True)
    night_id: Mapped[int] = mapped_column(ForeignKey("nights.id"), index=True)
    field: Mapped[str]
    repeat: Mapped[int]  # from 0
    dither: Mapped[int]  # from 0
    attempt: Mapped[int]  # from 1
    state: Mapped[str]  # as of a field
    utc_start: Mapped[datetime] = mapped_column(DateTime(timezone=True))
    utc_end: Mapped[datetime | None] = mapped_column(DateTime(timezone=True))
    run_id: Mapped[int | None] = mapped_column(ForeignKey("runs.id"))  # its moves, goals and measurements
    plan_digest: Mapped[str | None]  # of the blind move
    plan_from: Mapped[str | None]  # ahead, or why it was planned anew
    on_target: Mapped[int | None]
    assigned: Mapped[int | None]
    rms_um: Mapped[float | None]
    note: Mapped[str]


class StageRow(Summed, Base):
    """One stage of a visit or of the night, when it has ended."""

    __tablename__ = "stages"

    id: Mapped[int] = mapped_column(primary_key=True)
    night_id: Mapped[int] = mapped_column(ForeignKey("nights.id"), index=True)
    visit_id: Mapped[int | None] = mapped_column(ForeignKey("visits.id"))
    name: Mapped[str]
    utc_start: Mapped[datetime] = mapped_column(DateTime(timezone=True))
    duration_s: Mapped[float]  # of the night's clock
    wall_s: Mapped[float]  # of this machine
    outcome: Mapped[str]  # done, or what went wrong


class ExposureRow(Summed, Base):
    """One exposure; written before the shutter is asked to open."""

    __tablename__ = "exposures"

    id: Mapped[int] = mapped_column(primary_key=True)
    night_id: Mapped[int] = mapped_column(ForeignKey("nights.id"), index=True)
    visit_id: Mapped[int] = mapped_column(ForeignKey("visits.id"), index=True)
    number: Mapped[int]  # from 1
    key: Mapped[str] = mapped_column(unique=True)  # the shutter opens once for it
    asked_s: Mapped[float]
    utc_start: Mapped[datetime | None] = mapped_column(DateTime(timezone=True))  # none: it has not opened
    utc_end: Mapped[datetime | None] = mapped_column(DateTime(timezone=True))  # none: not known to be closed


class CommandRow(Summed, Base):
    """One command to an array, or to its night, that came from a person or a program."""

    __tablename__ = "commands"

    id: Mapped[int] = mapped_column(primary_key=True)
    address: Mapped[str] = mapped_column(index=True)  # of the array: that of its bus
    night_id: Mapped[int | None] = mapped_column(ForeignKey("nights.id"), index=True)
    utc: Mapped[datetime] = mapped_column(DateTime(timezone=True))
    author: Mapped[str]
    role: Mapped[str]
    command: Mapped[str]
    parameters: Mapped[str]  # JSON
    key: Mapped[str]  # one that comes twice is done once; empty: none was given
    utc_end: Mapped[datetime | None] = mapped_column(DateTime(timezone=True))  # none: it goes on
    result: Mapped[str]  # running, done, failed, stopped, refused
    text: Mapped[str]


class AlarmRow(Summed, Base):
    """One alarm of an array, or of its night, from when it was raised until it is gone and acknowledged."""

    __tablename__ = "alarms"

    id: Mapped[int] = mapped_column(primary_key=True)
    address: Mapped[str] = mapped_column(index=True)
    night_id: Mapped[int | None] = mapped_column(ForeignKey("nights.id"), index=True)
    code: Mapped[str]
    severity: Mapped[str]
    subject: Mapped[str]  # a positioner's number, or a part of the array
    since: Mapped[datetime] = mapped_column(DateTime(timezone=True))
    last: Mapped[datetime] = mapped_column(DateTime(timezone=True))
    count: Mapped[int]
    text: Mapped[str]
    advice: Mapped[str]
    gone: Mapped[datetime | None] = mapped_column(DateTime(timezone=True))  # none: the cause is there
    acknowledged: Mapped[datetime | None] = mapped_column(DateTime(timezone=True))
    acknowledged_by: Mapped[str]
