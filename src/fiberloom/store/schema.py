"""The tables. Lengths in mm, errors in um, angles in deg, times in UTC or in s of the run's clock.

NULL is "not known": a fibre that was not seen has no place, a parked positioner no target.
"""

from __future__ import annotations

from typing import Any

from sqlalchemy import (
    BigInteger,
    Boolean,
    Column,
    DateTime,
    Double,
    ForeignKey,
    Index,
    Integer,
    LargeBinary,
    MetaData,
    String,
    Table,
)

SCHEMA_VERSION = 6
"""2: what was learnt of the maps in operation. 3: arrays: exclusions, state and owner, places. 4: sums of
rows. 5: sums also of rows that change, the folder of a run, and what its files are made of. 6: nights;
commands and alarms of arrays. The steps from one to the next are in `upkeep/revisions`. Rows of before
version 5 have no sums until they change."""

TABLES = MetaData()
"""All of them."""
SUM = "row_sum"
"""Column of the sum over all else in a row, so that a flipped bit is found on reading."""
_TIME = DateTime(timezone=True)


def _given(name: str, kind: Any, *more: Any, **how: Any) -> Column[Any]:
    """A column that every row has."""
    return Column(name, kind, *more, nullable=False, **how)


def _maybe(name: str, kind: Any, *more: Any, **how: Any) -> Column[Any]:
    """A column that may be NULL."""
    return Column(name, kind, *more, nullable=True, **how)


def _number() -> Column[Any]:
    """The database's own number of a row."""
    return _given("id", Integer, primary_key=True)


def _process() -> tuple[Column[Any], ...]:
    """Which process has it: one that goes on is told from one whose process is gone."""
    return _given("host", String), _given("pid", Integer), _given("process_start", String)


def _summed(name: str, *columns: Any) -> Table:
    """A table whose rows have a sum; none: of an older version."""
    return Table(name, TABLES, *columns, _maybe(SUM, BigInteger))


SCHEMA = Table(
    "fiberloom_schema",
    TABLES,
    _given("version", Integer, primary_key=True),
)
"""One row: the version of the tables."""

RUNS = _summed(
    "runs",
    _number(),
    _given("utc_start", _TIME),
    _maybe("utc_end", _TIME),
    _given("command_line", String),
    _given("instrument", String),
    _given("config_hash", String),
    _maybe("seed", Integer),
    _given("version", String),
    _given("status", String),  # running, finished, failed, interrupted
    _given("note", String),
    *_process(),
    _maybe("folder", String),  # of its files, from that of the store; none: of an older version
)
"""One command that moved or measured something."""

MOVES = _summed(
    "moves",
    _number(),
    _given("run_id", Integer, ForeignKey("runs.id"), index=True),
    _given("number", Integer),
    _given("kind", String),
    _given("utc", _TIME),
    _maybe("time_s", Double),  # of the twin or bus
    _given("plan_digest", String),
    _maybe("n_measured", Integer),  # measurements that belong to it; none: written before version 4
)
"""One move of the whole field."""

MEASUREMENTS = _summed(
    "measurements",
    _number(),
    _given("run_id", Integer, ForeignKey("runs.id")),
    _given("move_id", Integer, ForeignKey("moves.id"), index=True),
    _given("positioner_id", Integer),
    _maybe("x_mm", Double),
    _maybe("y_mm", Double),
    _given("seen", Boolean),
    _maybe("alpha_deg", Double),  # commanded
    _maybe("beta_deg", Double),
    _maybe("wire_alpha_deg", Double),
    _maybe("wire_beta_deg", Double),
    _maybe("target_id", String),
    _maybe("x_target_mm", Double),
    _maybe("y_target_mm", Double),
    _maybe("error_um", Double),
    _maybe("status", String),
    Index("measurements_of_positioner", "run_id", "positioner_id"),
)
"""One positioner after one move."""

CALIBRATIONS = _summed(
    "calibrations",
    _number(),
    _given("run_id", Integer, ForeignKey("runs.id"), index=True),
    _given("positioner_id", Integer),
    _given("axis", String),
    _given("kind", String),
    _given("file", String),
    _given("hash", String),
    _given("utc", _TIME),
)
"""Which calibration of a positioner's axis a run made or used."""

EVENTS = _summed(
    "events",
    _number(),
    _given("run_id", Integer, ForeignKey("runs.id"), index=True),
    _given("utc", _TIME),
    _maybe("time_s", Double),
    _maybe("positioner_id", Integer),
    _given("kind", String),
    _given("text", String),
)
"""Something an operator wants to know later: a collision, a flag, a remark."""

PARTS = _summed(
    "parts",
    _number(),
    _given("run_id", Integer, ForeignKey("runs.id"), index=True),
    _maybe("move_id", Integer, ForeignKey("moves.id")),  # none: of the whole run
    _given("name", String),
    _given("data", LargeBinary),  # as `store.parts` packs it
)
"""One of the things that the result files of a run are made of, beside moves and measurements."""

GENERATIONS = _summed(
    "learnt_generations",
    _number(),
    _given("utc", _TIME),
    _given("origin", String, index=True),  # digest of the calibration that it builds on
    _given("kind", String),  # observe, undo
    _given("instrument", String),
    _given("config_hash", String),
    _maybe("seed", Integer),
    _given("version", String),
    _given("note", String),
)
"""One step of learning: an observation that taught something, or a step back."""

LEARNT = _summed(
    "learnt_states",
    _number(),
    _given("generation_id", Integer, ForeignKey("learnt_generations.id")),
    _given("positioner_id", Integer),
    _given("moves", Integer),  # learnt from since the calibration
    _given("shift_mdeg", Double),  # rms change of both maps by this generation
    _maybe("data", LargeBinary),  # none: the calibration itself
    Index("learnt_of_positioner", "generation_id", "positioner_id", unique=True),
)
"""What is known of one positioner since a generation; earlier rows stay."""

EXCLUSIONS = _summed(
    "exclusions",
    _number(),
    _given("address", String, index=True),  # of the array: that of its bus
    _given("positioner_id", Integer),
    _given("since", _TIME),
    _maybe("until", _TIME),  # none: until it is cleared
    _given("who", String),
    _given("why", String),
    _maybe("cleared", _TIME),
    _given("cleared_by", String),
)
"""One positioner of an array that must not be moved, until it is cleared or the time is over."""

ARRAY_STATE = _summed(
    "array_state",
    _given("address", String, primary_key=True),
    _given("state", String),
    _given("since", _TIME),
    _given("text", String),  # why it is in this state
    # the owner: no token, no owner
    _given("token", String),
    _given("command", String),
    *_process(),
    _maybe("heartbeat", _TIME),
    # what another process asks of the owner
    _given("stop_asked_by", String),  # empty: nothing
)
"""The state of an array and the process that owns it: one motion at a time."""

PLACES = _summed(
    "places",
    _given("address", String, primary_key=True),
    _given("positioner_id", Integer, primary_key=True),
    _given("utc", _TIME),
    _given("alpha_deg", Double),
    _given("beta_deg", Double),
    _maybe("wire_alpha_deg", Double),  # none: it did not answer
    _maybe("wire_beta_deg", Double),
    _given("how", String),  # seen, reported, unknown
    _given("datum", Boolean),  # searched since power came on, as far as is known
)
"""Where one positioner of an array was last, and how that is known."""

NIGHTS = _summed(
    "nights",
    _number(),
    _given("utc_start", _TIME),
    _maybe("utc_end", _TIME),
    _given("name", String),
    _given("queue", String),  # its file
    _given("array", String),  # address of its bus
    _given("instrument", String),
    _given("config_hash", String),
    _given("seed", Integer),
    _given("version", String),
    _given("command_line", String),
    _given("status", String),  # running, finished, failed, interrupted
    _given("note", String),
    *_process(),
)
"""One night: a queue of fields that is worked through. Times are of the night's clock."""

FIELDS = _summed(
    "fields",
    _number(),
    _given("night_id", Integer, ForeignKey("nights.id"), index=True),
    _given("name", String),
    _given("entry", String),  # JSON
    _given("state", String),  # queued, prepared, positioning, ready, exposing, done, failed, skipped
    _given("reason", String),
)
"""One field of a night's queue, as it was last read, and what became of it."""

VISITS = _summed(
    "visits",
    _number(),
    _given("night_id", Integer, ForeignKey("nights.id"), index=True),
    _given("field", String),
    _given("repeat", Integer),  # from 0
    _given("dither", Integer),  # from 0
    _given("attempt", Integer),  # from 1
    _given("state", String),  # as of a field
    _given("utc_start", _TIME),
    _maybe("utc_end", _TIME),
    _maybe("run_id", Integer, ForeignKey("runs.id")),  # its moves, goals and measurements
    _maybe("plan_digest", String),  # of the blind move
    _maybe("plan_from", String),  # ahead, or why it was planned anew
    _maybe("on_target", Integer),
    _maybe("assigned", Integer),
    _maybe("rms_um", Double),
    _given("note", String),
)
"""One try to put the fibres on a field; written before anything moves for it."""

STAGES = _summed(
    "stages",
    _number(),
    _given("night_id", Integer, ForeignKey("nights.id"), index=True),
    _maybe("visit_id", Integer, ForeignKey("visits.id")),
    _given("name", String),
    _given("utc_start", _TIME),
    _given("duration_s", Double),  # of the night's clock
    _given("wall_s", Double),  # of this machine
    _given("outcome", String),  # done, or what went wrong
)
"""One stage of a visit or of the night, when it has ended."""

EXPOSURES = _summed(
    "exposures",
    _number(),
    _given("night_id", Integer, ForeignKey("nights.id"), index=True),
    _given("visit_id", Integer, ForeignKey("visits.id"), index=True),
    _given("number", Integer),  # from 1
    _given("key", String, unique=True),  # the shutter opens once for it
    _given("asked_s", Double),
    _maybe("utc_start", _TIME),  # none: it has not opened
    _maybe("utc_end", _TIME),  # none: not known to be closed
)
"""One exposure; written before the shutter is asked to open."""

COMMANDS = _summed(
    "commands",
    _number(),
    _given("address", String, index=True),  # of the array: that of its bus
    _maybe("night_id", Integer, ForeignKey("nights.id"), index=True),
    _given("utc", _TIME),
    _given("author", String),
    _given("role", String),
    _given("command", String),
    _given("parameters", String),  # JSON
    _given("key", String),  # one that comes twice is done once; empty: none was given
    _maybe("utc_end", _TIME),  # none: it goes on
    _given("result", String),  # running, done, failed, stopped, refused
    _given("text", String),
)
"""One command to an array, or to its night, that came from a person or a program."""

ALARMS = _summed(
    "alarms",
    _number(),
    _given("address", String, index=True),
    _maybe("night_id", Integer, ForeignKey("nights.id"), index=True),
    _given("code", String),
    _given("severity", String),
    _given("subject", String),  # a positioner's number, or a part of the array
    _given("since", _TIME),
    _given("last", _TIME),
    _given("count", Integer),
    _given("text", String),
    _given("advice", String),
    _maybe("gone", _TIME),  # none: the cause is there
    _maybe("acknowledged", _TIME),
    _given("acknowledged_by", String),
)
"""One alarm of an array, or of its night, from when it was raised until it is gone and acknowledged."""
