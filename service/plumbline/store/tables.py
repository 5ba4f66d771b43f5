"""The tables. Times are GPS ns in 64-bit integers, units SI; JSON is text. Migrations in ``migrations`` make them."""

from typing import Final

from sqlalchemy import BigInteger, Column, Double, Index, Integer, LargeBinary, MetaData, Table, Text

NAME: Final = Text().with_variant(Text(collation="C"), "postgresql")  # ids compare by byte on either database

metadata: Final = MetaData()

#: The nine quantities of a summary row, in the order of :class:`plumbline.store.rows.MotionSummary`'s columns.
CHANNELS: Final = tuple(f"{kind}_{axis}" for kind in ("d", "v", "a") for axis in ("e", "n", "u"))
STATISTICS: Final = ("min", "max", "mean", "rms")
SIGMAS: Final = ("sigma_e", "sigma_n", "sigma_u")


def _required(name: str, kind: object = BigInteger, **keywords: bool) -> Column:  # type: ignore[type-arg]
    return Column(name, kind, nullable=False, **keywords)  # type: ignore[arg-type]


def _key(name: str, kind: object = NAME) -> Column:  # type: ignore[type-arg]
    return Column(name, kind, primary_key=True, nullable=False, autoincrement=False)  # type: ignore[arg-type]


def _numbers(*names: str) -> list[Column[float]]:
    return [Column(name, Double) for name in names]


stations = Table(
    "stations",
    metadata,
    _key("station"),
    _required("settings", Text),
    _required("version", Integer),
    _required("created_gps_ns"),
    _required("changed_gps_ns"),
)

thresholds = Table(
    "thresholds",
    metadata,
    _key("threshold_id"),
    _required("station", NAME),
    _required("quantity", Text),
    _required("level", Double),
    _required("severity", Text),
    _required("on_delay_s", Double),
    _required("off_delay_s", Double),
    _required("dead_band", Double),
    _required("enabled", Integer),
    Index("thresholds_by_station", "station"),
)

solutions = Table(
    "solutions",
    metadata,
    _key("station"),
    _key("t_gps_ns", BigInteger),
    _required("t_receive_ns"),
    _required("status", Text),
    _required("reason", Text),
    _required("n_satellites", Integer),
    *_numbers("x_ecef_m", "y_ecef_m", "z_ecef_m", "e_m", "n_m", "u_m"),
    *_numbers(
        "cov_ee_m2", "cov_en_m2", "cov_eu_m2", "cov_nn_m2", "cov_nu_m2", "cov_uu_m2", "ve_m_s", "vn_m_s", "vu_m_s"
    ),
    _required("systems", Text),
    *_numbers("zenith_delay_m", "receiver_clock_s", "correction_age_s", "pdop"),
    Column("extras", Text),
    *_numbers("roll_rad", "pitch_rad", "heading_rad", "sigma_roll_rad", "sigma_pitch_rad", "sigma_heading_rad"),
    sqlite_with_rowid=False,
)

motion = Table(
    "motion",
    metadata,
    _key("station"),
    _key("t_first_gps_ns", BigInteger),
    _required("n", Integer),
    _required("interval_ns"),
    _required("t_receive_ns"),
    _required("status", Text),
    _required("revision", Integer),
    _required("samples", LargeBinary),
    Column("reason", Text, nullable=False, server_default=""),
)

quality = Table(
    "quality",
    metadata,
    _key("station"),
    _key("t_gps_ns", BigInteger),
    _required("t_receive_ns"),
    _required("observations", Integer),
    _required("rejected", Integer),
    *_numbers("protection_horizontal_m", "protection_vertical_m"),
    _required("report", LargeBinary),
)

motion_summaries = Table(
    "motion_summaries",
    metadata,
    _key("station"),
    _key("bucket_s", Integer),
    _key("t_gps_ns", BigInteger),
    _required("count", Integer),
    *_numbers(*(f"{channel}_{statistic}" for channel in CHANNELS for statistic in STATISTICS), *SIGMAS),
    sqlite_with_rowid=False,
)

alerts = Table(
    "alerts",
    metadata,
    _key("alert_id"),
    _required("station", NAME),
    _required("threshold_id", NAME),
    _required("quantity", Text),
    _required("severity", Text),
    _required("level", Double),
    _required("value", Double),
    _required("text", Text),
    _required("t_onset_gps_ns"),
    _required("t_active_gps_ns"),
    Column("t_acknowledged_gps_ns", BigInteger),
    _required("acknowledged_by", Text),
    Column("t_cleared_gps_ns", BigInteger),
    Index("alerts_by_time", "t_active_gps_ns", "alert_id"),
    Index("alerts_by_station", "station", "t_active_gps_ns"),
)

alert_history = Table(
    "alert_history",
    metadata,
    _key("alert_id"),
    _key("t_gps_ns", BigInteger),
    _key("kind", Text),
    _required("by", Text),
    _required("text", Text),
    Column("value", Double),
)

station_status = Table(
    "station_status",
    metadata,
    _key("station"),
    _required("t_receive_ns"),
    _required("state", Text),
    _required("reason", Text),
    Column("last_epoch_gps_ns", BigInteger),
    Column("solution_status", Text),
    _required("n_satellites", Integer),
    _required("counters", Text),
)

devices = Table(
    "devices",
    metadata,
    _key("identity", NAME),
    _required("address", Text),
    _required("first_seen_gps_ns"),
    _required("last_seen_gps_ns"),
    _required("attempts", Integer),
    _required("reason", Text),
    Column("station", NAME),
)

checkpoints = Table(
    "checkpoints",
    metadata,
    _key("station"),
    _required("t_receive_ns"),
    _required("state", LargeBinary),
    _required("consumed", Text),
)

uptimes = Table(
    "uptimes",
    metadata,
    _key("t_start_gps_ns", BigInteger),
    _required("t_last_gps_ns"),
)

availability = Table(
    "availability",
    metadata,
    _key("station"),
    _key("t_first_gps_ns", BigInteger),
    _required("t_end_gps_ns"),
    _required("counts", Text),
)
