"""`kill -9` of any process leaves the stored series as if nothing had happened.

Oracle: the archive through the pipelines once more, in one undisturbed go; every stored row must equal its row.
"""

import asyncio
import contextlib
import functools
import itertools
import json
import os
import random
import signal
import socket
import sqlite3
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

from plumbline.archive import Archive
from plumbline.bus.messages import StationConfig
from plumbline.records import Solution
from plumbline.store import Store
from plumbline.worker.replay import replay_archive

pytestmark = [pytest.mark.realdata, pytest.mark.slow, pytest.mark.timeout(900)]

CONFIG = """
http_host = "127.0.0.1"
http_port = 0
ingest_host = "127.0.0.1"
ingest_port = 0
checkpoint_interval_s = 1.0
workers = 2
{extra}

[[stations]]
station = "rover"
mode = "ppp"
device = {{ registrations = ["rover!"] }}

[[stations]]
station = "base"
mode = "ppp"
device = {{ registrations = ["base!"] }}

[[stations]]
station = "ssr"
mode = "corrections"
device = {{ registrations = ["ssr!"] }}
"""
FILES = {"rover": "ROVRMSG.bin", "base": "ROMAMSG.bin", "ssr": "SSRTEST_20260206_CORR.bin"}
PACKETS = 600  # each stream is cut into as many packets: about four seconds of data in each


def recordings(data_dir: Path) -> dict[str, list[bytes]]:
    """Each stream, cut into ``PACKETS`` packets."""
    cut = {}
    for name, file in FILES.items():
        data = (data_dir / "sc134-2026-037" / file).read_bytes()
        edges = np.linspace(0, len(data), PACKETS + 1).astype(int)
        cut[name] = [data[a:b] for a, b in itertools.pairwise(edges)]
    return cut


async def send(
    device: type,
    port: int,
    packets: dict[str, list[bytes]],
    begin: int,
    end: int,
    pause_s: float = 0.01,
    linger: asyncio.Event | None = None,
) -> None:
    """Packets ``begin`` to ``end`` of every stream, in step; the last ones not before ``linger``."""
    devices = {name: device(port, f"{name}!".encode()) for name in packets}
    await asyncio.gather(*(one.__aenter__() for one in devices.values()))
    for i in range(begin, end):
        if linger is not None and i == end - 10:
            await linger.wait()
        for name, one in devices.items():
            await one.send(packets[name][i], packet=1 << 20, pause_s=0.0)
        await asyncio.sleep(pause_s)
    for one in devices.values():
        await one.__aexit__()


async def stored_solutions(data_dir: Path) -> tuple[dict[str, list[Solution]], list[StationConfig]]:
    """Every stored solution by station, and the stations."""
    store = await Store.open(f"sqlite:///{data_dir / 'plumbline.sqlite'}")
    configs = [
        StationConfig(row.settings.station, row.settings, (), row.created_gps_ns, row.changed_gps_ns)
        for row in await store.stations()
    ]
    found: dict[str, list[Solution]] = {}
    for config in configs:
        rows: list[Solution] = []
        page = await store.solutions(config.station, limit=5000)
        rows += page.items
        while page.next:
            page = await store.solutions(config.station, limit=5000, cursor=page.next)
            rows += page.items
        if rows:
            found[config.station] = rows
    await store.close()
    return found, configs


def undisturbed(data_dir: Path, configs: list[StationConfig]) -> dict[str, list[Solution]]:
    """What one pass over the archive gives, by station, in order of time, the last row of each time."""
    archive = Archive(data_dir / "archive", writable=False)
    rows: dict[str, dict[int, Solution]] = {}
    for output in replay_archive(archive, configs):
        if isinstance(output, Solution):
            rows.setdefault(output.station, {})[output.t_gps_ns] = output
    return {station: [by_time[t] for t in sorted(by_time)] for station, by_time in rows.items()}


def row(solution: Solution) -> tuple[object, ...]:
    """A solution as plain values, for an exact comparison."""
    arrays = (solution.position_ecef_m, solution.displacement_enu_m, solution.velocity_enu_m_s)
    plain = tuple(None if a is None else tuple(np.asarray(a).tolist()) for a in arrays)
    covariance = None if solution.covariance_enu_m2 is None else tuple(solution.covariance_enu_m2[np.triu_indices(3)])
    return (
        solution.t_gps_ns,
        solution.t_receive_ns,
        solution.status,
        solution.reason,
        solution.n_satellites,
        solution.systems,
        solution.zenith_delay_m,
        solution.correction_age_s,
        covariance,
        *plain,
    )


QUIET_S = 2.0  # the last epoch of a stream closes by its deadline


STATIONS = ("base", "rover")


def consumed(data_dir: Path, stations: Sequence[str]) -> dict[str, int]:
    """How far into their archived bytes the stored checkpoints of the stations are."""
    archive = Archive(data_dir / "archive", writable=False)
    with contextlib.closing(sqlite3.connect(data_dir / "plumbline.sqlite")) as connection:
        rows = dict(connection.execute("SELECT station, consumed FROM checkpoints").fetchall())
    return {station: json.loads(rows.get(station, "{}")).get(archive.archive_id, 0) for station in stations}


def all_consumed(data_dir: Path, stations: Sequence[str]) -> bool:
    """Whether the stored checkpoints of stations have consumed all that is archived."""
    archive = Archive(data_dir / "archive", writable=False)
    return all(offset == archive.end(station) for station, offset in consumed(data_dir, stations).items())


def wait_until_all_consumed(server: Any, stations: Sequence[str] = STATIONS) -> None:
    """However busy the machine is, as long as it gets on."""
    folder = server.data_dir
    server.wait_for(lambda: all_consumed(folder, stations), progress=lambda: consumed(folder, stations))
    time.sleep(QUIET_S)


def ready(http: str) -> bool:
    """Whether every role is there."""
    return httpx.get(f"{http}/readyz", timeout=60.0).status_code == 200


def assert_all_archived(data_dir: Path, packets: dict[str, list[bytes]], n: int) -> None:
    """Every byte that was sent is in the archive."""
    archive = Archive(data_dir / "archive", writable=False)
    assert {s: archive.end(s) for s in packets} == {s: sum(map(len, cut[:n])) for s, cut in packets.items()}


def assert_equals_replay(data_dir: Path, least_rows: int, stations: Sequence[str] = STATIONS) -> None:
    """Every stored row equals the undisturbed one, and none is missing or too many."""
    stored, configs = asyncio.run(stored_solutions(data_dir))
    expected = undisturbed(data_dir, configs)
    assert sorted(stored) == sorted(expected) == sorted(stations)
    for station, solutions in expected.items():
        assert len(solutions) >= least_rows
        found = [row(s) for s in stored[station]]
        wanted = [row(s) for s in solutions]
        different = [(a, b) for a, b in zip(found, wanted, strict=False) if a != b]
        assert not different, f"{station}: {len(different)} rows differ, first {different[0]}"
        assert len(found) == len(wanted)


def test_killed_workers_leave_no_mark(serve: Callable, device: type, data_dir: Path) -> None:
    packets = recordings(data_dir)
    server = serve(CONFIG.format(extra=""))

    async def play() -> None:
        sending = asyncio.create_task(send(device, server.ingest_port, packets, 0, PACKETS, pause_s=0.02))
        for _ in range(3):
            await asyncio.sleep(4.0)
            os.kill(server.children()[0], signal.SIGKILL)
        await sending

    asyncio.run(play())
    wait_until_all_consumed(server)
    assert server.stop() == 0, server.log
    assert server.log.count("ended with -9") == 3
    assert_equals_replay(server.data_dir, least_rows=2500)


def free_port() -> int:
    """A TCP port that nobody listens on at the moment."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return int(probe.getsockname()[1])


async def send_until_killed(
    device: type, port: int, packets: dict[str, list[bytes]], begin: int, end: int, pause_s: float = 0.01
) -> int:
    """Packets from ``begin`` on, as far as the server lives; the number of the next."""
    devices = {name: device(port, f"{name}!".encode()) for name in packets}
    i = begin
    with contextlib.suppress(OSError):
        await asyncio.gather(*(one.__aenter__() for one in devices.values()))
        while i < end:
            for name, one in devices.items():
                await one.send(packets[name][i], packet=1 << 20, pause_s=0.0)
            i += 1
            await asyncio.sleep(pause_s)
    for one in devices.values():
        with contextlib.suppress(OSError, AttributeError):
            await one.__aexit__()
    return i


def kill_with_workers(server: Any) -> None:
    """`kill -9` of the server; its workers leave by themselves."""
    workers = server.children()
    server.kill()
    deadline = time.monotonic() + 30
    while any(Path(f"/proc/{pid}").exists() for pid in workers) and time.monotonic() < deadline:
        time.sleep(0.1)
    assert not any(Path(f"/proc/{pid}").exists() for pid in workers), "workers outlive their server"


def kill_server_twice(serve: Callable, device: type, data_dir: Path, seed: int, n: int) -> None:
    """A server is killed in the midst of traffic, and the next one too, which may still be catching up.

    What was on its way to a killed server is lost to the archive, and may be all that was sent to it.
    """
    choice = random.Random(seed)
    packets = recordings(data_dir)

    async def play(server: Any, begin: int, kill_after_s: float) -> int:
        sending = asyncio.create_task(send_until_killed(device, server.ingest_port, packets, begin, n))
        await asyncio.sleep(kill_after_s)
        await asyncio.to_thread(kill_with_workers, server)
        return await sending

    reached = 0
    for kill_after_s in (choice.uniform(1.2, 3.0), choice.choice((choice.uniform(0.0, 2.5), choice.uniform(2.5, 8.0)))):
        server = serve(CONFIG.format(extra=""))
        reached = asyncio.run(play(server, reached, kill_after_s))
    server = serve(CONFIG.format(extra=""))
    asyncio.run(send_until_killed(device, server.ingest_port, packets, reached, reached + n // 2))
    wait_until_all_consumed(server)
    assert server.stop() == 0, server.log
    assert_equals_replay(server.data_dir, least_rows=n)


def test_killed_server_resumes_where_it_was(serve: Callable, device: type, data_dir: Path) -> None:
    kill_server_twice(serve, device, data_dir, seed=0, n=100)


@pytest.mark.soak
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("seed", range(1, 21))
def test_killed_server_at_many_moments(serve: Callable, device: type, data_dir: Path, seed: int) -> None:
    kill_server_twice(serve, device, data_dir, seed, n=100)


def kill_ingest(serve: Callable, device: type, data_dir: Path, hub: str, seed: int, n: int) -> None:
    """Every role is a process; the ingest is killed in the midst of traffic and started again, the others live on."""
    choice = random.Random(seed)
    packets = recordings(data_dir)
    port = free_port()
    ends = {True: f'bus_endpoint = "tcp/127.0.0.1:{port}"', False: f'bus_connect = ["tcp/127.0.0.1:{port}"]'}
    roles = ("ingest", "store", "worker")
    started = {
        role: serve(CONFIG.format(extra=ends[role == hub]), "--role", role, wait=role == hub == "store")
        for role in sorted(roles, key=lambda role: role != hub)
    }
    for one in started.values():
        one.wait_until_serving()

    async def play(begin: int, kill_after_s: float) -> int:
        sending = asyncio.create_task(
            send_until_killed(device, started["ingest"].ingest_port, packets, begin, n, pause_s=0.03)
        )
        await asyncio.sleep(kill_after_s)
        await asyncio.to_thread(started["ingest"].kill)
        return await sending

    reached = 0
    for kill_after_s in (choice.uniform(1.5, 3.0), choice.uniform(1.0, 2.5)):
        reached = asyncio.run(play(reached, kill_after_s))
        started["ingest"] = serve(CONFIG.format(extra=ends[hub == "ingest"]), "--role", "ingest")
    asyncio.run(send_until_killed(device, started["ingest"].ingest_port, packets, reached, reached + n // 2))
    wait_until_all_consumed(started["ingest"])
    for role in ("worker", "store", "ingest") if hub == "ingest" else ("ingest", "worker", "store"):
        assert started[role].stop() == 0, started[role].log
    assert_equals_replay(started["ingest"].data_dir, least_rows=n)


@pytest.mark.parametrize("hub", ["store", "ingest"])
def test_killed_ingest_leaves_no_mark(serve: Callable, device: type, data_dir: Path, hub: str) -> None:
    kill_ingest(serve, device, data_dir, hub, seed=0, n=80)


@pytest.mark.soak
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("seed", range(1, 6))
@pytest.mark.parametrize("hub", ["store", "ingest"])
def test_killed_ingest_at_many_moments(serve: Callable, device: type, data_dir: Path, hub: str, seed: int) -> None:
    kill_ingest(serve, device, data_dir, hub, seed, n=100)


def test_orderly_end_and_restart_lose_nothing(serve: Callable, device: type, data_dir: Path) -> None:
    packets = recordings(data_dir)
    for begin, end in ((0, 200), (200, 400), (400, PACKETS)):
        server = serve(CONFIG.format(extra=""))
        server.wait_for(functools.partial(ready, server.http))
        asyncio.run(send(device, server.ingest_port, packets, begin, end, pause_s=0.0))
        if end == PACKETS:
            wait_until_all_consumed(server)
        assert server.stop() == 0, server.log
        assert "Traceback" not in server.log, server.log
        assert_all_archived(server.data_dir, packets, end)
    assert_equals_replay(server.data_dir, least_rows=2500)


def test_killed_store_gets_what_it_missed(serve: Callable, device: type, data_dir: Path) -> None:
    packets = recordings(data_dir)
    hub = CONFIG.format(extra='bus_endpoint = "tcp/127.0.0.1:19711"')
    spoke = CONFIG.format(extra='bus_connect = ["tcp/127.0.0.1:19711"]')
    ingest = serve(hub, "--role", "ingest", wait=False)
    store = serve(spoke, "--role", "store", wait=False)
    store.wait_until_serving()
    ingest.wait_until_serving()
    worker = serve(spoke, "--role", "worker")

    async def play() -> Callable:
        sending = asyncio.create_task(send(device, ingest.ingest_port, packets, 0, PACKETS, pause_s=0.02))
        await asyncio.sleep(5.0)
        await asyncio.to_thread(store.kill)
        await asyncio.sleep(3.0)
        again = await asyncio.to_thread(serve, spoke, "--role", "store")
        await sending
        return again

    store = asyncio.run(play())
    wait_until_all_consumed(ingest)
    assert worker.stop() == 0, worker.log
    assert store.stop() == 0, store.log
    assert ingest.stop() == 0, ingest.log
    assert_equals_replay(ingest.data_dir, least_rows=2500)
