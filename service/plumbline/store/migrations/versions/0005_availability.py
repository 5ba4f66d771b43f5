"""When the server was up, and what each station delivered in each day."""

import sqlalchemy as sa
from alembic import op

revision = "0005"
down_revision = "0004"
branch_labels = None
depends_on = None

NAME = sa.Text().with_variant(sa.Text(collation="C"), "postgresql")


def upgrade() -> None:
    """Add the tables."""
    op.create_table(
        "uptimes",
        sa.Column("t_start_gps_ns", sa.BigInteger, primary_key=True, nullable=False, autoincrement=False),
        sa.Column("t_last_gps_ns", sa.BigInteger, nullable=False),
    )
    op.create_table(
        "availability",
        sa.Column("station", NAME, primary_key=True, nullable=False, autoincrement=False),
        sa.Column("t_first_gps_ns", sa.BigInteger, primary_key=True, nullable=False, autoincrement=False),
        sa.Column("t_end_gps_ns", sa.BigInteger, nullable=False),
        sa.Column("counts", sa.Text, nullable=False),
    )


def downgrade() -> None:
    """Drop them."""
    op.drop_table("availability")
    op.drop_table("uptimes")
