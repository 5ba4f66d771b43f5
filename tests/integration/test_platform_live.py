"""A platform with three antennas and an IMU through the real parts: TCP, archive, bus, worker, SQLite, REST.

Oracles: `plumbline process` on the archived bytes, the archive through the pipelines once more in one undisturbed go
(equal to the bit, although the worker was killed in between), and the simulator's truth.
"""

import asyncio
import csv
import os
import signal
from collections.abc import Callable
from datetime import datetime
from itertools import groupby
from pathlib import Path

import httpx
import numpy as np
import pytest

from plumbline import cli
from plumbline.archive import Archive
from plumbline.bus.messages import StationConfig
from plumbline.epochs.recording import Piece, merge, read_recording
from plumbline.evaluation import shake_table_files as files
from plumbline.gps_time import gps_ns_from_utc
from plumbline.offline_imu_options import SHEETS
from plumbline.records import Motion, Output, Solution
from plumbline.store import Store
from plumbline.worker.replay import replay_archive
from plumbline_dtu.shake_table.experiment import HEADING_DEG, PITCH_DEG, ROLL_DEG

pytestmark = [pytest.mark.slow, pytest.mark.timeout(240)]
SPEED = 4.0
T_NEAR_NS = 1_383_904_800 * 10**9
DELAYS_MS = {"base": 5, "antenna1": 20, "antenna2": 26, "antenna3": 23, "imu": 260}


def config(folder: Path) -> str:
    """The station's settings as an operator writes them."""
    description = files.read_description(folder)
    sheet = "".join(f"{name} = {value!r}\n" for name, value in SHEETS["atlans-c"].items())
    arms = [list(arm) for arm in description["lever_arms_body_m"]]
    return f"""
http_host = "127.0.0.1"
http_port = 0
ingest_host = "127.0.0.1"
ingest_port = 0
checkpoint_interval_s = 1.0
workers = 1

[[stations]]
station = "platform"
mode = "rtk-imu-tight"
device = {{ registrations = ["platform!"], rtcm_station_ids = [1, 2, 3] }}
reference_position_ecef_m = {list(description["platform_ecef_m"])}
positioning = {{ systems = "GC", elevation_mask_deg = 10.0 }}
rtk = {{ base_stream = "base", frequencies = 1, phase_sigma_m = 0.003, base_wait_s = 10.0 }}
[stations.inertial]
lever_arms_body_m = {arms}
{sheet}
[[stations]]
station = "base"
mode = "corrections"
device = {{ registrations = ["base!"] }}
"""


def pieces(folder: Path) -> list[Piece]:
    """What leaves the two devices, in order: the platform's DTU sends its three receivers' frames and the IMU's."""
    parts = []
    for name, delay_ms in DELAYS_MS.items():
        station = "base" if name == "base" else "platform"
        recording = read_recording(folder / f"{name}.rtcm3", name, t_near_ns=T_NEAR_NS)
        parts.append([Piece(p.t_ns + delay_ms * 10**6, station, p.data) for p in recording])
    return merge(parts)


async def play(folder: Path, device: type, port: int, kill: Callable[[], None]) -> None:
    """Both devices at ``SPEED``, as DTUs send; ``kill`` is called in the middle."""
    whole, loop = pieces(folder), asyncio.get_running_loop()
    async with device(port, b"base!") as base, device(port, b"platform!") as platform:
        start_s, killed = loop.time(), False
        for t_ns, together in groupby(whole, key=lambda piece: piece.t_ns):
            due_s = start_s + (t_ns - whole[0].t_ns) * 1e-9 / SPEED
            await asyncio.sleep(max(0.0, due_s - loop.time()))
            if not killed and t_ns - whole[0].t_ns > 12 * 10**9:
                kill()
                killed = True
            for piece in together:
                await (base if piece.stream == "base" else platform).send(piece.data, pause_s=0.0)


async def stored(data_dir: Path) -> tuple[list[Solution], list[Motion], list[StationConfig]]:
    store = await Store.open(f"sqlite:///{data_dir / 'plumbline.sqlite'}")
    configs = [
        StationConfig(row.settings.station, row.settings, (), row.created_gps_ns, row.changed_gps_ns)
        for row in await store.stations()
    ]
    page = await store.solutions("platform", limit=5000)
    blocks = await store.motion_blocks("platform")
    await store.close()
    return list(page.items), list(blocks), configs


def replayed(data_dir: Path, configs: list[StationConfig]) -> tuple[dict[int, Solution], dict[int, Motion]]:
    outputs: list[Output] = list(replay_archive(Archive(data_dir / "archive", writable=False), configs))
    solutions = {o.t_gps_ns: o for o in outputs if isinstance(o, Solution)}
    return solutions, {o.t_first_gps_ns: o for o in outputs if isinstance(o, Motion)}


def processed(folder: Path, data_dir: Path, output: Path) -> list[dict[str, str]]:
    """Rows of `plumbline process` on the archive's bytes of both streams."""
    description = files.read_description(folder)
    names = {}
    for station in ("platform", "base"):
        names[station] = output.with_name(f"{station}.rtcm3")
        names[station].write_bytes(
            b"".join(p.read_bytes() for p in sorted((data_dir / "archive").glob(f"**/{station}/**/*.rtcm3")))
        )

    def vector(values: object) -> str:
        return ",".join(repr(float(v)) for v in np.asarray(values))

    arms = ";".join(vector(arm) for arm in description["lever_arms_body_m"])
    arguments = ["process", "--mode", "rtk-imu-tight", "--rover", str(names["platform"]), "--station-ids", "1,2,3",
                 "--base", str(names["base"]), f"--reference={vector(description['platform_ecef_m'])}",
                 "--systems", "GC", "--elevation-mask", "10", "--frequencies", "1", "--phase-sigma", "0.003",
                 f"--lever-arms={arms}", "--imu-characteristics", "atlans-c", "--output", str(output)]  # fmt: skip
    assert cli.main(arguments) == 0
    with output.open(newline="", encoding="utf-8") as stream:
        return list(csv.DictReader(stream))


def test_platform_live(serve: Callable, device: type, shaken_platform: Path, tmp_path: Path) -> None:
    server = serve(config(shaken_platform))
    solutions_url = f"{server.http}/v1/stations/platform/solutions?limit=1000"

    def kill() -> None:
        os.kill(server.children()[0], signal.SIGKILL)

    asyncio.run(play(shaken_platform, device, server.ingest_port, kill))

    def all_there() -> bool:
        items = httpx.get(solutions_url, timeout=60.0).json()["items"]
        return len(items) == 400 and items[-1]["status"] == "rtk_fixed"

    server.wait_for(all_there)
    items = httpx.get(solutions_url, timeout=60.0).json()["items"]
    late = items[-100:]
    assert all(item["status"] == "rtk_fixed" for item in late)
    angles = np.array([[item[f"{name}_deg"] for name in ("roll", "pitch", "heading")] for item in late])
    assert (np.abs(angles.mean(axis=0) - [ROLL_DEG, PITCH_DEG, HEADING_DEG]) < [0.1, 0.1, 0.2]).all()
    motion = httpx.get(
        f"{server.http}/v1/stations/platform/motion?resolution=samples&max_points=5000", timeout=60.0
    ).json()
    assert len(motion["heading_deg"]) > 2000
    assert server.stop() == 0, server.log
    assert server.log.count("ended with -9") == 1

    found, blocks, configs = asyncio.run(stored(server.data_dir))
    expected, expected_blocks = replayed(server.data_dir, configs)
    pairs = list(zip(map(row, found), (row(expected[t]) for t in sorted(expected)), strict=True))
    different = [(a, b) for a, b in pairs if a != b]
    assert not different, f"{len(different)} rows differ, first {different[0]}"
    assert [(b.t_first_gps_ns, b.revision, b.status, len(b.displacement_enu_m)) for b in blocks] == [
        (b.t_first_gps_ns, b.revision, b.status, len(b.displacement_enu_m))
        for b in (expected_blocks[t] for t in sorted(expected_blocks))
    ]
    for block in blocks:
        wanted = expected_blocks[block.t_first_gps_ns]
        assert np.abs(block.displacement_enu_m - wanted.displacement_enu_m).max() <= 0.5e-5 * (1 + 1e-6)

    rows = processed(shaken_platform, server.data_dir, tmp_path / "process.csv")
    assert len(rows) == len(items)
    for item, of_process in zip(items, rows, strict=True):
        assert item["status"] == of_process["status"]
        t_s = gps_ns_from_utc(datetime.fromisoformat(item["time"])) * 1e-9
        assert abs(t_s - float(of_process["t_gps_s"])) < 1e-3
        if of_process["e_m"]:
            live = [item["east_mm"], item["north_mm"], item["up_mm"]]
            assert (
                np.abs(np.array(live) - 1e3 * np.array([float(of_process[k]) for k in ("e_m", "n_m", "u_m")])).max()
                < 0.02
            )


def row(solution: Solution) -> tuple[object, ...]:
    """A solution as plain values, for an exact comparison."""
    arrays = (solution.position_ecef_m, solution.displacement_enu_m, solution.velocity_enu_m_s, solution.attitude_rad)
    plain = tuple(None if a is None else tuple(np.asarray(a).tolist()) for a in arrays)
    return (solution.t_gps_ns, solution.t_receive_ns, solution.status, solution.reason, solution.n_satellites, *plain)
