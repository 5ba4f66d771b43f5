"""The application under uvicorn on a real port: the live stream by a bare WebSocket, and the Python client.

Oracles: what was published and stored in the same process; the JSON examples of the stream's documentation.
"""

import asyncio
import json
import socket
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import uvicorn
from websockets.asyncio.client import ClientConnection, connect

from plumbline.api import Feed, NoControl, create_app
from plumbline.api.documents import stream_examples
from plumbline.config import ServerSettings, StationSettings
from plumbline.gps_time import gps_ns_from_utc
from plumbline.records import AlertEvent, AlertState, Motion, QualityReport, Severity, Solution, StationStatus, Status
from plumbline.store import Store
from plumbline_client import AsyncClient, Client, PlumblineError

START = datetime(2026, 3, 1, 12, tzinfo=UTC)
T0 = gps_ns_from_utc(START)
S = 1_000_000_000


@dataclass
class Server:
    """A running server and the parts behind it."""

    port: int
    store: Store
    feed: Feed

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.port}"

    @property
    def stream(self) -> str:
        return f"ws://127.0.0.1:{self.port}/v1/stream"


@asynccontextmanager
async def serving(store: Store, feed: Feed, port: int = 0) -> AsyncIterator[Server]:
    """uvicorn on a free port (or on a given one) for as long as the context lasts."""
    app = create_app(store, feed, NoControl(), ServerSettings())
    listener = socket.create_server(("127.0.0.1", port), backlog=100)
    server = uvicorn.Server(uvicorn.Config(app, log_level="error", lifespan="off", timeout_graceful_shutdown=1))
    task = asyncio.create_task(server.serve(sockets=[listener]))
    try:
        yield Server(listener.getsockname()[1], store, feed)
    finally:
        server.should_exit = True
        await task
        listener.close()


@pytest.fixture
async def store(tmp_path: Path) -> AsyncIterator[Store]:
    opened = await Store.open(f"sqlite:///{tmp_path / 'live.sqlite'}")
    yield opened
    await opened.close()


@pytest.fixture
async def server(store: Store) -> AsyncIterator[Server]:
    async with serving(store, Feed(ring_capacity=2000, queue_capacity=50)) as running:
        yield running


def motion(second: int, station: str = "a", n: int = 100) -> Motion:
    d, v, a, s = (np.full((n, 3), 0.001 * (second + 1)) * [1, 2, 3] for _ in range(4))
    return Motion(station, T0 + second * S, T0 + second * S, S // n, d, v, a, s, Status.PPP_FLOAT, 2)


def one_of_each() -> list[Any]:
    solution = Solution(
        "a", T0, T0, Status.PPP_FLOAT, "", 9, np.array([4e6, 0, 5e6]), np.ones(3), np.eye(3), np.ones(3), "G"
    )
    event = AlertEvent("x", "a", "t", AlertState.ACTIVE, Severity.ALARM, T0, T0, T0, "displacement_up", 0.06, 0.05, "!")
    status = StationStatus("a", T0, "receiving", "", T0, Status.PPP_FLOAT, 9, {"n": 1})
    one, half = np.ones(1), np.full(1, 0.5)
    quality = QualityReport(
        "a", T0, T0, {"statistic": 1.5}, np.array([4], np.int16), np.array([True]), np.array([[1, 9]], np.int16),
        one, one, half, one, one, np.ones((1, 3)), half, one, one, np.zeros(1, np.int8),
        0.9, 1.2, 1.5, 0.02, 0.04, 1e-5, ("cycle slip of G05",),
    )  # fmt: skip
    return [solution, motion(0), status, event, quality]


async def eventually(condition: Callable[[], bool]) -> None:
    """Wait until something is so, ten seconds at most."""
    for _ in range(500):
        if condition():
            return
        await asyncio.sleep(0.02)
    raise AssertionError("it never came to be")


async def receive(connection: ClientConnection) -> dict[str, Any]:
    return dict(json.loads(await asyncio.wait_for(connection.recv(), 5.0)))


async def test_messages_have_the_form_that_is_documented(server: Server) -> None:
    examples = stream_examples()
    assert set(examples) == {
        "hello", "subscribed", "solution", "attitude", "motion", "status", "alert", "quality", "missed", "error",
    }  # fmt: skip
    async with connect(
        server.stream + "?channel=solution,motion&channel=status&channel=alert&channel=quality&station=a"
    ) as connection:
        got = [await receive(connection), await receive(connection)]
        server.feed.publish_all([motion(0, "b"), *one_of_each()])
        got += [await receive(connection) for _ in range(5)]
        await connection.send('{"action": "subscribe", "channels": ["weather"]}')
        got.append(await receive(connection))
    assert [message["type"] for message in got] == [
        "hello",
        "subscribed",
        "solution",
        "motion",
        "status",
        "alert",
        "quality",
        "error",
    ]
    for message in got:
        example = examples[message["type"]]
        assert set(message) == set(example)
        for name, value in example.items():
            if value is not None and message[name] is not None:
                assert isinstance(message[name], (int, float) if isinstance(value, float) else type(value)), name
    assert got[3]["up_mm"] == [3.0] * 100
    assert (got[3]["interval_s"], got[3]["revision"], got[3]["time"]) == (0.01, 2, "2026-03-01T12:00:00.000Z")
    numbers = [message["sequence"] for message in got[2:7]]
    assert numbers == list(range(numbers[0], numbers[0] + 5))


async def test_a_bare_connection_gets_nothing_until_it_asks_and_may_ask_anew(server: Server) -> None:
    async with connect(server.stream) as connection:
        assert (await receive(connection))["type"] == "hello"
        server.feed.publish(motion(0))
        with pytest.raises(TimeoutError):
            await asyncio.wait_for(connection.recv(), 0.1)
        await connection.send(json.dumps({"action": "subscribe", "stations": ["b"], "motion_rate_hz": 10}))
        assert (await receive(connection))["stations"] == ["b"]
        server.feed.publish_all([motion(1), motion(1, "b")])
        thin = await receive(connection)
        assert (thin["station"], thin["interval_s"], len(thin["east_mm"])) == ("b", 0.1, 10)
        await connection.send(json.dumps({"action": "subscribe", "stations": ["a"]}))
        assert (await receive(connection))["stations"] == ["a"]
        server.feed.publish_all([motion(2, "b"), motion(2)])
        assert (await receive(connection))["station"] == "a"
    assert server.feed.n_subscribers <= 1


@pytest.mark.parametrize("text", ["", "{", "[]", '{"action": "shout"}', '{"action": "subscribe", "stations": ["a/b"]}',
                                  '{"action": "subscribe", "resume_from": -1}', '"\\ud800"', "1" * 5000])  # fmt: skip
async def test_a_message_that_makes_no_sense_is_answered_and_survived(server: Server, text: str) -> None:
    async with connect(server.stream + "?station=a") as connection:
        await receive(connection), await receive(connection)
        await connection.send(text)
        assert (await receive(connection))["type"] == "error"
        server.feed.publish(motion(0))
        assert (await receive(connection))["type"] == "motion"


async def test_an_address_that_makes_no_sense_is_answered_and_closed(server: Server) -> None:
    for query in ("resume_from=x", "channel=weather", "colour=red", "station=a%2Fb", "motion_rate_hz=nan"):
        async with connect(f"{server.stream}?{query}") as connection:
            assert (await receive(connection))["type"] == "hello"
            assert (await receive(connection))["type"] == "error"
            await asyncio.wait_for(connection.wait_closed(), 5.0)
            assert connection.close_code == 1008
    assert server.feed.n_subscribers == 0


async def test_a_slow_client_is_told_what_it_missed_and_holds_up_nobody(server: Server) -> None:
    async with (
        connect(server.stream + "?channel=motion", max_queue=1, compression=None) as slow,
        connect(server.stream + "?station=a") as quick,
    ):
        for connection in (slow, quick):
            await receive(connection), await receive(connection)
        total, got = 1500, 0
        for i in range(total):
            server.feed.publish(motion(i))
            if i % 20 == 19:  # the quick one keeps up
                for _ in range(20):
                    assert (await receive(quick))["type"] == "motion"
                got += 20
        assert got == total
        counted, seen, last = 0, 0, None
        while counted + seen < total:
            message = await receive(slow)
            first = message["first_sequence"] if message["type"] == "missed" else message["sequence"]
            assert last is None or first == last + 1
            last = message["last_sequence"] if message["type"] == "missed" else message["sequence"]
            counted += message.get("count", 0)
            seen += message["type"] == "motion"
        assert counted > 0
        assert counted + seen == total


async def test_resuming_after_a_lost_connection(server: Server) -> None:
    async with connect(server.stream + "?station=a") as connection:
        hello = await receive(connection)
        await receive(connection)
        server.feed.publish_all([motion(i) for i in range(3)])
        last = [await receive(connection) for _ in range(3)][-1]["sequence"]
    server.feed.publish_all([motion(i) for i in range(3, 6)])
    query = f"station=a&resume_from={last + 1}&feed={hello['feed']}"
    async with connect(f"{server.stream}?{query}") as connection:
        await receive(connection), await receive(connection)
        again = [await receive(connection) for _ in range(3)]
    assert [message["sequence"] for message in again] == [last + 1, last + 2, last + 3]
    async with connect(f"{server.stream}?station=a&resume_from={last}&feed=another") as connection:
        await receive(connection), await receive(connection)
        assert (await receive(connection))["type"] == "missed"
        assert len([await receive(connection) for _ in range(6)]) == 6


async def test_the_client_streams_on_over_a_restart_of_the_server(store: Store) -> None:
    feed = Feed()
    got: list[dict[str, Any]] = []

    async def listen(client: AsyncClient) -> None:
        async for message in client.stream(stations=["a"], channels=["motion"]):
            got.append(message)

    async with serving(store, feed) as running:
        client = AsyncClient(running.url)
        listener = asyncio.create_task(listen(client))
        await eventually(lambda: feed.n_subscribers > 0)
        feed.publish_all([motion(i) for i in range(3)])
        await eventually(lambda: len(got) == 3)
    feed.publish_all([motion(i) for i in range(3, 6)])  # while nobody listens
    async with serving(store, feed, running.port):
        feed.publish(motion(6))
        await eventually(lambda: len(got) >= 7)
        listener.cancel()
        await client.close()
    assert [message["east_mm"][0] for message in got] == [float(i + 1) for i in range(7)]


async def test_the_client_says_that_a_subscription_makes_no_sense(server: Server) -> None:
    async with AsyncClient(server.url) as client:
        with pytest.raises(ValueError, match="channels"):
            async for _ in client.stream(channels=["weather"]):
                pass


async def test_both_clients_do_the_whole_round(server: Server) -> None:
    await server.store.create_station(StationSettings(station="b"))
    await server.store.write([*one_of_each(), *(motion(i, "b", n=10) for i in range(30))])
    await server.store.write([Solution("b", T0 + i * S, T0, Status.NO_BASE, "no base", 3) for i in range(1500)])
    await asyncio.to_thread(round_trip, server.url)
    async with AsyncClient(server.url) as client:
        assert [station["station"] for station in await client.stations()] == ["b"]
        assert len((await client.solutions("b"))["time"]) == 1500
        motion_b = await client.motion("b", start=START, end=START + timedelta(seconds=10), max_points=10)
        assert motion_b["count"].tolist() == [10] * 10
        assert (await client.acknowledge("x"))["acknowledged_by"] == "Ada"
        assert [alert["alert_id"] for alert in await client.alerts(state="acknowledged")] == ["x"]
        assert await client.thresholds() == []
        with pytest.raises(PlumblineError, match="404"):
            await client.status("none")


def round_trip(url: str) -> None:
    """What an operator does, blocking."""
    with Client(url) as client:
        made = client.create_station({"station": "c", "latitude_deg": 1.0, "longitude_deg": 2.0, "height_m": 3.0})
        assert made["height_m"] == pytest.approx(3.0, abs=1e-4)
        assert client.change_station("c", {"name": "C"})["version"] == 2
        assert client.station("c")["name"] == "C"
        threshold = {"threshold_id": "t", "station": "c", "quantity": "displacement_up", "level": 50}
        assert client.create_threshold(threshold)["unit"] == "mm"
        assert client.change_threshold("t", {"level": 60})["level"] == 60
        assert len(client.thresholds("c")) == 1
        client.delete_threshold("t")
        client.delete_station("c", purge=True)
        with pytest.raises(PlumblineError) as caught:
            client.create_station({"station": "c/d"})
        assert caught.value.errors[0]["where"] == "body.station"
        assert client.status("b")["state"] == "waiting"
        solutions = client.solutions("b", end=START + timedelta(seconds=1200))
        assert len(solutions["time"]) == 1200
        assert set(solutions["status"]) == {"no_base"}
        assert np.isnan(solutions["east_mm"]).all()
        samples = client.motion("b", max_points=300)
        assert samples["east_mm"][:11].tolist() == [1.0] * 10 + [2.0]
        assert samples["time"][1] - samples["time"][0] == np.timedelta64(100, "ms")
        assert client.acknowledge("x", "Ada", "seen")["state"] == "acknowledged"
        assert len(client.alert("x")["history"]) == 2
        assert client.alerts(station="nobody") == []
        assert client.devices() == []
