"""A data alert through the real parts: devices, TCP, archive, workers, database, REST.

Oracle: the simulation's own word on what moves: in one run the receiver of one station of two, in the other both.
"""

import subprocess
import sys
from collections.abc import Callable

import httpx
import pytest

from plumbline_dtu.simulate_cli import marker_ecef_m

JUMP_S, END_S, SPEED = 100, 160, 5
CONFIG = """
http_host = "127.0.0.1"
http_port = 0
ingest_host = "127.0.0.1"
ingest_port = 0
workers = 2

[[stations]]
station = "corrections"
mode = "corrections"

[[stations]]
station = "base"
mode = "corrections"
"""
ROVER = """
[[stations]]
station = "{name}"
mode = "rtk"
reference_position_ecef_m = {place}
neighbours = ["{other}"]
positioning = {{ systems = "GEC" }}
rtk = {{ base_stream = "base" }}

[[thresholds]]
threshold_id = "{name}-level"
station = "{name}"
quantity = "displacement_horizontal"
level = 0.02
dead_band = 0.005
"""
PLACES = {"base": (48.0, 11.0, 500.0), "left": (48.0, 11.0005, 500.0), "right": (48.0, 11.0009, 500.0)}
ERRORS = ["--code-noise", "0.1", "--phase-noise", "0.0006", "--code-multipath", "0.1", "--phase-multipath", "0.0008"]

pytestmark = [pytest.mark.slow, pytest.mark.timeout(280)]


def simulate(port: int, moves: dict[str, str], shows: dict[str, str]) -> None:
    """`plumbline-dtu simulate` with what moves, and what one receiver shows alone."""
    command = [sys.executable, "-m", "plumbline_dtu.cli", "simulate", "--server", f"127.0.0.1:{port}"]
    for name, (latitude, longitude, height) in PLACES.items():
        motion = f"={moves[name]}" if name in moves else ""
        command += ["--station", f"{name}@{latitude},{longitude},{height}{motion}"]
    for name, motion in shows.items():
        command += ["--receiver-motion", f"{name}={motion}"]
    command += ["--registration", "{name},\r\n", "--accelerometer", "none", *ERRORS]
    subprocess.run([*command, "--speed", str(SPEED), "--duration", str(END_S)], check=True, timeout=200)


def alerts(http: str) -> dict[str, tuple[str, str, str]]:
    """(station, kind, state) by threshold, with the text."""
    items = httpx.get(f"{http}/v1/alerts").json()["items"]
    return {item["threshold_id"]: (item["station"], item["kind"], item["text"]) for item in items}


def started(serve: Callable) -> object:
    rovers = [
        ROVER.format(name=name, other=other, place=list(marker_ecef_m(*PLACES[name])))
        for name, other in (("left", "right"), ("right", "left"))
    ]
    return serve(CONFIG + "".join(rovers))


def test_one_receiver_jumps(serve: Callable) -> None:
    server = started(serve)
    simulate(server.ingest_port, {}, {"left": f"step:0.03,0,0@{JUMP_S}"})
    server.wait_for(lambda: alerts(server.http) != {}, 30.0)
    (found,) = alerts(server.http).items()
    assert found[0] == "data-neighbour"
    assert found[1][:2] == ("left", "data")
    assert "only this antenna shows" in found[1][2]
    assert "right does not" in found[1][2]
    solutions = httpx.get(f"{server.http}/v1/stations/left/solutions", params={"limit": 1000}).json()["items"]
    doubtful = [s["reason"] for s in solutions if "doubtful" in s["reason"]]
    assert len(doubtful) > (END_S - JUMP_S) // 2
    assert server.stop() == 0


def test_both_move(serve: Callable) -> None:
    server = started(serve)
    step = f"step:0.03,0,0@{JUMP_S}"
    simulate(server.ingest_port, {"left": step, "right": step}, {})
    server.wait_for(lambda: len(alerts(server.http)) >= 2, 30.0)
    assert {name: found[:2] for name, found in alerts(server.http).items()} == {
        "left-level": ("left", "motion"),
        "right-level": ("right", "motion"),
    }
    assert server.stop() == 0
