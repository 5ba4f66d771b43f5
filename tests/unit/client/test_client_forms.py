"""What the client makes of times, addresses and answers. Oracles: datetime, urllib, and hand-written answers."""

from datetime import UTC, datetime, timedelta, timezone

import httpx
import numpy as np
import pytest

from plumbline_client import PlumblineError
from plumbline_client.errors import checked
from plumbline_client.requests import alert_path, clean, station_path, stream_url
from plumbline_client.series import motion_columns, solution_columns, times


def test_times_become_datetime64() -> None:
    moments = [datetime(2026, 1, 1, tzinfo=UTC) + timedelta(microseconds=k * 10_001) for k in range(3)]
    texts = [moment.isoformat().replace("+00:00", "Z") for moment in moments]
    expected = [np.datetime64(moment.replace(tzinfo=None), "ns") for moment in moments]
    assert times(texts).tolist() == [int(value.astype(np.int64)) for value in expected]
    assert times([]).dtype == np.dtype("datetime64[ns]")


def test_parameters_left_out_are_not_sent() -> None:
    moment = datetime(2026, 1, 1, 1, tzinfo=timezone(timedelta(hours=1)))
    assert clean({"a": None, "b": 3, "c": True, "start": moment}) == {
        "b": "3",
        "c": "true",
        "start": "2026-01-01T01:00:00+01:00",
    }
    with pytest.raises(ValueError, match="zone"):
        clean({"start": datetime(2026, 1, 1)})


def test_addresses() -> None:
    assert station_path("a.b", "motion") == "/v1/stations/a.b/motion"
    assert alert_path("a/t 1#?", "acknowledge") == "/v1/alerts/a%2Ft%201%23%3F/acknowledge"
    assert stream_url("https://host:1/") == "wss://host:1/v1/stream"
    assert stream_url("http://host") == "ws://host/v1/stream"


def test_null_becomes_nan_and_text_stays_text() -> None:
    body = {
        "station": "a",
        "time": ["2026-01-01T00:00:00.000Z"],
        "count": [3],
        "east_mm": [None],
        "up_mm": [1.5],
        "blocks": [{}],
    }
    columns = motion_columns(body)
    assert set(columns) == {"time", "count", "east_mm", "up_mm"}
    assert np.isnan(columns["east_mm"]).all()
    assert columns["count"].dtype == np.int64
    item = {"station": "a", "time": "2026-01-01T00:00:00.000Z", "status": "ppp_float", "reason": "", "systems": "GE"}
    solutions = solution_columns([item | {"n_satellites": 9, "east_mm": 1.0, "pdop": None, "extras": {}}])
    assert solutions["status"].tolist() == ["ppp_float"]
    assert solutions["east_mm"].tolist() == [1.0]
    assert np.isnan(solutions["pdop"]).all()
    assert len(solution_columns([])["time"]) == 0


@pytest.mark.parametrize("content", [b"", b"[]", b"not json", b'{"title": "No", "detail": "because"}'])
def test_a_refusal_is_an_exception_whatever_its_form(content: bytes) -> None:
    with pytest.raises(PlumblineError) as caught:
        checked(httpx.Response(503, content=content))
    assert caught.value.status == 503
    assert ("because" in str(caught.value)) == (b"because" in content)
