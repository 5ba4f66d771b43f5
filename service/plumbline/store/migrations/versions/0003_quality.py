"""What each epoch's solution is worth."""

import sqlalchemy as sa
from alembic import op

revision = "0003"
down_revision = "0002"
branch_labels = None
depends_on = None

NAME = sa.Text().with_variant(sa.Text(collation="C"), "postgresql")


def upgrade() -> None:
    """Add the table of quality reports."""
    op.create_table(
        "quality",
        sa.Column("station", NAME, primary_key=True, nullable=False, autoincrement=False),
        sa.Column("t_gps_ns", sa.BigInteger, primary_key=True, nullable=False, autoincrement=False),
        sa.Column("t_receive_ns", sa.BigInteger, nullable=False),
        sa.Column("observations", sa.Integer, nullable=False),
        sa.Column("rejected", sa.Integer, nullable=False),
        sa.Column("protection_horizontal_m", sa.Double),
        sa.Column("protection_vertical_m", sa.Double),
        sa.Column("report", sa.LargeBinary, nullable=False),
    )


def downgrade() -> None:
    """Drop it."""
    op.drop_table("quality")
