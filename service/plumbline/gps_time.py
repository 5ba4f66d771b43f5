"""GPS time as integer nanoseconds since 1980-01-06, and its ways to and from every other scale that a stream speaks.

Nothing on the wire carries the full date: messages carry a time of week, of day, or of four days. Each ``resolve_*``
function takes the time nearest to a receive time, so midnight, week and day roll-overs are ordinary.
"""

from bisect import bisect_right
from datetime import UTC, datetime, timedelta
from importlib.resources import files
from typing import Final

from plumbline.constants import BDT_BEHIND_GPST_S, GLONASS_TIME_AHEAD_OF_UTC_S

NS_PER_S: Final = 1_000_000_000
NS_PER_MS: Final = 1_000_000
DAY_NS: Final = 86_400 * NS_PER_S
WEEK_NS: Final = 7 * DAY_NS
GPS_EPOCH_UTC: Final = datetime(1980, 1, 6, tzinfo=UTC)
GPS_EPOCH_UNIX_NS: Final = 315_964_800 * NS_PER_S


def _read_leap_seconds() -> tuple[list[int], list[int], datetime]:
    """Read the leap second table: (start of validity in UTC ns since 1980-01-06, GPS - UTC in s, expiry)."""
    starts, offsets, expiry = [], [], GPS_EPOCH_UTC
    for line in files("plumbline").joinpath("leap_seconds.csv").read_text(encoding="ascii").splitlines():
        if line.startswith("# expires,"):
            expiry = datetime.fromisoformat(line.split(",")[1]).replace(tzinfo=UTC)
        elif line[:1].isdigit():
            date, offset = line.split(",")
            since_epoch = datetime.fromisoformat(date).replace(tzinfo=UTC) - GPS_EPOCH_UTC
            starts.append(since_epoch.days * DAY_NS)
            offsets.append(int(offset))
    return starts, offsets, expiry


_LEAP_STARTS_UTC_NS, _LEAP_OFFSETS_S, LEAP_SECONDS_EXPIRE = _read_leap_seconds()
_LEAP_STARTS_GPS_NS = [s + o * NS_PER_S for s, o in zip(_LEAP_STARTS_UTC_NS, _LEAP_OFFSETS_S, strict=True)]


def gps_minus_utc_s(t_gps_ns: int) -> int:
    """Leap seconds: GPS time minus UTC, s, at a GPS time."""
    return _LEAP_OFFSETS_S[max(bisect_right(_LEAP_STARTS_GPS_NS, t_gps_ns) - 1, 0)]


def utc_ns_from_gps(t_gps_ns: int) -> int:
    """UTC as nanoseconds since 1980-01-06 UTC, leap seconds not counted; inside a leap second, the next day's first."""
    return t_gps_ns - gps_minus_utc_s(t_gps_ns) * NS_PER_S


def gps_ns_from_utc_ns(t_utc_ns: int) -> int:
    """Inverse of :func:`utc_ns_from_gps`."""
    return t_utc_ns + _LEAP_OFFSETS_S[max(bisect_right(_LEAP_STARTS_UTC_NS, t_utc_ns) - 1, 0)] * NS_PER_S


def gps_ns_from_unix_ns(t_unix_ns: int) -> int:
    """GPS time of a POSIX time (``time.time_ns()``)."""
    return gps_ns_from_utc_ns(t_unix_ns - GPS_EPOCH_UNIX_NS)


def unix_ns_from_gps(t_gps_ns: int) -> int:
    """POSIX time, ns, of a GPS time."""
    return utc_ns_from_gps(t_gps_ns) + GPS_EPOCH_UNIX_NS


def utc_from_gps(t_gps_ns: int) -> datetime:
    """UTC date and time, rounded to the microsecond that ``datetime`` holds."""
    return GPS_EPOCH_UTC + timedelta(microseconds=(utc_ns_from_gps(t_gps_ns) + 500) // 1000)


def gps_ns_from_utc(moment: datetime) -> int:
    """GPS time of an aware UTC ``datetime``."""
    delta = moment.astimezone(UTC) - GPS_EPOCH_UTC
    return gps_ns_from_utc_ns((delta.days * 86_400 + delta.seconds) * NS_PER_S + delta.microseconds * 1000)


def gps_ns_from_calendar(year: int, month: int, day: int, hour: int, minute: int, second_ns: int) -> int:
    """GPS time of a calendar date written *in GPS time* (RINEX, SP3); ``second_ns`` is the second in ns."""
    days = (datetime(year, month, day, tzinfo=UTC) - GPS_EPOCH_UTC).days
    return days * DAY_NS + (hour * 3600 + minute * 60) * NS_PER_S + second_ns


def gps_ns(week: int, tow_s: float) -> int:
    """GPS time of a full week number and a time of week, s (rounded to the nanosecond)."""
    return week * WEEK_NS + round(tow_s * NS_PER_S)


def week_and_tow_ns(t_gps_ns: int) -> tuple[int, int]:
    """Full GPS week number and time of week, ns."""
    return divmod(t_gps_ns, WEEK_NS)


def nearest_ns(remainder_ns: int, modulus_ns: int, t_near_ns: int) -> int:
    """The time congruent to ``remainder_ns`` modulo ``modulus_ns`` that lies nearest to ``t_near_ns``."""
    offset = (remainder_ns - t_near_ns) % modulus_ns
    return t_near_ns + offset - (modulus_ns if offset > modulus_ns // 2 else 0)


def resolve_tow_ms(tow_ms: int, t_near_gps_ns: int) -> int:
    """GPS time of a GPS/Galileo/QZSS/SBAS time of week (DF004, DF248), ms."""
    return nearest_ns(tow_ms * NS_PER_MS, WEEK_NS, t_near_gps_ns)


def resolve_bdt_tow_ms(tow_ms: int, t_near_gps_ns: int) -> int:
    """GPS time of a BeiDou time of week (DF427), ms of BDT."""
    return nearest_ns(tow_ms * NS_PER_MS + BDT_BEHIND_GPST_S * NS_PER_S, WEEK_NS, t_near_gps_ns)


def resolve_glonass_ms(day_of_week: int | None, ms_of_day: int, t_near_gps_ns: int) -> int:
    """GPS time of a GLONASS epoch: day of week (DF416; None or 7 = unknown) and ms of the day in UTC + 3 h (DF034).

    A leap second comes at 03:00 of that time scale, and the milliseconds count on through it (so a day may reach
    86,400,999): the count is continuous, and the offset to GPS time is the one before the leap until the day ends.
    """
    near_utc_ns = utc_ns_from_gps(t_near_gps_ns)
    shift_ns = GLONASS_TIME_AHEAD_OF_UTC_S * NS_PER_S
    modulus_ns = DAY_NS
    remainder_ns = ms_of_day * NS_PER_MS - shift_ns
    if day_of_week is not None and day_of_week != 7:
        modulus_ns = WEEK_NS  # 0 = Sunday, and GPS weeks begin on Sunday
        remainder_ns += day_of_week * DAY_NS
    t_utc_ns = nearest_ns(remainder_ns, modulus_ns, near_utc_ns)
    return t_utc_ns + gps_minus_utc_s(t_near_gps_ns) * NS_PER_S


def resolve_week(week: int, modulus: int, t_near_gps_ns: int) -> int:
    """Full GPS week number of a week counted modulo ``modulus`` (1019: 1024), nearest to a time."""
    near = t_near_gps_ns // WEEK_NS
    offset = (week - near) % modulus
    return near + offset - (modulus if offset > modulus // 2 else 0)
