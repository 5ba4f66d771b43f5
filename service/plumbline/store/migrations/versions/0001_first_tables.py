"""The first tables."""

import sqlalchemy as sa
from alembic import op

revision = "0001"
down_revision = None
branch_labels = None
depends_on = None

NAME = sa.Text().with_variant(sa.Text(collation="C"), "postgresql")
CHANNELS = [
    f"{kind}_{axis}_{statistic}" for kind in "dva" for axis in "enu" for statistic in ("min", "max", "mean", "rms")
]
POSITIONS = ["x_ecef_m", "y_ecef_m", "z_ecef_m", "e_m", "n_m", "u_m"]
COVARIANCES = [f"cov_{pair}_m2" for pair in ("ee", "en", "eu", "nn", "nu", "uu")]
VELOCITIES = ["ve_m_s", "vn_m_s", "vu_m_s"]
SERIES = ("alert_history", "alerts", "motion_summaries", "motion", "solutions")
REGISTRY = ("checkpoints", "devices", "station_status", "thresholds", "stations")


def _key(name: str, kind: object = NAME) -> sa.Column:  # type: ignore[type-arg]
    return sa.Column(name, kind, primary_key=True, nullable=False, autoincrement=False)  # type: ignore[arg-type]


def _texts(*names: str) -> list[sa.Column]:  # type: ignore[type-arg]
    return [sa.Column(name, sa.Text, nullable=False) for name in names]


def _names(*names: str) -> list[sa.Column]:  # type: ignore[type-arg]
    return [sa.Column(name, NAME, nullable=False) for name in names]


def _times(*names: str) -> list[sa.Column]:  # type: ignore[type-arg]
    return [sa.Column(name, sa.BigInteger, nullable=False) for name in names]


def _counts(*names: str) -> list[sa.Column]:  # type: ignore[type-arg]
    return [sa.Column(name, sa.Integer, nullable=False) for name in names]


def _reals(*names: str) -> list[sa.Column]:  # type: ignore[type-arg]
    return [sa.Column(name, sa.Double, nullable=False) for name in names]


def _perhaps(*names: str) -> list[sa.Column]:  # type: ignore[type-arg]
    return [sa.Column(name, sa.Double) for name in names]


def _registry() -> None:
    times = _times("created_gps_ns", "changed_gps_ns")
    op.create_table("stations", _key("station"), *_texts("settings"), *_counts("version"), *times)
    op.create_table(
        "thresholds",
        _key("threshold_id"),
        *_names("station"),
        *_texts("quantity"),
        *_reals("level"),
        *_texts("severity"),
        *_reals("on_delay_s", "off_delay_s", "dead_band"),
        *_counts("enabled"),
    )
    op.create_index("thresholds_by_station", "thresholds", ["station"])
    op.create_table(
        "station_status",
        _key("station"),
        *_times("t_receive_ns"),
        *_texts("state", "reason"),
        sa.Column("last_epoch_gps_ns", sa.BigInteger),
        sa.Column("solution_status", sa.Text),
        *_counts("n_satellites"),
        *_texts("counters"),
    )
    op.create_table(
        "devices",
        _key("identity"),
        *_texts("address"),
        *_times("first_seen_gps_ns", "last_seen_gps_ns"),
        *_counts("attempts"),
        *_texts("reason"),
        sa.Column("station", NAME),
    )
    state = sa.Column("state", sa.LargeBinary, nullable=False)
    op.create_table("checkpoints", _key("station"), *_times("t_receive_ns"), state, *_texts("consumed"))


def _series() -> None:
    op.create_table(
        "solutions",
        _key("station"),
        _key("t_gps_ns", sa.BigInteger),
        *_times("t_receive_ns"),
        *_texts("status", "reason"),
        *_counts("n_satellites"),
        *_perhaps(*POSITIONS, *COVARIANCES, *VELOCITIES),
        *_texts("systems"),
        *_perhaps("zenith_delay_m", "receiver_clock_s", "correction_age_s", "pdop"),
        sa.Column("extras", sa.Text),
        sqlite_with_rowid=False,
    )
    op.create_table(
        "motion",
        _key("station"),
        _key("t_first_gps_ns", sa.BigInteger),
        *_counts("n"),
        *_times("interval_ns", "t_receive_ns"),
        *_texts("status"),
        *_counts("revision"),
        sa.Column("samples", sa.LargeBinary, nullable=False),
    )
    op.create_table(
        "motion_summaries",
        _key("station"),
        _key("bucket_s", sa.Integer),
        _key("t_gps_ns", sa.BigInteger),
        *_counts("count"),
        *_perhaps(*CHANNELS, "sigma_e", "sigma_n", "sigma_u"),
        sqlite_with_rowid=False,
    )


def _alerts() -> None:
    op.create_table(
        "alerts",
        _key("alert_id"),
        *_names("station", "threshold_id"),
        *_texts("quantity", "severity"),
        *_reals("level", "value"),
        *_texts("text"),
        *_times("t_onset_gps_ns", "t_active_gps_ns"),
        sa.Column("t_acknowledged_gps_ns", sa.BigInteger),
        *_texts("acknowledged_by"),
        sa.Column("t_cleared_gps_ns", sa.BigInteger),
    )
    op.create_index("alerts_by_time", "alerts", ["t_active_gps_ns", "alert_id"])
    op.create_index("alerts_by_station", "alerts", ["station", "t_active_gps_ns"])
    keys = [_key("alert_id"), _key("t_gps_ns", sa.BigInteger), _key("kind", sa.Text)]
    op.create_table("alert_history", *keys, *_texts("by", "text"), sa.Column("value", sa.Double))


def upgrade() -> None:
    """Make every table."""
    _registry()
    _series()
    _alerts()


def downgrade() -> None:
    """Drop every table."""
    for table in (*SERIES, *REGISTRY):
        op.drop_table(table)
