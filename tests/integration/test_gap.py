"""A station that falls silent, and a server that goes down: both leave rows with their reasons.

Oracle: the simulation's own times of sending, and the test's own of ending the server.
"""

import subprocess
import sys
import time
from collections.abc import Callable
from datetime import datetime

import httpx
import pytest

CONFIG = """
http_host = "127.0.0.1"
http_port = 0
ingest_host = "127.0.0.1"
ingest_port = 0
workers = 1

[[stations]]
station = "dam"
mode = "ppp"
"""

pytestmark = [pytest.mark.slow, pytest.mark.timeout(295)]


def send(port: int, seconds: int) -> None:
    command = [sys.executable, "-m", "plumbline_dtu.cli", "simulate", "--server", f"127.0.0.1:{port}"]
    command += ["--station", "dam", "--registration", "{name},\r\n", "--corrections", "", "--accelerometer", "none"]
    subprocess.run([*command, "--duration", str(seconds)], check=True, timeout=100)


def today(http: str) -> list[dict]:
    return httpx.get(f"{http}/v1/stations/dam/availability").json()


def test_every_missing_epoch_has_a_reason(serve: Callable) -> None:
    server = serve(CONFIG)
    send(server.ingest_port, 8)
    time.sleep(5.0)
    send(server.ingest_port, 8)
    server.wait_for(lambda: bool(today(server.http)) and today(server.http)[-1]["received"] >= 8, 90.0)
    assert server.stop() == 0
    stopped = time.time()
    time.sleep(8.0)
    started = time.time()
    server = serve(CONFIG)
    send(server.ingest_port, 8)
    server.wait_for(lambda: today(server.http)[-1]["received"] >= 14, 90.0)
    (day, *_) = today(server.http)
    assert sum(day["loss"].values()) + day["converged"] == day["expected"]
    down = [gap for gap in day["gaps"] if gap["reason"] == "the server was down"]
    silent = [gap for gap in day["gaps"] if gap["reason"] == "no observations received"]
    (gap,) = down
    begin, end = (datetime.fromisoformat(gap[name]).timestamp() for name in ("start", "end"))
    assert begin < stopped + 1.0
    assert end > started - 1.0
    assert any(4 <= gap["epochs"] <= 60 for gap in silent)
    time.sleep(7.0)
    (last, *_) = reversed(today(server.http)[-1]["gaps"])
    assert last["reason"] == "no observations received"  # it shows while it lasts
    assert server.stop() == 0
