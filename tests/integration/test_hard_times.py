"""What an operator meets: a full disk, a locked database, a store that comes late. Nothing is lost, nothing hangs.

Oracle: every byte sent is archived, and every stored row equals the archive's replay (see test_takeover).
"""

import asyncio
import contextlib
import re
import resource
import sqlite3
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import httpx
import pytest
from tests.integration.test_takeover import (
    CONFIG,
    assert_all_archived,
    assert_equals_replay,
    free_port,
    ready,
    recordings,
    send,
    send_until_killed,
    wait_until_all_consumed,
)

pytestmark = [pytest.mark.realdata, pytest.mark.slow, pytest.mark.timeout(900)]

N_PACKETS = 100


@contextlib.contextmanager
def full_disk(server: Any) -> Iterator[None]:
    """The operating system refuses every byte that the main process would write to a file."""
    before = resource.prlimit(server.process.pid, resource.RLIMIT_FSIZE)
    resource.prlimit(server.process.pid, resource.RLIMIT_FSIZE, (1, before[1]))
    try:
        yield
    finally:
        resource.prlimit(server.process.pid, resource.RLIMIT_FSIZE, before)


@contextlib.contextmanager
def locked_database(server: Any) -> Iterator[None]:
    """Another process keeps the database to itself."""
    with contextlib.closing(sqlite3.connect(server.data_dir / "plumbline.sqlite", timeout=30.0)) as connection:
        connection.isolation_level = None
        connection.execute("BEGIN IMMEDIATE")
        try:
            yield
        finally:
            connection.execute("ROLLBACK")


@pytest.mark.parametrize(("trouble", "part"), [(full_disk, "archive"), (locked_database, "database")])
def test_trouble_under_traffic_is_told_and_leaves_no_mark(
    serve: Callable, device: type, data_dir: Path, trouble: Callable, part: str
) -> None:
    packets = recordings(data_dir)
    server = serve(CONFIG.format(extra=""))
    server.wait_for(lambda: ready(server.http))

    def told() -> str:
        return httpx.get(f"{server.http}/readyz", timeout=60.0).text

    async def play() -> None:
        sending = asyncio.create_task(
            send(device, server.ingest_port, packets, 0, N_PACKETS, pause_s=0.03, linger=recovered)
        )
        await asyncio.sleep(2.0)
        with trouble(server):
            await asyncio.to_thread(server.wait_for, lambda: part in told())
        await asyncio.to_thread(server.wait_for, lambda: ready(server.http))
        recovered.set()
        await sending

    recovered = asyncio.Event()
    asyncio.run(play())
    wait_until_all_consumed(server)
    assert server.stop() == 0, server.log
    assert_all_archived(server.data_dir, packets, N_PACKETS)
    assert_equals_replay(server.data_dir, least_rows=N_PACKETS * 3)


def test_an_ingest_that_was_first_learns_its_stations_when_a_store_comes(serve: Callable, device: type) -> None:
    port = free_port()
    hub, spoke = (
        CONFIG.format(extra=f"bus_{key}")
        for key in (f'endpoint = "tcp/127.0.0.1:{port}"', f'connect = ["tcp/127.0.0.1:{port}"]')
    )
    ingest = serve(hub, "--role", "ingest")
    assert "beginning with 0 stations" in ingest.log

    async def call() -> None:
        async with device(ingest.ingest_port, b"rover!"):
            await asyncio.sleep(0.2)

    asyncio.run(call())
    assert "rover connected" not in ingest.log
    serve(spoke, "--role", "store")

    def known() -> bool:
        asyncio.run(call())
        return "rover connected" in ingest.log

    ingest.wait_for(known)


MANY = [f"s{number:02d}" for number in range(60)]
MANY_CONFIG = """
http_host = "127.0.0.1"
http_port = 0
ingest_host = "127.0.0.1"
ingest_port = 0
checkpoint_interval_s = 2.0
workers = 2
""" + "".join(
    f"""
[[stations]]
station = "{name}"
mode = "{"corrections" if name == "ssr" else "ppp"}"
device = {{ registrations = ["{name}!"] }}
"""
    for name in (*MANY, "ssr")
)


@pytest.mark.soak
@pytest.mark.timeout(1800)
def test_sixty_stations_through_a_restart_and_a_worker_that_comes_late(
    serve: Callable, device: type, data_dir: Path
) -> None:
    packets = recordings(data_dir)
    streams = dict.fromkeys(MANY, packets["rover"]) | {"ssr": packets["ssr"]}
    n = 40  # of four seconds each: ephemerides come every two minutes

    async def play(server: Any, begin: int, disturb: Callable[[], Any]) -> int:
        sending = asyncio.create_task(send_until_killed(device, server.ingest_port, streams, begin, n, pause_s=0.5))
        await asyncio.sleep(6.0)
        await asyncio.to_thread(disturb)
        return await sending

    server = serve(MANY_CONFIG)
    server.wait_for(lambda: ready(server.http))
    reached = asyncio.run(play(server, 0, server.stop))
    assert 0 < reached < n
    server = serve(MANY_CONFIG)
    (endpoint,) = re.findall(r"serving: bus (\S+),", server.log)
    asyncio.run(play(server, reached, lambda: serve(f'bus_connect = ["{endpoint}"]\nworkers = 1', "--role", "worker")))
    wait_until_all_consumed(server, MANY)
    assert server.stop() == 0, server.log
    assert_equals_replay(server.data_dir, least_rows=n * 2, stations=MANY)
