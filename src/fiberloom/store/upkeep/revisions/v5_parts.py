"""Version 5: sums also of rows that change, the folder of a run, and what its files are made of."""

import sqlalchemy as sa
from alembic import op

revision, down_revision = "5", "4"


def upgrade() -> None:
    """Adds columns and a table; rows that are there have no sums until they change."""
    for table in ("runs", "learnt_generations", "exclusions", "array_state"):
        with op.batch_alter_table(table) as batch:
            batch.add_column(sa.Column("row_sum", sa.BigInteger))
    with op.batch_alter_table("runs") as batch:
        batch.add_column(sa.Column("folder", sa.String))
    op.create_table(
        "parts",
        sa.Column("id", sa.Integer, primary_key=True),
        sa.Column("run_id", sa.Integer, sa.ForeignKey("runs.id"), nullable=False),
        sa.Column("move_id", sa.Integer, sa.ForeignKey("moves.id")),
        sa.Column("name", sa.String, nullable=False),
        sa.Column("data", sa.LargeBinary, nullable=False),
        sa.Column("row_sum", sa.BigInteger),
    )
    op.create_index("ix_parts_run_id", "parts", ["run_id"])
