"""Results on disk: SQLite by default, PostgreSQL with the same code. SQL lives here and nowhere else.

Store          the asynchronous face: one writer thread, a few reader threads
rows           what goes in and comes out beyond the records
tables         the tables; ``migrations`` (Alembic) makes and changes them
engine         connections: pragmas, URLs, the upgrade at opening
writing        a batch of outputs and checkpoints, one transaction
motion_codec   a motion block as bytes
summaries      minima, maxima, means and RMS of motion at 1 s, 1 min, 1 h, 1 day
reading        solutions and motion by time
registry       stations, thresholds, devices, status, checkpoints
alert_log      alerts and their life
"""

from plumbline.store.rows import (
    AlertNote,
    AlertRow,
    BlockHead,
    Checkpoint,
    Device,
    MotionSeries,
    MotionSummary,
    Page,
    StationRow,
)
from plumbline.store.store import Store, database_url

__all__ = [
    "AlertNote",
    "AlertRow",
    "BlockHead",
    "Checkpoint",
    "Device",
    "MotionSeries",
    "MotionSummary",
    "Page",
    "StationRow",
    "Store",
    "database_url",
]
