"""Version 3: arrays: exclusions, state and owner, places."""

import sqlalchemy as sa
from alembic import op

revision, down_revision = "3", "2"

UTC = sa.DateTime(timezone=True)


def upgrade() -> None:
    """Makes the three tables."""
    op.create_table(
        "exclusions",
        sa.Column("id", sa.Integer, primary_key=True),
        sa.Column("address", sa.String, nullable=False),
        sa.Column("positioner_id", sa.Integer, nullable=False),
        sa.Column("since", UTC, nullable=False),
        sa.Column("until", UTC),
        *(sa.Column(name, sa.String, nullable=False) for name in ("who", "why")),
        sa.Column("cleared", UTC),
        sa.Column("cleared_by", sa.String, nullable=False),
    )
    op.create_index("ix_exclusions_address", "exclusions", ["address"])
    op.create_table(
        "array_state",
        sa.Column("address", sa.String, primary_key=True),
        sa.Column("state", sa.String, nullable=False),
        sa.Column("since", UTC, nullable=False),
        *(sa.Column(name, sa.String, nullable=False) for name in ("text", "token", "command", "host")),
        sa.Column("pid", sa.Integer, nullable=False),
        sa.Column("process_start", sa.String, nullable=False),
        sa.Column("heartbeat", UTC),
        sa.Column("stop_asked_by", sa.String, nullable=False),
    )
    op.create_table(
        "places",
        sa.Column("address", sa.String, primary_key=True),
        sa.Column("positioner_id", sa.Integer, primary_key=True, autoincrement=False),
        sa.Column("utc", UTC, nullable=False),
        *(sa.Column(name, sa.Double, nullable=False) for name in ("alpha_deg", "beta_deg")),
        *(sa.Column(name, sa.Double) for name in ("wire_alpha_deg", "wire_beta_deg")),
        sa.Column("how", sa.String, nullable=False),
        sa.Column("datum", sa.Boolean, nullable=False),
    )
