"""Version 2: what was learnt of the maps in operation."""

import sqlalchemy as sa
from alembic import op

revision, down_revision = "2", "1"


def upgrade() -> None:
    """Makes the two tables."""
    op.create_table(
        "learnt_generations",
        sa.Column("id", sa.Integer, primary_key=True),
        sa.Column("utc", sa.DateTime(timezone=True), nullable=False),
        *(sa.Column(name, sa.String, nullable=False) for name in ("origin", "kind", "instrument")),
        sa.Column("config_hash", sa.String, nullable=False),
        sa.Column("seed", sa.Integer),
        *(sa.Column(name, sa.String, nullable=False) for name in ("version", "note")),
    )
    op.create_index("ix_learnt_generations_origin", "learnt_generations", ["origin"])
    op.create_table(
        "learnt_states",
        sa.Column("id", sa.Integer, primary_key=True),
        sa.Column("generation_id", sa.Integer, sa.ForeignKey("learnt_generations.id"), nullable=False),
        *(sa.Column(name, sa.Integer, nullable=False) for name in ("positioner_id", "moves")),
        sa.Column("shift_mdeg", sa.Double, nullable=False),
        sa.Column("data", sa.LargeBinary),
    )
    op.create_index("learnt_of_positioner", "learnt_states", ["generation_id", "positioner_id"], unique=True)
