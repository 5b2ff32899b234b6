"""Version 4: sums of rows that are written once, and the number of measurements of a move."""

import sqlalchemy as sa
from alembic import op

revision, down_revision = "4", "3"


def upgrade() -> None:
    """Adds the columns; rows that are there have no sums."""
    for table in ("moves", "measurements", "calibrations", "events", "learnt_states", "places"):
        with op.batch_alter_table(table) as batch:
            batch.add_column(sa.Column("row_sum", sa.BigInteger))
    with op.batch_alter_table("moves") as batch:
        batch.add_column(sa.Column("n_measured", sa.Integer))
