"""The attitude of platforms."""

import sqlalchemy as sa
from alembic import op

revision = "0004"
down_revision = "0003"
branch_labels = None
depends_on = None

COLUMNS = ("roll_rad", "pitch_rad", "heading_rad", "sigma_roll_rad", "sigma_pitch_rad", "sigma_heading_rad")


def upgrade() -> None:
    """Add the angles and their sigmas to the solutions."""
    for name in COLUMNS:
        op.add_column("solutions", sa.Column(name, sa.Double))


def downgrade() -> None:
    """Drop them."""
    for name in COLUMNS:
        op.drop_column("solutions", name)
