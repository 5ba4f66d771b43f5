"""Two receivers pushed by RTKLIB's str2str into a server. Oracles: the recordings' own seconds and 1006 positions.

str2str reads a file without time tags at once and drops what it reads before its connection stands, so each recording
is first sent to a str2str that writes it down with time tags, as it would a receiver's stream.
"""

import math
import shutil
import signal
import socket
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from datetime import UTC, datetime
from pathlib import Path

import httpx
import numpy as np
import pytest

from plumbline.gnss.earth_frames import ecef_from_geodetic
from plumbline.gps_time import NS_PER_S, gps_ns_from_utc
from plumbline.rtcm3 import Message, Observations, decode, scan_frames

STR2STR = shutil.which("str2str")
pytestmark = [
    pytest.mark.realdata,
    pytest.mark.timeout(120),
    pytest.mark.skipif(STR2STR is None, reason="no str2str (Debian's rtklib) on this machine"),
]
SPEED = 300
NAMES = ("STR17", "STR24")
NEAR = gps_ns_from_utc(datetime(2018, 7, 15, tzinfo=UTC))
CONFIG = """
http_host = "127.0.0.1"
http_port = 0
ingest_host = "127.0.0.1"
ingest_port = 0
workers = 1
"""
STATION = """
[[stations]]
station = "{name}"
mode = "ppp"
device = {{ port = {port} }}
"""


def free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as listener:
        return int(listener.getsockname()[1])


@contextmanager
def str2str(source: str, target: str) -> Iterator[subprocess.Popen[bytes]]:
    """A str2str process, ended as its manual asks."""
    assert STR2STR is not None
    command = [STR2STR, "-in", source, "-out", target]
    process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    try:
        yield process
    finally:
        process.send_signal(signal.SIGINT)
        try:
            process.wait(10)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def wait_for(done: Callable[[], bool], timeout_s: float) -> bool:
    deadline = time.monotonic() + timeout_s
    while not done():
        if time.monotonic() > deadline:
            return False
        time.sleep(0.05)
    return True


def tagged_copy(recording: Path, folder: Path) -> Path:
    """The recording as str2str writes it down when it comes at ``SPEED`` times its pace."""
    copy, port = folder / recording.name, free_port()
    command = [Path(sys.executable).with_name("plumbline-dtu"), "replay", recording, "--server", f"127.0.0.1:{port}"]
    command += ["--speed", str(SPEED), "--registration", "", "--give-up", "20"]
    with str2str(f"tcpsvr://127.0.0.1:{port}", f"file://{copy}::T"):
        subprocess.run(command, check=True, capture_output=True, timeout=60)
        assert wait_for(lambda: copy.exists() and copy.stat().st_size == recording.stat().st_size, 10.0)
    assert copy.read_bytes() == recording.read_bytes()
    return copy


@pytest.fixture(scope="module")
def recordings(data_dir: Path) -> dict[str, Path]:
    return {name: data_dir / "str-2018-195" / f"week-rollover-{name}.rtcm3" for name in NAMES}


@pytest.fixture(scope="module")
def tagged(recordings: dict[str, Path], tmp_path_factory: pytest.TempPathFactory) -> dict[str, Path]:
    folder = tmp_path_factory.mktemp("tagged")
    with ThreadPoolExecutor(len(NAMES)) as pool:
        copies = pool.map(lambda recording: tagged_copy(recording, folder), recordings.values())
        return dict(zip(recordings, copies, strict=True))


def facts_of(recording: Path) -> tuple[set[int], np.ndarray]:
    """The whole seconds (GPS) that a recording has GPS or Galileo observations of, and its 1006 position, m."""
    seconds, position = set[int](), np.zeros(3)
    for frame in scan_frames(recording.read_bytes()).frames:
        message = decode(frame.payload)
        if isinstance(message, Observations) and message.system.letter in "GE" and message.n_rows:
            seconds.add(message.t_gps_ns(NEAR) // NS_PER_S)
        elif isinstance(message, Message) and message.number == 1006:
            position = np.array([message.fields[f"{axis}_ecef_m"] for axis in "xyz"])
    return seconds, position


def solutions(http: str, name: str) -> list[dict]:
    items, cursor = [], {}
    while True:
        page = httpx.get(f"{http}/v1/stations/{name}/solutions", params={"limit": 1000, **cursor}).json()
        items += page["items"]
        if page["next"] is None:
            return items
        cursor = {"cursor": page["next"]}


def gps_second(item: dict) -> int:
    return gps_ns_from_utc(datetime.fromisoformat(item["time"])) // NS_PER_S


def ecef_m(item: dict) -> np.ndarray:
    latitude_rad, longitude_rad = math.radians(item["latitude_deg"]), math.radians(item["longitude_deg"])
    return np.array(ecef_from_geodetic(latitude_rad, longitude_rad, item["height_m"]))


def test_two_receivers_become_two_stations(
    serve: Callable, recordings: dict[str, Path], tagged: dict[str, Path]
) -> None:
    """Every second is there, the week's crossing and the broken BeiDou epoch included, near the receiver's position."""
    ports = {name: free_port() for name in NAMES}
    server = serve(CONFIG + "".join(STATION.format(name=name, port=port) for name, port in ports.items()))
    server.wait_for(lambda: httpx.get(f"{server.http}/readyz").status_code == 200)
    facts = {name: facts_of(path) for name, path in recordings.items()}
    pushes = [(f"file://{tagged[name]}::T", f"tcpcli://127.0.0.1:{ports[name]}") for name in NAMES]
    with str2str(*pushes[0]), str2str(*pushes[1]):
        server.wait_for(lambda: all(len(solutions(server.http, n)) >= len(facts[n][0]) for n in NAMES), 40.0)
    medians = {}
    for name, (seconds, own) in facts.items():
        rows = solutions(server.http, name)
        assert [gps_second(row) for row in rows] == sorted(seconds)
        positions = np.array([ecef_m(row) for row in rows if row["latitude_deg"] is not None])
        assert len(positions) > 0.9 * len(rows)
        medians[name] = np.median(positions, axis=0)
        assert np.abs(positions - medians[name]).max() < 30.0
        assert np.linalg.norm(medians[name] - own) < 5.0
    apart = medians["STR17"] - medians["STR24"]
    assert np.linalg.norm(apart - (facts["STR17"][1] - facts["STR24"][1])) < 2.0
    assert server.stop() == 0
    assert "Traceback" not in server.log, server.log
