"""Version 1: runs, moves, measurements, calibrations, events."""

import sqlalchemy as sa
from alembic import op

revision, down_revision = "1", None

UTC = sa.DateTime(timezone=True)


def _of_run() -> sa.Column[int]:
    return sa.Column("run_id", sa.Integer, sa.ForeignKey("runs.id"), nullable=False)


def _number() -> sa.Column[int]:
    return sa.Column("id", sa.Integer, primary_key=True)


def upgrade() -> None:
    """Makes the tables; `fiberloom_schema` is there."""
    op.create_table(
        "runs",
        _number(),
        sa.Column("utc_start", UTC, nullable=False),
        sa.Column("utc_end", UTC),
        *(sa.Column(name, sa.String, nullable=False) for name in ("command_line", "instrument")),
        sa.Column("config_hash", sa.String, nullable=False),
        sa.Column("seed", sa.Integer),
        *(sa.Column(name, sa.String, nullable=False) for name in ("version", "status", "note", "host")),
        sa.Column("pid", sa.Integer, nullable=False),
        sa.Column("process_start", sa.String, nullable=False),
    )
    op.create_table(
        "moves",
        _number(),
        _of_run(),
        sa.Column("number", sa.Integer, nullable=False),
        sa.Column("kind", sa.String, nullable=False),
        sa.Column("utc", UTC, nullable=False),
        sa.Column("time_s", sa.Double),
        sa.Column("plan_digest", sa.String, nullable=False),
    )
    op.create_table(
        "measurements",
        _number(),
        _of_run(),
        sa.Column("move_id", sa.Integer, sa.ForeignKey("moves.id"), nullable=False),
        sa.Column("positioner_id", sa.Integer, nullable=False),
        *(sa.Column(name, sa.Double) for name in ("x_mm", "y_mm")),
        sa.Column("seen", sa.Boolean, nullable=False),
        *(sa.Column(f"{name}_deg", sa.Double) for name in ("alpha", "beta", "wire_alpha", "wire_beta")),
        sa.Column("target_id", sa.String),
        *(sa.Column(name, sa.Double) for name in ("x_target_mm", "y_target_mm", "error_um")),
        sa.Column("status", sa.String),
    )
    op.create_table(
        "calibrations",
        _number(),
        _of_run(),
        sa.Column("positioner_id", sa.Integer, nullable=False),
        *(sa.Column(name, sa.String, nullable=False) for name in ("axis", "kind", "file", "hash")),
        sa.Column("utc", UTC, nullable=False),
    )
    op.create_table(
        "events",
        _number(),
        _of_run(),
        sa.Column("utc", UTC, nullable=False),
        sa.Column("time_s", sa.Double),
        sa.Column("positioner_id", sa.Integer),
        *(sa.Column(name, sa.String, nullable=False) for name in ("kind", "text")),
    )
    for table, column in (
        *(("moves", "run_id"), ("measurements", "move_id")),
        *(("calibrations", "run_id"), ("events", "run_id")),
    ):
        op.create_index(f"ix_{table}_{column}", table, [column])
    op.create_index("measurements_of_positioner", "measurements", ["run_id", "positioner_id"])
