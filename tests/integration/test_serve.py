"""The whole server as its users meet it: REST, WebSocket, devices, signals."""

import asyncio
import json
import re
import socket
import time
from collections.abc import Callable
from pathlib import Path

import httpx
import pytest
import websockets

CONFIG = """
http_host = "127.0.0.1"
http_port = 0
ingest_host = "127.0.0.1"
ingest_port = 0
workers = 1

[[stations]]
station = "seeded"
mode = "ppp"
device = { registrations = ["SEED"] }
"""

pytestmark = pytest.mark.timeout(180)


def ready(http: str) -> bool:
    return httpx.get(f"{http}/readyz", timeout=60.0).status_code == 200


@pytest.mark.realdata
def test_from_an_unknown_device_to_its_positions(serve: Callable, device: type, data_dir: Path) -> None:
    """A device calls, is listed, a station is made for it over REST, and its epochs arrive over the WebSocket."""
    server = serve(CONFIG)
    server.wait_for(lambda: ready(server.http))
    recording = (data_dir / "str-2018-195" / "week-rollover-STR17.rtcm3").read_bytes()[:600_000]

    async def call() -> None:
        async with device(server.ingest_port, b"867322041234567"):
            await asyncio.sleep(0.2)

    asyncio.run(call())
    (caller,) = httpx.get(f"{server.http}/v1/devices").json()["items"]
    assert caller["identity"] == "867322041234567"
    assert caller["reason"] == "unknown_device"
    body = {"station": "adopted", "mode": "ppp", "device": {"registrations": [caller["identity"]]}}
    assert httpx.post(f"{server.http}/v1/stations", json=body).status_code == 201

    async def play() -> list[dict]:
        seen: list[dict] = []
        async with websockets.connect(f"{server.http.replace('http', 'ws')}/v1/stream") as stream:
            subscribe = {"action": "subscribe", "stations": ["adopted"], "channels": ["solution"]}
            await stream.send(json.dumps(subscribe))
            async with device(server.ingest_port, caller["identity"].encode()) as one:
                await one.send(recording)
                async with asyncio.timeout(30.0):
                    while not any("single_point" in json.dumps(message) for message in seen):
                        seen.append(json.loads(await stream.recv()))
        return seen

    assert asyncio.run(play())
    server.wait_for(
        lambda: httpx.get(f"{server.http}/v1/stations/adopted/status").json()["state"] == "receiving", timeout_s=20.0
    )
    text = httpx.get(f"{server.http}/metrics").text
    assert re.search(r'plumbline_ingest\{process="\w+",what="refused_unknown_device"\} 1.0', text)
    assert httpx.delete(f"{server.http}/v1/stations/adopted").status_code == 204
    asyncio.run(call())  # nobody again
    assert server.stop() == 0
    assert "Traceback" not in server.log, server.log


def test_the_end_waits_for_no_open_connection(serve: Callable) -> None:
    server = serve(CONFIG)
    server.wait_for(lambda: ready(server.http))
    with (
        socket.create_connection(("127.0.0.1", server.ingest_port)),
        socket.create_connection(("127.0.0.1", server.ingest_port)),
    ):
        began = time.monotonic()
        assert server.stop() == 0
        assert time.monotonic() - began < 30
    assert "Traceback" not in server.log, server.log


def test_a_taken_port_is_said_and_ends_the_server(serve: Callable) -> None:
    with socket.create_server(("127.0.0.1", 0)) as taken:
        config = CONFIG.replace("ingest_port = 0", f"ingest_port = {taken.getsockname()[1]}")
        server = serve(config, wait=False)
        assert server.process.wait(60) == 1
    assert "cannot serve" in server.log
    assert "address already in use" in server.log
