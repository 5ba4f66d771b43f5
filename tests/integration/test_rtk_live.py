"""Two receivers' recordings through the real server in real-time order: modes rtk, rtk-network and a moving base.

Oracles: what is asked (fixes, first fix, scatter), and the batch integers: a wrong one would be off the fixes' median
by half a cycle, nine centimetres.
"""

import asyncio
import time
from collections.abc import Callable
from itertools import groupby
from pathlib import Path
from typing import Any

import httpx
import numpy as np
import pytest

from plumbline.epochs.recording import Piece, merge, read_recording

pytestmark = [pytest.mark.realdata, pytest.mark.slow, pytest.mark.timeout(300)]
SPEED = 60.0
QUIET_S = 5.0
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
mode = "{mode}"
device = {{ registrations = ["{name}!"] }}
positioning = {{ systems = "GREJC", elevation_mask_deg = 10.0 }}
rtk = {{ base_stream = "base", base_streams = ["base"], base_wait_s = 10.0, moving_base = {moving} }}
"""
STREAM = """
[[stations]]
station = "{name}"
mode = "corrections"
device = {{ registrations = ["{name}!"] }}
"""
ROVERS = {"rover": ("rtk", "false"), "network": ("rtk-network", "false"), "moving": ("rtk", "true")}
NO_SOLUTION_POSSIBLE = ("no_base", "no_ephemeris", "no_observations")


async def play(device: type, port: int, whole: list[Piece], rovers: list[str]) -> None:
    """Every stream at ``SPEED``, in the order of its times; the rover's goes to each of the stations."""
    streams = [*rovers, *sorted({piece.stream for piece in whole} - {"rover"})]
    devices: dict[str, Any] = {name: device(port, f"{name}!".encode()) for name in streams}
    for one in devices.values():
        await one.__aenter__()
    loop = asyncio.get_running_loop()
    start_s = loop.time()
    for t_ns, together in groupby(whole, key=lambda piece: piece.t_ns):
        due_s = start_s + (t_ns - whole[0].t_ns) * 1e-9 / SPEED
        await asyncio.sleep(max(0.0, due_s - loop.time()))
        for piece in together:
            for name in rovers if piece.stream == "rover" else (piece.stream,):
                await devices[name].send(piece.data, pause_s=0.0)
    for one in devices.values():
        await one.__aexit__()


def solutions(http: str, station: str) -> list[dict[str, Any]]:
    """All stored solutions."""
    items: list[dict[str, Any]] = []
    cursor = None
    while True:
        parameters = {"limit": 1000} | ({"cursor": cursor} if cursor else {})
        page = httpx.get(f"{http}/v1/stations/{station}/solutions", params=parameters, timeout=60.0).json()
        items += page["items"]
        cursor = page["next"]
        if cursor is None:
            return items


def fixed_of(items: list[dict[str, Any]], least: float) -> list[dict[str, Any]]:
    """The fixed epochs, which are at least such a share of those that could be positioned."""
    possible = [item for item in items if item["status"] not in NO_SOLUTION_POSSIBLE]
    assert len(possible) > 0.95 * len(items)
    fixed = [item for item in possible if item["status"] == "rtk_fixed"]
    assert len(fixed) >= least * len(possible), f"{len(fixed)} of {len(possible)}"
    assert possible.index(fixed[0]) <= 10  # at 1 Hz
    assert all(item["reason"] for item in items if item["status"] != "rtk_fixed")
    return fixed


def assert_still(values_mm: np.ndarray) -> None:
    """Scatter within 2, 2, 5 mm, and no wrong integer."""
    off = values_mm - np.median(values_mm, axis=0)
    print("fixed", len(off), "scatter, mm:", off.std(axis=0).round(2), "largest:", np.abs(off).max().round(1))
    assert (off.std(axis=0) <= [2.0, 2.0, 5.0]).all()
    assert np.abs(off).max() < 25.0


STR = {"base": "week-rollover-STR24.rtcm3", "rover": "week-rollover-STR17.rtcm3"}
SC134 = {"nav": "SSRTEST_20260206_CORR.bin", "base": "ROMAMSG.bin", "rover": "ROVRMSG.bin"}
STR_NS, SC134_NS = 1_215_648_000 * 10**9, 1_454_443_200 * 10**9


@pytest.mark.parametrize(
    ("folder", "files", "t_near_ns", "rovers", "least", "length_s"),
    [
        pytest.param("str-2018-195", STR, STR_NS, ["rover"], 0.995, 720, id="str across the week"),
        pytest.param(
            "str-2018-195", STR, STR_NS, ["rover", "network", "moving"], 0.995, 7200, id="str", marks=pytest.mark.soak
        ),
        pytest.param("sc134-2026-037", SC134, SC134_NS, ["rover"], 0.99, 7200, id="sc134", marks=pytest.mark.soak),
    ],
)
def test_fixed_live(
    serve: Callable, device: type, data_dir: Path, folder: str, files: dict[str, str], t_near_ns: int,
    rovers: list[str], least: float, length_s: int,
) -> None:  # fmt: skip
    config = CONFIG + "".join(STREAM.format(name=name) for name in files if name != "rover")
    config += "".join(STATION.format(name=name, mode=ROVERS[name][0], moving=ROVERS[name][1]) for name in rovers)
    server = serve(config)
    whole = merge([read_recording(data_dir / folder / file, name, t_near_ns=t_near_ns) for name, file in files.items()])
    whole = [piece for piece in whole if piece.t_ns < whole[0].t_ns + length_s * 10**9]
    asyncio.run(play(device, server.ingest_port, whole, rovers))
    seen = {"epochs": 0, "since": time.monotonic()}

    def settled() -> bool:
        """Whether nothing has been added for a while."""
        epochs = sum(len(solutions(server.http, name)) for name in rovers)
        if epochs != seen["epochs"]:
            seen.update(epochs=epochs, since=time.monotonic())
        return epochs > 500 and time.monotonic() - seen["since"] > QUIET_S

    server.wait_for(settled, 200.0)
    for name in rovers:
        fixed = fixed_of(solutions(server.http, name), least)
        if name == "network":
            assert_still(np.array([[item[f"{axis}_mm"] for axis in ("east", "north", "up")] for item in fixed]))
        else:  # a base that moves, or has never told where it is, moves the position and not the baseline
            assert_still(1e3 * np.array([[item["extras"][f"baseline_{axis}_m"] for axis in "enu"] for item in fixed]))
    assert server.stop() == 0, server.log
