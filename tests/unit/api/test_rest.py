"""REST. Oracles: RFC 9457 and RFC 7396 for the forms, the store's rows for the content, hand-converted units."""

import csv
import io
import math
import time
from dataclasses import replace
from datetime import datetime
from urllib.parse import quote, unquote

import httpx
import numpy as np
import pytest
from fastapi import FastAPI

from plumbline.api.stations import merge_patch
from plumbline.config import StationSettings
from plumbline.gps_time import gps_ns_from_unix_ns, gps_ns_from_utc
from plumbline.records import AlertEvent, AlertState, Motion, Severity, Solution, StationStatus, Status, Threshold
from plumbline.store import Device, Store

T0 = gps_ns_from_utc(datetime.fromisoformat("2026-03-01T12:00:00Z"))
S = 1_000_000_000


def is_problem(response: httpx.Response, status: int, *words: str) -> None:
    assert response.status_code == status, response.text
    assert response.headers["content-type"] == "application/problem+json"
    body = response.json()
    assert body["status"] == status
    assert body["title"]
    assert unquote(body["instance"]) == response.request.url.path
    for word in words:
        assert word in response.text


def motion(second: int, n: int = 10) -> Motion:
    rng = np.random.default_rng(second)
    d, v, a, s = (rng.normal(0, 0.01, (n, 3)) for _ in range(4))
    return Motion("tower", T0 + second * S, T0, S // n, d, v, a, s, Status.PPP_FLOAT)


@pytest.fixture
async def tower(store: Store) -> StationSettings:
    """A station."""
    settings = StationSettings(station="tower", reference_position_ecef_m=(3370658.5, 711877.1, 5349786.9))
    await store.create_station(settings)
    return settings


# --------------------------------------------------------------------------------------------- stations


async def test_a_station_is_created_with_degrees_and_shown_in_both_forms(client, store, control) -> None:
    body = {"station": "esbc", "name": "Esbjerg", "latitude_deg": 55.4938, "longitude_deg": 8.4568, "height_m": 59.2}
    body["device"] = {"registrations": ["866123456789012"], "token": "secret"}
    response = await client.post("/v1/stations", json=body)
    assert response.status_code == 201
    assert response.headers["location"] == "/v1/stations/esbc"
    assert response.headers["etag"] == '"1"'
    shown = response.json()
    assert shown["reference_position_ecef_m"] == pytest.approx([3582110, 532590, 5232751], abs=700)
    assert (shown["latitude_deg"], shown["longitude_deg"]) == pytest.approx((55.4938, 8.4568), abs=1e-9)
    assert shown["status"]["state"] == "waiting"
    assert "secret" not in response.text
    assert shown["device"]["has_token"] is True
    row = await store.station("esbc")
    assert row is not None
    assert row.settings.device.token == "secret"
    assert control.told == [("station", "esbc", row.settings)]
    is_problem(await client.post("/v1/stations", json=body), 409, "esbc")


@pytest.mark.parametrize(
    ("body", "word"),
    [
        ({"station": "a/b"}, "body.station"),
        ({"station": ""}, "body.station"),
        ({}, "body.station"),
        ({"station": "a", "colour": "red"}, "colour"),
        ({"station": "a", "latitude_deg": 1.0}, "go together"),
        ({"station": "a", "latitude_deg": 91, "longitude_deg": 0, "height_m": 0}, "latitude_deg"),
        ({"station": "a", "device": {"port": 70000}}, "body.device.port"),
        ({"station": "a", "name": "a\x00b"}, "NUL"),
        ({"station": "a", "positioning": {"systems": "X"}}, "systems"),
        ([], "body"),
        ("text", "body"),
    ],
)
async def test_what_is_wrong_with_a_station_is_said(client, body: object, word: str) -> None:
    is_problem(await client.post("/v1/stations", json=body), 422, word)


@pytest.mark.parametrize(
    "text",
    ['{"station": "a", "antenna_height_m": NaN}', '{"station": "a", "epoch_deadline_s": Infinity}',
     '{"station": "a", "name": "\\ud800"}', '{"station": "a", "epoch_deadline_s": 1e999}',
     '{"station": "a", "device": {"rtcm_station_ids": [' + "9" * 30 + "]}}",
     "{", "", '{"station": ' * 50],
)  # fmt: skip
async def test_json_that_no_database_takes_is_refused(client, text: str) -> None:
    response = await client.post("/v1/stations", content=text.encode(), headers={"content-type": "application/json"})
    is_problem(response, 422)


async def test_a_merge_patch_changes_what_it_names(client, tower, store, control) -> None:
    response = await client.patch("/v1/stations/tower", json={"name": "North", "device": {"token": "t0"}})
    assert response.status_code == 200
    assert response.headers["etag"] == '"2"'
    patched = await client.patch(
        "/v1/stations/tower",
        json={"device": {"port": 9100}, "name": None, "latitude_deg": 1.0, "longitude_deg": 2.0, "height_m": 3.0},
        headers={"if-match": '"2"'},
    )
    assert patched.status_code == 200
    row = await store.station("tower")
    assert row is not None
    assert (row.settings.name, row.settings.device.token, row.settings.device.port) == ("", "t0", 9100)
    assert patched.json()["latitude_deg"] == pytest.approx(1.0, abs=1e-9)
    assert control.told[-1] == ("station", "tower", row.settings)
    is_problem(await client.patch("/v1/stations/tower", json={}, headers={"if-match": '"2"'}), 412)
    is_problem(await client.patch("/v1/stations/tower", json={"station": "other"}), 422, "id cannot be changed")
    is_problem(await client.patch("/v1/stations/tower", json={"epoch_deadline_s": -1}), 422, "body.epoch_deadline_s")
    is_problem(await client.patch("/v1/stations/none", json={}), 404, "none")


def test_merge_patch_is_rfc_7396s() -> None:
    cases = [  # appendix A
        ({"a": "b"}, {"a": "c"}, {"a": "c"}), ({"a": "b"}, {"b": "c"}, {"a": "b", "b": "c"}),
        ({"a": "b"}, {"a": None}, {}),
        ({"a": "b", "b": "c"}, {"a": None}, {"b": "c"}), ({"a": ["b"]}, {"a": "c"}, {"a": "c"}),
        ({"a": "c"}, {"a": ["b"]}, {"a": ["b"]}), ({"a": {"b": "c"}}, {"a": {"b": "d", "c": None}}, {"a": {"b": "d"}}),
        ({"a": [{"b": "c"}]}, {"a": [1]}, {"a": [1]}), (["a", "b"], ["c", "d"], ["c", "d"]), ({"a": "b"}, ["c"], ["c"]),
        ({"a": "foo"}, None, None), ({"a": "foo"}, "bar", "bar"), ({"e": None}, {"a": 1}, {"e": None, "a": 1}),
        ([1, 2], {"a": "b", "c": None}, {"a": "b"}), ({}, {"a": {"bb": {"ccc": None}}}, {"a": {"bb": {}}}),
    ]  # fmt: skip
    for target, patch, result in cases:
        assert merge_patch(target, patch) == result


async def test_stations_are_listed_in_parts_with_their_status(client, store) -> None:
    for i in range(5):
        await store.create_station(StationSettings(station=f"s{i}"))
    now = gps_ns_from_unix_ns(time.time_ns())
    await store.write(
        [
            StationStatus("s1", now, "receiving", "", now, Status.PPP_FLOAT, 21, {"frames": 5}),
            StationStatus("s3", now - 3600 * S, "receiving", "", None, None, 0, {}),
        ]
    )
    names, states, cursor = [], [], None
    while True:
        response = await client.get("/v1/stations", params={"limit": 2} | ({"cursor": cursor} if cursor else {}))
        body = response.json()
        names += [item["station"] for item in body["items"]]
        states += [item["status"]["state"] for item in body["items"]]
        cursor = body["next"]
        if cursor is None:
            break
    assert names == [f"s{i}" for i in range(5)]
    assert states == ["waiting", "receiving", "waiting", "silent", "waiting"]
    status = (await client.get("/v1/stations/s1/status")).json()
    assert (status["n_satellites"], status["counters"], status["solution_status"]) == (21, {"frames": 5}, "ppp_float")
    assert "no word" in (await client.get("/v1/stations/s3/status")).json()["reason"]
    is_problem(await client.get("/v1/stations", params={"cursor": "rubbish"}), 422, "cursor")


async def test_deleting_keeps_results_unless_purged(client, tower, store, control) -> None:
    await store.write([Solution("tower", T0, T0, Status.NO_BASE, "none")])
    assert (await client.delete("/v1/stations/tower")).status_code == 204
    assert control.told == [("station", "tower", None)]
    is_problem(await client.delete("/v1/stations/tower"), 404)
    assert len((await store.solutions("tower")).items) == 1
    await store.create_station(tower)
    await client.delete("/v1/stations/tower", params={"purge": "true"})
    assert not (await store.solutions("tower")).items


# --------------------------------------------------------------------------------------------- series


async def test_solutions_in_millimetres_and_degrees(client, tower, store) -> None:
    full = Solution(
        "tower",
        T0,
        T0,
        Status.PPP_FIXED,
        "",
        14,
        np.array(tower.reference_position_ecef_m),
        np.array([0.0012, -0.0345, 0.1]),
        np.diag([4e-6, 9e-6, 16e-6]),
        np.array([0.001, np.nan, 0.003]),
        "GE",
        2.4,
        1e-8,
        3.0,
        math.inf,
    )
    await store.write([full, Solution("tower", T0 + S, T0, Status.NO_CORRECTIONS, "no corrections for Galileo")])
    first, second = (await client.get("/v1/stations/tower/solutions")).json()["items"]
    assert first["time"] == "2026-03-01T12:00:00.000Z"
    assert [first[f"{axis}_mm"] for axis in ("east", "north", "up")] == [1.2, -34.5, 100.0]
    assert [first[f"sigma_{axis}_mm"] for axis in ("east", "north", "up")] == [2.0, 3.0, 4.0]
    assert [first[f"velocity_{axis}_mm_s"] for axis in ("east", "north", "up")] == [1.0, None, 3.0]
    assert first["latitude_deg"] == pytest.approx(57.4, abs=0.1)
    assert (first["zenith_delay_mm"], first["receiver_clock_ns"], first["pdop"]) == (2400.0, 10.0, None)
    assert (second["status"], second["east_mm"], second["latitude_deg"]) == ("no_corrections", None, None)


async def test_solutions_as_csv_go_on_in_the_link(client, tower, store) -> None:
    await store.write([Solution("tower", T0 + i * S, T0, Status.NO_EPHEMERIS, f'say "{i}", please') for i in range(7)])
    address: str | None = "/v1/stations/tower/solutions?format=csv&limit=3&start=2026-03-01T13:00:01%2B01:00"
    rows = []
    while address:
        response = await client.get(address)
        assert response.headers["content-type"].startswith("text/csv")
        rows += list(csv.DictReader(io.StringIO(response.text)))
        address = response.links["next"]["url"] if "next" in response.links else None
    assert [row["reason"] for row in rows] == [f'say "{i}", please' for i in range(1, 7)]
    assert rows[0]["time"] == "2026-03-01T12:00:01.000Z"
    assert rows[0]["east_mm"] == ""


async def test_motion_samples_and_summaries(client, tower, store) -> None:
    blocks = [motion(s) for s in range(120)]
    await store.write(blocks)
    address = "/v1/stations/tower/motion"
    fine = (await client.get(address, params={"max_points": 1200})).json()
    assert (fine["bucket_s"], len(fine["time"]), len(fine["blocks"])) == (0, 1200, 120)
    east = np.concatenate([block.displacement_enu_m[:, 0] for block in blocks]) * 1e3
    assert np.abs(np.array(fine["east_mm"]) - east).max() <= 0.00501 + 0.005
    assert fine["time"][11] == "2026-03-01T12:00:01.100Z"
    assert fine["blocks"][3] == {
        "time": "2026-03-01T12:00:03.000Z", "n": 10, "interval_s": 0.1, "status": "ppp_float", "reason": "",
        "revision": 0,
    }  # fmt: skip
    coarse = (await client.get(address, params={"max_points": 100})).json()
    assert len(coarse["time"]) <= 100
    assert sum(coarse["count"]) == 1200
    assert max(coarse["east_max_mm"]) == max(fine["east_mm"])
    assert min(coarse["acceleration_up_min_mm_s2"]) == min(fine["acceleration_up_mm_s2"])
    part = (await client.get(address, params={"max_points": 50, "resolution": "1s"})).json()
    assert (part["bucket_s"], len(part["time"]), part["next_start"]) == (1, 50, "2026-03-01T12:00:50.000Z")
    table = await client.get(address, params={"resolution": "1min"}, headers={"accept": "text/csv;q=0.9, */*;q=0.1"})
    rows = list(csv.DictReader(io.StringIO(table.text)))
    assert [row["count"] for row in rows] == ["600", "600"]
    seen, url = 0, f"{address}?format=csv&resolution=samples&max_points=500"
    while url:
        table = await client.get(url)
        seen += len(table.text.splitlines()) - 1
        url = table.links["next"]["url"] if "next" in table.links else ""
    assert seen == 1200
    empty = (await client.get(address, params={"start": "2030-01-01T00:00:00Z"})).json()
    assert empty["time"] == []


async def test_reading_on_misses_no_sample_between_microseconds(client, tower, store) -> None:
    await store.write([motion(s, n=3) for s in range(4)])
    times, start = [], "2026-03-01T12:00:00Z"
    while start:
        part = (
            await client.get(
                "/v1/stations/tower/motion", params={"resolution": "samples", "max_points": 1, "start": start}
            )
        ).json()
        times += part["time"]
        start = part["next_start"]
    assert len(times) == 12
    assert times[:3] == ["2026-03-01T12:00:00.000Z", "2026-03-01T12:00:00.333333Z", "2026-03-01T12:00:00.666667Z"]


async def test_a_long_answer_comes_in_pieces_and_whole(client, tower, store) -> None:
    await store.write([motion(s, n=100) for s in range(100)])
    response = await client.get("/v1/stations/tower/motion", params={"max_points": 10_000})
    assert len(response.content) > 500_000
    assert len(response.json()["up_mm"]) == 10_000


async def test_attitudes_are_in_degrees(client, store, tower) -> None:
    """Oracle: NumPy's degrees."""
    angles, sigmas = np.radians([1.5, -0.25, 359.5]), np.radians([0.02, np.nan, 0.03])
    first = Solution(
        "tower", T0, T0, Status.RTK_FIXED, "", 12, attitude_rad=angles, sigma_attitude_rad=sigmas
    )  # fmt: skip
    turned = np.tile(angles, (10, 1))
    await store.write([first, replace(motion(0), attitude_rad=turned, sigma_attitude_rad=np.tile(sigmas, (10, 1)))])
    item = (await client.get("/v1/stations/tower/solutions")).json()["items"][0]
    assert [item[f"{name}_deg"] for name in ("roll", "pitch", "heading")] == [1.5, -0.25, 359.5]
    assert [item[f"sigma_{name}_deg"] for name in ("roll", "pitch", "heading")] == [0.02, None, 0.03]
    columns = (await client.get("/v1/stations/tower/motion", params={"resolution": "samples"})).json()
    assert columns["heading_deg"] == pytest.approx([359.5] * 10, abs=1e-4)
    assert columns["sigma_pitch_deg"] == [None] * 10
    table = (await client.get("/v1/stations/tower/motion", params={"format": "csv"})).text.splitlines()
    assert table[0].endswith("roll_deg,pitch_deg,heading_deg,sigma_roll_deg,sigma_pitch_deg,sigma_heading_deg")


async def test_motion_as_miniseed_is_read_by_obspy(client, tower, store) -> None:
    from obspy import read

    blocks = [motion(s) for s in (*range(5), *range(8, 10))]
    await store.write(blocks)
    response = await client.get("/v1/stations/tower/motion", params={"format": "mseed"})
    assert response.headers["content-type"] == "application/vnd.fdsn.mseed"
    traces = read(io.BytesIO(response.content)).select(channel="LYE")
    assert [trace.stats.npts for trace in traces] == [50, 20]
    assert str(traces[1].stats.starttime) == "2026-03-01T12:00:08.000000Z"
    assert traces[0].stats.sampling_rate == pytest.approx(10.0)
    east = np.concatenate([block.displacement_enu_m[:, 0] for block in blocks[:5]])
    assert np.abs(traces[0].data - east).max() <= 5.001e-6
    assert (await client.get("/v1/stations/tower/motion?format=mseed&start=2030-01-01T00:00:00Z")).status_code == 204


@pytest.mark.parametrize(
    ("query", "words"),
    [
        ("start=yesterday", "query.start"),
        ("start=2026-03-01T12:00:00", "timezone"),
        ("start=9999-12-31T00:00:00Z", "2200"),
        ("start=2026-03-01T12:00:00Z&end=2026-02-01T12:00:00Z", "before"),
        ("max_points=0", "max_points"),
        ("max_points=1000000", "max_points"),
        ("resolution=2s", "resolution"),
        ("format=parquet", "format"),
        ("since=5", "unknown query parameter 'since'"),
        ("max_points=5&max_points=6", "more than once"),
    ],
)
async def test_queries_that_make_no_sense_are_refused_with_the_reason(client, tower, query: str, words: str) -> None:
    is_problem(await client.get(f"/v1/stations/tower/motion?{query}"), 422, words)


async def test_what_is_not_there_or_not_on_offer(client, tower) -> None:
    is_problem(await client.get("/v1/stations/none/motion"), 404, "none")
    is_problem(await client.get("/v1/nothing"), 404)
    is_problem(await client.put("/v1/stations"), 405)
    is_problem(await client.get("/v1/stations/tower/motion", headers={"accept": "image/png"}), 406, "text/csv")
    is_problem(await client.post("/v1/stations", content=b"x" * 2_000_000), 413)


# --------------------------------------------------------------------------------------------- thresholds, alerts


async def test_thresholds_are_in_millimetres(client, tower, store, control) -> None:
    body = {
        "threshold_id": "t1",
        "station": "tower",
        "quantity": "displacement_horizontal",
        "level": 50.1,
        "dead_band": 5,
    }
    created = await client.post("/v1/thresholds", json=body)
    assert created.status_code == 201
    assert (created.json()["level"], created.json()["unit"]) == (50.1, "mm")
    expected = Threshold("t1", "tower", "displacement_horizontal", 0.0501, dead_band=0.005)
    assert await store.threshold("t1") == expected
    assert control.told == [("thresholds", "tower", (expected,))]
    is_problem(await client.post("/v1/thresholds", json=body), 409)
    is_problem(await client.post("/v1/thresholds", json=body | {"station": "none"}), 404)
    is_problem(await client.post("/v1/thresholds", json=body | {"unit": "m"}), 422, "mm")
    is_problem(await client.post("/v1/thresholds", json=body | {"dead_band": 60}), 422, "dead_band")
    is_problem(await client.post("/v1/thresholds", json=body | {"quantity": "colour"}), 422, "displacement_horizontal")
    is_problem(await client.post("/v1/thresholds", json=body | {"severity": "loud"}), 422, "severity")
    changed = await client.patch("/v1/thresholds/t1", json={"level": 70, "enabled": False})
    assert (changed.json()["level"], changed.json()["enabled"], changed.json()["dead_band"]) == (70.0, False, 5.0)
    is_problem(await client.patch("/v1/thresholds/t1", json={"quantity": "velocity_up"}), 422, "level and dead_band")
    assert len((await client.get("/v1/thresholds?station=tower")).json()["items"]) == 1
    assert (await client.delete("/v1/thresholds/t1")).status_code == 204
    assert control.told[-1] == ("thresholds", "tower", ())
    is_problem(await client.get("/v1/thresholds/t1"), 404)


@pytest.mark.parametrize("alert_id", ["tower:t1:1", "tower/t 1/ü?#%2F"])
async def test_alerts_are_acknowledged_and_commented(client, store, alert_id: str) -> None:
    event = AlertEvent(
        alert_id,
        "tower",
        "t1",
        AlertState.ACTIVE,
        Severity.ALARM,
        T0 + S,
        T0,
        T0,
        "displacement_up",
        0.061,
        0.05,
        "up!",
    )
    await store.write([event])
    (item,) = (await client.get("/v1/alerts?state=active&station=tower")).json()["items"]
    assert (item["value"], item["level"], item["unit"], item["state"]) == (61.0, 50.0, "mm", "active")
    assert (item["onset"], item["active_since"]) == ("2026-03-01T12:00:00.000Z", "2026-03-01T12:00:01.000Z")
    url = httpx.URL("http://plumbline/v1/alerts/" + quote(alert_id, safe=""))
    done = await client.post(f"{url}/acknowledge", json={"by": "Ada", "comment": "on my way"})
    assert (done.json()["state"], done.json()["acknowledged_by"]) == ("acknowledged", "Ada")
    assert (await client.post(f"{url}/acknowledge")).json() == done.json()
    said = await client.post(f"{url}/comments", json={"by": "Ada", "text": "a lorry"})
    assert said.status_code == 201
    history = (await client.get(str(url))).json()["history"]
    assert [note["kind"] for note in history] == ["active", "acknowledged", "comment"]
    is_problem(await client.post("/v1/alerts/none/acknowledge"), 404)
    is_problem(await client.post(f"{url}/comments", json={"text": ""}), 422)


async def test_devices_are_listed_and_adopted(client, tower, store, control) -> None:
    control.unknown.append(Device("866\\x0d", "10.0.0.9:5000", T0, T0 + S, 4, "unknown_device"))
    await store.save_devices([Device("old", "10.0.0.1:1", T0 - S, T0 - S)])
    devices = (await client.get("/v1/devices")).json()["items"]
    assert [device["identity"] for device in devices] == ["866\\x0d", "old"]
    address = f"/v1/devices/{devices[0]['device_id']}/adopt"
    is_problem(await client.post(address, json={"station": "none"}), 404)
    adopted = await client.post(address, json={"station": "tower"})
    assert adopted.json()["station"] == "tower"
    row = await store.station("tower")
    assert row is not None
    assert row.settings.device.registrations == ("866\\x0d",)
    assert control.told == [("station", "tower", row.settings)]
    assert (await client.post(address, json={"station": "tower"})).status_code == 200
    is_problem(await client.post("/v1/devices/0123456789abcdef/adopt", json={"station": "tower"}), 404)


# --------------------------------------------------------------------------------------------- operations


async def test_health_readiness_and_metrics(client, store, control, feed, tower) -> None:
    assert (await client.get("/healthz")).json() == {"status": "alive"}
    assert (await client.get("/readyz")).status_code == 200
    control.waiting["bus"] = "no session"
    is_problem(await client.get("/readyz"), 503, "bus: no session")
    feed.publish(Solution("tower", T0, T0, Status.NO_BASE, ""))
    await store.write([StationStatus("tower", T0, "receiving", "", T0, None, 9, {})])
    text = (await client.get("/metrics")).text
    for line in (
        'plumbline_http_requests_total{method="GET",route="/healthz",status="200"} 1.0',
        'plumbline_stream_published_total{channel="solution"} 1.0',
        'plumbline_stations{state="receiving"} 1.0',
        'plumbline_station_satellites{station="tower"} 9.0',
    ):
        assert line in text


async def test_an_error_of_the_servers_own_shows_nothing_of_it(app: FastAPI, client, monkeypatch) -> None:
    async def broken() -> None:
        raise RuntimeError("a secret in a traceback")

    monkeypatch.setattr(app.state.control, "devices", broken)
    response = await client.get("/v1/devices")
    is_problem(response, 500)
    assert "secret" not in response.text
    assert "Traceback" not in response.text


async def test_a_closed_database_is_a_503(client, store, monkeypatch) -> None:
    from plumbline.errors import StoreError

    async def away(*_: object) -> None:
        raise StoreError("away")

    monkeypatch.setattr(store, "stations_page", away)
    is_problem(await client.get("/v1/stations"), 503, "database")
    monkeypatch.setattr(store, "ping", away)
    is_problem(await client.get("/readyz"), 503, "store")


async def test_the_root_without_a_dashboard_says_how_to_build_it(client) -> None:
    assert "make install" in (await client.get("/")).text


async def test_the_dashboard_is_served_and_nothing_outside_of_it(store, feed, control, tmp_path) -> None:
    from plumbline.api import create_app
    from plumbline.config import ServerSettings

    folder = tmp_path / "dashboard"
    (folder / "assets").mkdir(parents=True)
    (folder / "index.html").write_text("<title>plumbline</title>")
    (folder / "assets" / "a.js").write_text("1")
    (tmp_path / "secret.txt").write_text("secret")
    app = create_app(store, feed, control, ServerSettings(), dashboard=folder)
    async with httpx.AsyncClient(transport=httpx.ASGITransport(app), base_url="http://p") as client:
        assert "<title>plumbline" in (await client.get("/")).text
        assert (await client.get("/assets/a.js")).text == "1"
        for path in (
            "/../secret.txt",
            "/%2e%2e/secret.txt",
            "/assets/..%2f..%2fsecret.txt",
            "/..%5csecret.txt",
            "//etc/passwd",
        ):
            response = await client.get(httpx.URL("http://p", raw_path=path.encode()))
            assert response.status_code in (404, 405), path
            assert "secret" not in response.text.replace(path, "").replace("secret.txt", "")
        is_problem(await client.get("/v1/nothing"), 404)
        assert (await client.get("/healthz")).status_code == 200
