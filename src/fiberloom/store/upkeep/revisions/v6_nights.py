"""Version 6: nights: fields of a queue, visits, stages, exposures, commands, alarms."""

from typing import Any

import sqlalchemy as sa
from alembic import op

revision, down_revision = "6", "5"


def _texts(*names: str) -> list[sa.Column[Any]]:
    return [sa.Column(name, sa.String, nullable=False) for name in names]


def _numbers(*names: str) -> list[sa.Column[Any]]:
    return [sa.Column(name, sa.Integer, nullable=False) for name in names]


def _times(*names: str, nullable: bool = False) -> list[sa.Column[Any]]:
    return [sa.Column(name, sa.DateTime(timezone=True), nullable=nullable) for name in names]


def _of(table: str, nullable: bool = False) -> sa.Column[Any]:
    return sa.Column(f"{table}_id", sa.Integer, sa.ForeignKey(f"{table}s.id"), nullable=nullable)


def _make(name: str, *columns: sa.Column[Any]) -> None:
    op.create_table(
        name, sa.Column("id", sa.Integer, primary_key=True), *columns, sa.Column("row_sum", sa.BigInteger)
    )


def upgrade() -> None:
    """Makes the seven tables."""
    _queue_and_visits()
    _what_happened()
    for table in ("fields", "visits", "stages", "exposures", "commands", "alarms"):
        op.create_index(f"ix_{table}_night_id", table, ["night_id"])
    for table in ("commands", "alarms"):
        op.create_index(f"ix_{table}_address", table, ["address"])
    op.create_index("ix_exposures_visit_id", "exposures", ["visit_id"])


def _queue_and_visits() -> None:
    _make(
        "nights",
        *_times("utc_start"),
        *_times("utc_end", nullable=True),
        *_texts("name", "queue", "array", "instrument", "config_hash"),
        *_numbers("seed"),
        *_texts("version", "command_line", "status", "note", "host"),
        *_numbers("pid"),
        *_texts("process_start"),
    )
    _make("fields", _of("night"), *_texts("name", "entry", "state", "reason"))
    _make(
        "visits",
        _of("night"),
        *_texts("field"),
        *_numbers("repeat", "dither", "attempt"),
        *_texts("state"),
        *_times("utc_start"),
        *_times("utc_end", nullable=True),
        _of("run", nullable=True),
        *(sa.Column(name, sa.String) for name in ("plan_digest", "plan_from")),
        *(sa.Column(name, sa.Integer) for name in ("on_target", "assigned")),
        sa.Column("rms_um", sa.Double),
        *_texts("note"),
    )


def _what_happened() -> None:
    _make(
        "stages",
        _of("night"),
        _of("visit", nullable=True),
        *_texts("name"),
        *_times("utc_start"),
        *(sa.Column(name, sa.Double, nullable=False) for name in ("duration_s", "wall_s")),
        *_texts("outcome"),
    )
    _make(
        "exposures",
        *(_of("night"), _of("visit")),
        *_numbers("number"),
        sa.Column("key", sa.String, nullable=False, unique=True),
        sa.Column("asked_s", sa.Double, nullable=False),
        *_times("utc_start", "utc_end", nullable=True),
    )
    _make(
        "commands",
        *_texts("address"),
        _of("night", nullable=True),
        *_times("utc"),
        *_texts("author", "role", "command", "parameters", "key"),
        *_times("utc_end", nullable=True),
        *_texts("result", "text"),
    )
    _make(
        "alarms",
        *_texts("address"),
        _of("night", nullable=True),
        *_texts("code", "severity", "subject"),
        *_times("since", "last"),
        *_numbers("count"),
        *_texts("text", "advice"),
        *_times("gone", "acknowledged", nullable=True),
        *_texts("acknowledged_by"),
    )
