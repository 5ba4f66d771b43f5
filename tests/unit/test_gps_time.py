"""Times: oracles are published calendar facts (leap seconds, week numbers) and identities."""

from datetime import UTC, datetime

import pytest
from hypothesis import given
from hypothesis import strategies as st

from plumbline import gps_time as gt

GPS_NS_1990_TO_2035 = st.integers(min_value=314_928_000 * 10**9, max_value=1_750_000_000 * 10**9)


@pytest.mark.parametrize(
    ("utc", "week", "tow_s", "leap"),
    [
        (datetime(1999, 8, 21, 23, 59, 47, tzinfo=UTC), 1024, 0, 13),  # first roll-over of the 10-bit week
        (datetime(2019, 4, 6, 23, 59, 42, tzinfo=UTC), 2048, 0, 18),  # second
        (datetime(2016, 12, 31, 23, 59, 59, tzinfo=UTC), 1930, 16, 17),  # the second before the last leap second
        (datetime(2017, 1, 1, 0, 0, 0, tzinfo=UTC), 1930, 18, 18),
    ],
)
def test_known_dates(utc: datetime, week: int, tow_s: int, leap: int) -> None:
    t = gt.gps_ns_from_utc(utc)
    assert t == gt.gps_ns(week, tow_s)
    assert gt.gps_minus_utc_s(t) == leap
    assert gt.utc_from_gps(t) == utc
    assert gt.unix_ns_from_gps(t) == int(utc.timestamp()) * gt.NS_PER_S


def test_leap_second_is_the_only_place_where_utc_repeats() -> None:
    inside = gt.gps_ns(1930, 17)  # 23:59:60
    assert gt.gps_minus_utc_s(inside) == 17
    assert gt.utc_from_gps(inside) == gt.utc_from_gps(inside + gt.NS_PER_S)


@given(GPS_NS_1990_TO_2035, st.integers(-(gt.WEEK_NS // 2) + 1, gt.WEEK_NS // 2 - 1))
def test_time_of_week_is_resolved_from_any_receive_time_within_half_a_week(t_gps_ns: int, clock_error_ns: int) -> None:
    t_ms = t_gps_ns // gt.NS_PER_MS * gt.NS_PER_MS
    tow_ms = t_ms % gt.WEEK_NS // gt.NS_PER_MS
    assert gt.resolve_tow_ms(tow_ms, t_ms + clock_error_ns) == t_ms
    bdt_tow_ms = (tow_ms - 14_000) % (7 * 86_400_000)
    assert gt.resolve_bdt_tow_ms(bdt_tow_ms, t_ms + clock_error_ns) == t_ms


@given(st.datetimes(datetime(2017, 1, 2), datetime(2026, 1, 1)), st.booleans(), st.integers(-11, 11))
def test_glonass_time_is_moscow_time(moment: datetime, day_known: bool, hours_off: int) -> None:
    """Closed form: datetime arithmetic of UTC + 3 h."""
    utc = moment.replace(tzinfo=UTC, microsecond=0)
    t = gt.gps_ns_from_utc(utc)
    seconds_moscow = (utc.hour * 3600 + utc.minute * 60 + utc.second + 3 * 3600) % 86_400
    day = (utc.isoweekday() % 7 + (utc.hour + 3) // 24) % 7
    near = t + hours_off * 3600 * gt.NS_PER_S
    assert gt.resolve_glonass_ms(day if day_known else 7, seconds_moscow * 1000, near) == t


def test_ten_bit_week() -> None:
    now = gt.gps_ns_from_utc(datetime(2026, 2, 6, tzinfo=UTC))
    assert gt.resolve_week(gt.week_and_tow_ns(now)[0] % 1024, 1024, now) == 2404
    assert gt.resolve_week(1023, 1024, gt.gps_ns(2048, 5)) == 2047


def test_unix_time_round_trip() -> None:
    t = gt.gps_ns(2400, 123.456)
    assert gt.gps_ns_from_unix_ns(gt.unix_ns_from_gps(t)) == t
