"""``plumbline-dtu demo``: a server with three simulated stations on a bridge, one of which shakes.

Everything is the real thing but the sky: ``plumbline serve`` runs as its own process, the stations push over TCP as
DTUs do. The middle of the main span sways in bursts, 25 mm at 0.3 Hz; its acceleration, the sensor's own, crosses a
threshold within the first burst, its velocity once the position filter has settled (a quarter of an hour).
"""

import argparse
import asyncio
import contextlib
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path

from plumbline.errors import PlumblineError
from plumbline.gps_time import WEEK_NS, gps_ns_from_unix_ns
from plumbline_dtu.device import DeviceOptions
from plumbline_dtu.simulate_cli import marker_ecef_m
from plumbline_dtu.simulation.accelerometer import sca3300
from plumbline_dtu.simulation.constellation import Constellation
from plumbline_dtu.simulation.live import Scenario, run_live
from plumbline_dtu.simulation.motion import Motion, Sine, bursts, static
from plumbline_dtu.simulation.station import Errors, StationPlan

TOKEN = "demo"
CORRECTIONS = "corrections"
SHAKING = "main-span"
_STATIONS = (("west-pylon", 12.8260), (SHAKING, 12.8283), ("east-pylon", 12.8306))
_LATITUDE_DEG, _HEIGHT_M = 55.5765, 57.0
_RATE_HZ = 100
_ERRORS = Errors(code_m=0.05, phase_m=0.001, code_multipath_m=0.01, phase_multipath_m=0.0008)  # an open sky
_SWAY = bursts(Sine(1, 0.025, 0.3), every_s=30.0, lasting_s=20.0)
_START_DEADLINE_S = 60.0
_HEARTBEAT = b"$DTU,alive\r\n"
_DEVICE_TOML = rf'device = {{ token = "{TOKEN}", heartbeat = "$DTU,alive\\x0d\\x0a" }}'


@dataclass(frozen=True, slots=True)
class Ports:
    """Where the server listens."""

    http: int
    ingest: int


def plans() -> list[StationPlan]:
    """The three stations."""
    return [_plan(name, longitude, k) for k, (name, longitude) in enumerate(_STATIONS)]


def _plan(name: str, longitude_deg: float, index: int) -> StationPlan:
    motion: Motion = _SWAY if name == SHAKING else static()
    return StationPlan(
        name=name,
        marker_ecef_m=marker_ecef_m(_LATITUDE_DEG, longitude_deg, _HEIGHT_M),
        motion=motion,
        errors=_ERRORS,
        accelerometer=sca3300(_RATE_HZ, index + 1),
        accelerometer_rate_hz=_RATE_HZ,
        station_id=index + 1,
        seed=index + 1,
    )


def settings_toml(data_dir: Path, ports: Ports) -> str:
    """The server's seeding file."""
    lines = [
        f'data_dir = "{data_dir.as_posix()}"',
        'http_host = "127.0.0.1"',
        'ingest_host = "127.0.0.1"',
        f"http_port = {ports.http}",
        f"ingest_port = {ports.ingest}",
        "",
        "[[stations]]",
        f'station = "{CORRECTIONS}"',
        'name = "Simulated corrections"',
        'mode = "corrections"',
        _DEVICE_TOML,
    ]
    for plan in plans():
        lines += ["", *_station_toml(plan)]
    for quantity, level in (("acceleration_horizontal", 0.06), ("velocity_north", 0.035)):
        lines += [
            "",
            "[[thresholds]]",
            f'threshold_id = "{SHAKING}-{quantity}"',
            f'station = "{SHAKING}"',
            f'quantity = "{quantity}"',
            f"level = {level}",
            f"dead_band = {level / 3:.4f}",
            "off_delay_s = 5.0",
        ]
    return "\n".join(lines) + "\n"


def _station_toml(plan: StationPlan) -> list[str]:
    x, y, z = plan.marker_ecef_m
    assert plan.accelerometer is not None
    rotation = [list(row) for row in plan.accelerometer.rotation_enu_from_sensor]
    return [
        "[[stations]]",
        f'station = "{plan.name}"',
        f'name = "{plan.name.replace("-", " ").capitalize()}"',
        'mode = "ppp-accel"',
        f"reference_position_ecef_m = [{x:.4f}, {y:.4f}, {z:.4f}]",
        'reference_frame = "simulated"',
        _DEVICE_TOML,
        'positioning = { systems = "GEC", code_sigma_m = 0.06, phase_sigma_m = 0.002, converged_sigma_m = 0.08 }',
        f"fusion = {{ rotation_enu_from_sensor = {rotation} }}",
    ]


def add_demo(parser: argparse.ArgumentParser) -> None:
    """Describe the command."""
    parser.description = __doc__
    parser.add_argument("--http-port", type=int, default=8000, help="0: a free one")
    parser.add_argument("--ingest-port", type=int, default=9000, help="0: a free one")
    parser.add_argument("--data-dir", type=Path, help="default: a temporary one, removed at the end")
    parser.add_argument("--duration", type=float, metavar="S", help="default: until interrupted")
    parser.set_defaults(run=_demo)


def _demo(parsed: argparse.Namespace) -> int:
    ports = Ports(_free_port(parsed.http_port), _free_port(parsed.ingest_port))
    with contextlib.ExitStack() as stack:
        folder = parsed.data_dir
        if folder is None:
            folder = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="plumbline-demo-")))
        folder.mkdir(parents=True, exist_ok=True)
        config = folder / "demo.toml"
        config.write_text(settings_toml(folder / "data", ports), encoding="utf-8")
        server = stack.enter_context(_server(config))
        _wait_for_server(server, ports)
        print(f"plumbline demo: http://127.0.0.1:{ports.http}/  (Ctrl-C ends it)", flush=True)
        options = DeviceOptions("127.0.0.1", ports.ingest, f"{{name}},{TOKEN}\r\n".encode(), _HEARTBEAT)
        reference_ns = gps_ns_from_unix_ns(time.time_ns()) // WEEK_NS * WEEK_NS
        scenario = Scenario(plans(), Constellation(reference_ns), CORRECTIONS, correction_interval_s=2)
        with contextlib.suppress(KeyboardInterrupt):
            asyncio.run(_run(scenario, options, parsed.duration, server))
    return 0


async def _run(
    scenario: Scenario, options: DeviceOptions, duration_s: float | None, server: "subprocess.Popen[bytes]"
) -> None:
    """Simulate until the time is over, a signal comes, or the server ends."""
    simulation = asyncio.create_task(run_live(scenario, options, duration_s))
    for number in (signal.SIGTERM, signal.SIGINT):
        asyncio.get_running_loop().add_signal_handler(number, simulation.cancel)
    while not simulation.done() and server.poll() is None:
        await asyncio.wait({simulation}, timeout=0.5)
    if server.poll() is not None:
        simulation.cancel()
        raise PlumblineError(f"the server ended with code {server.returncode}")
    with contextlib.suppress(asyncio.CancelledError):
        await simulation


@contextlib.contextmanager
def _server(config: Path):  # type: ignore[no-untyped-def]
    """``plumbline serve`` as a process that ends with the block, orderly."""
    environment = {**os.environ, "NUMBA_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    command = [sys.executable, "-m", "plumbline.cli", "serve", "--config", str(config)]
    process = subprocess.Popen(command, env=environment)
    try:
        yield process
    finally:
        if process.poll() is None:
            process.terminate()
        try:
            process.wait(20.0)
        except subprocess.TimeoutExpired:
            process.kill()
            process.wait()


def _wait_for_server(server: "subprocess.Popen[bytes]", ports: Ports) -> None:
    deadline = time.monotonic() + _START_DEADLINE_S
    while True:
        if server.poll() is not None:
            raise PlumblineError(f"the server ended with code {server.returncode}")
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", ports.http), timeout=1.0):
            return
        if time.monotonic() > deadline:
            raise PlumblineError(f"the server does not listen on port {ports.http}")
        time.sleep(0.1)


def _free_port(port: int) -> int:
    if port:
        return port
    with socket.create_server(("127.0.0.1", 0)) as listener:
        return int(listener.getsockname()[1])
