"""Latency through the real server: last byte of a rover's epoch on the socket → its solution on the bus.

Run as ``python -m tests.benchmarks.latency``. A server of its own (ingest, archive, bus, a worker, store) positions a
simulated rover against a base under some forty satellites on two frequencies. The base's epoch is sent a little before
the rover's, so that waiting for it is not in the figure; a base that is later by x ms adds x (up to ``base_wait_s``).
"""

import asyncio
import os
import socket
import subprocess
import sys
import tempfile
import time
from itertools import groupby
from pathlib import Path

import numpy as np
from tests.benchmarks.table import Row, format_rows, time_row

from plumbline.bus import Bus, Inbox, codec, keys
from plumbline.bus.messages import decode_numbered
from plumbline.gnss.earth_frames import ecef_from_geodetic
from plumbline.gps_time import NS_PER_S
from plumbline.records import Solution
from plumbline_dtu.simulation.constellation import Constellation
from plumbline_dtu.simulation.station import StationPlan, simulate_station

ASKED_MS = 10.0
_START_NS = 1_383_900_000 * NS_PER_S
_EPOCHS = 90
_WARM = 30
_INTERVAL_S = 0.3
_BASE_AHEAD_S = 0.1
_CONFIG = """
http_host = "127.0.0.1"
http_port = 0
ingest_host = "127.0.0.1"
ingest_port = {ingest}
bus_endpoint = "tcp/127.0.0.1:{bus}"
workers = 1

[[stations]]
station = "rover"
mode = "rtk"
device = {{ registrations = ["rover!"] }}
positioning = {{ systems = "GEC", elevation_mask_deg = 10.0 }}
rtk = {{ base_stream = "base", base_wait_s = 2.0 }}

[[stations]]
station = "base"
mode = "corrections"
device = {{ registrations = ["base!"] }}
"""


def _free_port() -> int:
    with socket.socket() as listener:
        listener.bind(("127.0.0.1", 0))
        return int(listener.getsockname()[1])


def _epochs(number: int, sky: Constellation) -> list[bytes]:
    """What a station sends, an epoch each: base (0) and rover (1), a metre apart."""
    x, y, z = (ecef_from_geodetic(0.3896, 1.9923, 60.0) + np.array([0.0, 0.0, 0.99 * number])).tolist()
    plan = StationPlan(f"s{number}", (x, y, z), station_id=number + 1, seed=number + 1)
    sent = simulate_station(plan, sky, _START_NS, _START_NS + _EPOCHS * NS_PER_S)
    return [b"".join(data for _, data in part) for _, part in groupby(sent, key=lambda one: one[0] // NS_PER_S)]


async def _connect(port: int, registration: bytes) -> asyncio.StreamWriter:
    _, writer = await asyncio.open_connection("127.0.0.1", port)
    writer.write(registration)
    await asyncio.sleep(0.7)  # a registration that nothing else ends is ended by silence
    return writer


async def _latencies(ingest: int, bus_port: int, base: list[bytes], rover: list[bytes]) -> tuple[list[float], int]:
    """Seconds of every epoch behind the warm-up, and the satellites used at most."""
    bus = await Bus.open(connect=(f"tcp/127.0.0.1:{bus_port}",))
    inbox = Inbox()
    bus.subscribe(keys.of(keys.SOLUTION, "rover"), inbox)
    arrived_s: dict[int, float] = {}
    satellites = [0]

    async def read() -> None:
        while True:
            messages = await inbox.get()
            now_s = time.perf_counter()
            for message in messages:
                solution = codec.decode(decode_numbered(message.payload).body)
                if isinstance(solution, Solution):
                    arrived_s.setdefault(solution.t_gps_ns, now_s)
                    satellites[0] = max(satellites[0], solution.n_satellites)

    reader = asyncio.create_task(read())
    writers = await _connect(ingest, b"base!"), await _connect(ingest, b"rover!")
    sent_s: dict[int, float] = {}
    for k in range(min(len(base), len(rover))):
        while k == _WARM and _START_NS + (k - 1) * NS_PER_S not in arrived_s:  # noqa: ASYNC110 - read() fills it
            await asyncio.sleep(0.1)  # the worker is still starting
        writers[0].write(base[k])
        await asyncio.sleep(_BASE_AHEAD_S)
        writers[1].write(rover[k])
        sent_s[_START_NS + k * NS_PER_S] = time.perf_counter()
        await asyncio.sleep(_INTERVAL_S - _BASE_AHEAD_S)
    await asyncio.sleep(2.0)
    reader.cancel()
    for writer in writers:
        writer.close()
    await bus.close()
    measured = list(sent_s)[_WARM:]
    return [arrived_s[t] - sent_s[t] for t in measured if t in arrived_s], satellites[0]


def run() -> list[Row]:
    """Median and 95th percentile, milliseconds, against what is asked."""
    sky = Constellation(_START_NS, "GEC", geosynchronous=True)
    base, rover = _epochs(0, sky), _epochs(1, sky)
    ports = _free_port(), _free_port()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        (folder / "plumbline.toml").write_text(_CONFIG.format(ingest=ports[0], bus=ports[1]), encoding="utf-8")
        command = [sys.executable, "-m", "plumbline.cli", "serve", "--config", str(folder / "plumbline.toml")]
        threads = dict.fromkeys(("NUMBA_NUM_THREADS", "OPENBLAS_NUM_THREADS"), "1")
        with (folder / "log").open("w") as log:
            server = subprocess.Popen(
                [*command, "--data-dir", str(folder / "data")], stdout=log, stderr=log, env=os.environ | threads
            )
        try:
            deadline_s = time.monotonic() + 90.0
            while "serving: " not in (folder / "log").read_text():
                if server.poll() is not None or time.monotonic() > deadline_s:
                    raise RuntimeError((folder / "log").read_text())
                time.sleep(0.1)
            found, satellites = asyncio.run(asyncio.wait_for(_latencies(*ports, base, rover), 300.0))
        finally:
            server.terminate()
            server.wait(60.0)
    milliseconds = 1e3 * np.array(found)
    job = f"latency, last byte of an epoch → solution on the bus, RTK, {satellites} satellites, two frequencies"
    return [
        time_row(f"{job}, {words}", "asked (rtkrcv: 17)", float(value), ASKED_MS, "ms", target=1.0)
        for words, value in (("median", np.median(milliseconds)), ("95 %", np.percentile(milliseconds, 95)))
    ]


if __name__ == "__main__":
    print(format_rows(run()))
