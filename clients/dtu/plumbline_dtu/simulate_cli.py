"""The command ``plumbline-dtu simulate``."""

import argparse
import asyncio
import math
import sys
import time
from datetime import UTC, datetime
from pathlib import Path

from plumbline.errors import ConfigurationError
from plumbline.gnss.earth_frames import ecef_from_geodetic
from plumbline.gps_time import WEEK_NS, gps_ns_from_unix_ns, gps_ns_from_utc
from plumbline.rtcm3.ssr import UPDATE_INTERVALS_S
from plumbline_dtu.device import DeviceOptions, bytes_of, parse_address, tls_context
from plumbline_dtu.simulation.accelerometer import Accelerometer, sca3300, wang_2023
from plumbline_dtu.simulation.constellation import WALKERS, Constellation
from plumbline_dtu.simulation.live import Scenario, run_live, write_files
from plumbline_dtu.simulation.motion import Motion, parse_motion
from plumbline_dtu.simulation.station import Errors, StationPlan

_PLACE = (55.5700, 12.8500, 60.0)  # degrees, degrees, metres: a bridge over a sound
_SPACING_DEG = 0.002


def add_simulate(parser: argparse.ArgumentParser) -> None:
    """Describe the command."""
    parser.description = "Stations with a known motion, sent live to a server or written to files with their truth."
    target = parser.add_mutually_exclusive_group(required=True)
    target.add_argument("--server", metavar="HOST:PORT")
    target.add_argument("--out", type=Path, metavar="DIR")
    parser.add_argument(
        "--station",
        action="append",
        metavar="NAME[@LAT,LON,HEIGHT][=MOTION]",
        help="may be repeated; MOTION: static, sine:e,0.01,0.5, burst:n,0.025,0.3,40,20, step:0.02,0,0@60, file:PATH@9",
    )
    parser.add_argument(
        "--receiver-motion",
        action="append",
        default=[],
        metavar="NAME=MOTION",
        help="may be repeated: what the receiver of a station shows though nothing moves, neither in truth nor felt",
    )
    parser.add_argument("--registration", default="{name}\\r\\n", help="{name}: the stream's name")
    parser.add_argument("--corrections", default="corrections", metavar="NAME", help="'' for none")
    parser.add_argument("--correction-interval", type=int, default=5, choices=UPDATE_INTERVALS_S, metavar="S")
    parser.add_argument("--systems", default="GEC", help="of G, E, C")
    parser.add_argument("--rate", type=int, default=1, metavar="HZ", help="epochs a second")
    parser.add_argument("--accelerometer", choices=("none", "sca3300", "wang2023"), default="sca3300")
    parser.add_argument("--accelerometer-rate", type=int, default=100, metavar="HZ")
    parser.add_argument("--start", metavar="UTC", help="ISO 8601, with --out; default: now")
    parser.add_argument("--duration", type=float, metavar="S")
    parser.add_argument("--speed", type=float, default=1.0)
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--heartbeat", default="")
    parser.add_argument("--heartbeat-interval", type=float, default=30.0, metavar="S")
    parser.add_argument("--tls", action="store_true")
    parser.add_argument("--tls-ca", metavar="FILE")
    parser.add_argument("--tls-insecure", action="store_true")
    _add_errors(parser)
    parser.set_defaults(run=_simulate)


def _add_errors(parser: argparse.ArgumentParser) -> None:
    defaults = Errors()
    parser.add_argument("--code-noise", type=float, default=defaults.code_m, metavar="M")
    parser.add_argument("--phase-noise", type=float, default=defaults.phase_m, metavar="M")
    parser.add_argument("--code-multipath", type=float, default=defaults.code_multipath_m, metavar="M")
    parser.add_argument("--phase-multipath", type=float, default=defaults.phase_multipath_m, metavar="M")
    parser.add_argument("--no-ionosphere", action="store_true")
    parser.add_argument("--no-wet-delay", action="store_true")
    parser.add_argument("--slips-per-hour", type=float, default=0.0, help="of each signal")
    parser.add_argument("--lost-epochs", type=float, default=0.0, help="share of epochs that never arrive")


def _simulate(parsed: argparse.Namespace) -> int:
    if not set(parsed.systems) <= {system.letter for system in WALKERS}:
        raise ConfigurationError(f"--systems {parsed.systems}: simulated are G, E and C")
    start_ns = gps_ns_from_unix_ns(time.time_ns())
    if parsed.start:
        moment = datetime.fromisoformat(parsed.start)
        start_ns = gps_ns_from_utc(moment if moment.tzinfo else moment.replace(tzinfo=UTC))
    texts = parsed.station or ["station-1"]
    plans = [_plan(parsed, text, k, start_ns) for k, text in enumerate(texts)]
    unknown = {text.partition("=")[0] for text in parsed.receiver_motion} - {plan.name for plan in plans}
    if unknown:
        raise ConfigurationError(f"--receiver-motion: no station {', '.join(sorted(unknown))}")
    constellation = Constellation(start_ns // WEEK_NS * WEEK_NS, parsed.systems, parsed.seed)
    scenario = Scenario(plans, constellation, parsed.corrections or None, parsed.correction_interval)
    if parsed.out:
        if parsed.duration is None:
            raise ConfigurationError("--out wants a --duration")
        write_files(scenario, parsed.out, start_ns, parsed.duration)
        return 0
    counters = asyncio.run(run_live(scenario, _options(parsed), parsed.duration, parsed.speed))
    for name, c in counters.items():
        print(f"{name}: {c.sent_bytes} bytes in {c.connections} connections, {c.lost_bytes} lost", file=sys.stderr)
    return 0


def _options(parsed: argparse.Namespace) -> DeviceOptions:
    address = parse_address(parsed.server)
    return DeviceOptions(
        host=address.host,
        port=address.port,
        registration=bytes_of(parsed.registration),
        heartbeat=bytes_of(parsed.heartbeat),
        heartbeat_interval_s=parsed.heartbeat_interval,
        tls=tls_context(parsed.tls_ca, parsed.tls_insecure) if parsed.tls else None,
    )


def _plan(parsed: argparse.Namespace, text: str, index: int, start_ns: int) -> StationPlan:
    head, _, motion = text.partition("=")
    name, _, place = head.partition("@")
    latitude, longitude, height_m = _PLACE[0], _PLACE[1] + index * _SPACING_DEG, _PLACE[2]
    if place:
        try:
            latitude, longitude, height_m = (float(part) for part in place.split(","))
        except ValueError:
            raise ConfigurationError(f"--station {text!r}: {place!r} is no LAT,LON,HEIGHT") from None
    seed = parsed.seed * 1000 + index
    return StationPlan(
        name=name,
        marker_ecef_m=marker_ecef_m(latitude, longitude, height_m),
        motion=parse_motion(motion or "static", start_ns),
        antenna_motion=_receiver_motion(parsed.receiver_motion, name, start_ns),
        errors=Errors(
            parsed.code_noise,
            parsed.phase_noise,
            parsed.code_multipath,
            parsed.phase_multipath,
            not parsed.no_ionosphere,
            not parsed.no_wet_delay,
            slips_per_hour=parsed.slips_per_hour,
            lost_epochs=parsed.lost_epochs,
        ),
        epoch_rate_hz=parsed.rate,
        accelerometer=_sensor(parsed.accelerometer, parsed.accelerometer_rate, seed),
        accelerometer_rate_hz=parsed.accelerometer_rate,
        station_id=index + 1,
        seed=seed,
    )


def _receiver_motion(texts: list[str], name: str, start_ns: int) -> Motion:
    """What is shown by the receiver of a station alone."""
    named = dict(text.partition("=")[::2] for text in texts)
    return parse_motion(named.get(name, "static"), start_ns)


def _sensor(kind: str, rate_hz: int, seed: int) -> Accelerometer | None:
    if kind == "none":
        return None
    return wang_2023() if kind == "wang2023" else sca3300(rate_hz, seed)


def marker_ecef_m(latitude_deg: float, longitude_deg: float, height_m: float) -> tuple[float, float, float]:
    """Earth-fixed position of geodetic coordinates."""
    x, y, z = ecef_from_geodetic(math.radians(latitude_deg), math.radians(longitude_deg), height_m)
    return float(x), float(y), float(z)
