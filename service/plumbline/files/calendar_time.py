"""Calendar dates in the time scale that a file's header names, as GPS time."""

from plumbline.constants import BDT_BEHIND_GPST_S, GLONASS_TIME_AHEAD_OF_UTC_S
from plumbline.gps_time import NS_PER_S, gps_ns_from_calendar, gps_ns_from_utc_ns

#: RINEX and SP3 names of scales that count GPS time's seconds.
_LIKE_GPS = frozenset({"GPS", "GAL", "GST", "QZS", "QZSS", "IRN", "IRNSS", ""})


def fractional_second_ns(text: str) -> int:
    """Nanoseconds of a decimal second (``"30.0000000"``), exactly; raises ``ValueError``."""
    whole, _, decimals = text.strip().partition(".")
    return int(whole or 0) * NS_PER_S + int((decimals + "000000000")[:9])


def gps_ns_of_calendar(scale: str, year: int, month: int, day: int, hour: int, minute: int, second_ns: int) -> int:
    """GPS time of a calendar date written in ``scale``: GPS, GAL, QZS, IRN, BDT, GLO (RINEX: UTC), UTC, TAI.

    Raises ``ValueError`` for an impossible date or an unknown scale.
    """
    as_written = gps_ns_from_calendar(year, month, day, hour, minute, second_ns)
    if scale in _LIKE_GPS:
        return as_written
    if scale in ("BDT", "BDS"):
        return as_written + BDT_BEHIND_GPST_S * NS_PER_S
    if scale in ("GLO", "UTC"):
        return gps_ns_from_utc_ns(as_written)
    if scale == "TAI":
        return as_written - 19 * NS_PER_S
    raise ValueError(f"unknown time scale {scale!r}")


def glonass_issue(t_utc_like_ns: int) -> int:
    """Index t_b of a GLONASS reference time given as UTC ns: quarters of an hour of the day in UTC + 3 h (ICD 4.4)."""
    seconds = t_utc_like_ns // NS_PER_S + GLONASS_TIME_AHEAD_OF_UTC_S
    return int(seconds % 86_400 // 900)
