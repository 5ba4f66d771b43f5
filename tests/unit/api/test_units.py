"""Units at the API. Oracles: datetime of the standard library, and inverse functions of each other."""

from datetime import UTC, datetime, timedelta

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from plumbline.api.units import column, degrees_and_height, ecef_of_degrees, from_si, iso, iso_all, scaled, to_si
from plumbline.gps_time import GPS_EPOCH_UTC, gps_ns_from_utc

moments = st.datetimes(datetime(1981, 1, 1), datetime(2190, 1, 1), timezones=st.just(UTC))


@given(moments)
def test_iso_is_read_back_by_datetime(moment: datetime) -> None:
    text = iso(gps_ns_from_utc(moment))
    assert text.endswith("Z")
    assert datetime.fromisoformat(text) == moment


@given(moments, st.integers(1, 2 * 10**9), st.integers(1, 50))
def test_many_times_are_as_each_alone(moment: datetime, step_ns: int, n: int) -> None:
    times = gps_ns_from_utc(moment) + step_ns * np.arange(n, dtype=np.int64)
    one_by_one = [datetime.fromisoformat(iso(int(t))) for t in times]
    assert [datetime.fromisoformat(text) for text in iso_all(times)] == one_by_one


def test_a_leap_second_within_a_series() -> None:
    before = gps_ns_from_utc(datetime(2016, 12, 31, 23, 59, 58, tzinfo=UTC))
    texts = iso_all(before + 1_000_000_000 * np.arange(5, dtype=np.int64))
    assert texts[0] == "2016-12-31T23:59:58.000Z"
    assert texts[-1] == "2017-01-01T00:00:01.000Z"


def test_the_epoch_and_its_first_day() -> None:
    assert iso(0) == GPS_EPOCH_UTC.isoformat(timespec="milliseconds").replace("+00:00", "Z")
    assert datetime.fromisoformat(iso(86_400 * 10**9)) - GPS_EPOCH_UTC == timedelta(days=1)


@given(st.floats(-89.9, 89.9), st.floats(-179.9, 179.9), st.floats(-400, 9000))
def test_degrees_survive_the_way_to_earth_fixed_and_back(latitude: float, longitude: float, height: float) -> None:
    again = degrees_and_height(ecef_of_degrees(latitude, longitude, height))
    assert again == pytest.approx((latitude, longitude, height), abs=2e-5)
    assert again[:2] == pytest.approx((latitude, longitude), abs=1e-8 / np.cos(np.radians(latitude)))


@given(
    st.integers(-(10**12), 10**12).map(lambda n: n / 1e4),
    st.sampled_from(["displacement_up", "velocity_east", "data_gap"]),
)
def test_levels_survive_the_way_to_si_and_back(level: float, quantity: str) -> None:
    assert from_si(quantity, to_si(quantity, level)) == pytest.approx(level, rel=1e-11)
    assert to_si(quantity, from_si(quantity, level)) == pytest.approx(level, rel=1e-11)


def test_scaling_leaves_no_dust() -> None:
    assert [from_si("displacement_up", level) for level in (0.07, 0.0501, 0.29)] == [70.0, 50.1, 290.0]


def test_what_is_not_finite_is_null() -> None:
    assert column(np.array([1.0, np.nan, np.inf, -0.0004])) == [1000.0, None, None, -0.4]
    assert scaled(float("nan")) is None
    assert scaled(None) is None
