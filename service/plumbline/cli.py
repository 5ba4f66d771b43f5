"""The command line: serve, process, simulate, evaluate, inspect."""

import argparse
import re
import sys
import time
from collections.abc import Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import NoReturn

from tqdm import tqdm

from plumbline import __version__
from plumbline.config import AntennaMotion, Mode, StationSettings, read_server_settings
from plumbline.errors import PlumblineError
from plumbline.evaluation import command as evaluation
from plumbline.files.imu import FORMATS as IMU_FORMATS
from plumbline.gps_time import gps_ns_from_unix_ns
from plumbline.offline_imu_options import add_options as add_imu_options
from plumbline.offline_imu_options import further_antennas, inertial_settings, platform_settings

_NEGATIVE_VECTOR = re.compile(r"-[\d.]+(e-?\d+)?,")
ROLES = ("ingest", "worker", "store", "api")
PROCESS_MODES = ("ppp", "ppp-accel", "rtk", "rtk-network", "rtk-imu-loose", "rtk-imu-tight", "fuse")


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point of the command ``plumbline``; returns the exit code."""
    options = _parser().parse_args(_with_joined_vectors(sys.argv[1:] if arguments is None else arguments))
    try:
        code: int = options.run(options)
    except PlumblineError as error:
        print(f"plumbline: {error}", file=sys.stderr)
        return 2
    except FileNotFoundError as error:
        print(f"plumbline: no such file: {error.filename}", file=sys.stderr)
        return 2
    except BrokenPipeError:
        return 0
    return code


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="plumbline", description="Watches structures and slopes move.")
    parser.add_argument("--version", action="version", version=f"plumbline {__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    _add_serve(commands.add_parser("serve", help="run the server"))
    _add_process(commands.add_parser("process", help="run a station's pipeline over files"))
    simulate = commands.add_parser("simulate", help="make an experiment whose truth is known")
    evaluation.add_simulate(simulate, lambda arguments: main(["process", *arguments]))
    evaluation.add_evaluate(commands.add_parser("evaluate", help="compare results with the truth"))
    _add_characterise(commands.add_parser("characterise", help="an inertial sensor's noise, or how it is mounted"))
    inspect = commands.add_parser("inspect", help="say what is in RTCM3 files")
    inspect.add_argument("files", nargs="+", type=Path, metavar="FILE")
    inspect.add_argument("--json", action="store_true", help="one JSON object a file")
    inspect.set_defaults(run=_inspect)
    return parser


def _with_joined_vectors(arguments: Sequence[str]) -> list[str]:
    """``--reference -1,2,3`` as ``--reference=-1,2,3``: argparse takes a leading minus for an option."""
    joined: list[str] = []
    for argument in arguments:
        if joined and joined[-1].startswith("--") and "=" not in joined[-1] and _NEGATIVE_VECTOR.match(argument):
            joined[-1] += f"={argument}"
        else:
            joined.append(argument)
    return joined


def _add_serve(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--config", type=Path, metavar="FILE", help="a TOML file")
    parser.add_argument("--data-dir", type=Path, metavar="DIR")
    parser.add_argument("--http-port", type=int, metavar="PORT")
    parser.add_argument("--ingest-port", type=int, metavar="PORT")
    parser.add_argument("--workers", type=int, metavar="N", help="worker processes (default: cores − 1)")
    parser.add_argument("--role", action="append", choices=ROLES, help="run this role only; may be repeated")
    parser.set_defaults(run=_serve)


def _add_process(parser: argparse.ArgumentParser) -> None:
    def files(name: str, help_: str, required: bool = False) -> None:
        parser.add_argument(name, nargs="+", type=Path, default=[], metavar="FILE", help=help_, required=required)

    parser.add_argument("--mode", choices=PROCESS_MODES, default="ppp")
    motion = parser.add_mutually_exclusive_group()
    motion.add_argument("--kinematic", dest="motion", action="store_const", const=AntennaMotion.KINEMATIC)
    motion.add_argument("--static", dest="motion", action="store_const", const=AntennaMotion.STATIC)
    files("--obs", "observations: RTCM3 or RINEX, plain or gzip")
    files("--rover", "mode rtk: the same as --obs")
    files("--base", "mode rtk: observations of the base station, and its ephemerides")
    parser.add_argument("--base-position", type=_vector, metavar="X,Y,Z",
                        help="mode rtk: the base's antenna reference point, ECEF, m")  # fmt: skip
    parser.add_argument("--integers", choices=("off", "continuous", "instantaneous"), default="continuous",
                        help="mode rtk: resolve integers over time, at every epoch for itself, or not")  # fmt: skip
    parser.add_argument("--frequencies", type=int, choices=(1, 2, 3), default=2, help="mode rtk")
    parser.add_argument("--phase-sigma", type=float, metavar="M",
                        help="mode rtk: noise and multipath of phases at the zenith, one sigma")  # fmt: skip
    files("--nav", "ephemerides: RINEX or RTCM3")
    files("--ssr", "corrections: RTCM3")
    files("--sp3", "precise orbits, several days in any order")
    files("--clk", "precise clocks")
    parser.add_argument("--antex", type=Path, metavar="FILE", help="antenna calibrations")
    files("--accel", "accelerometer: RTCM3, SAC, MiniSEED or CSV")
    files("--pole-zero", "SAC pole-zero files of --accel, in the same order")
    files("--displacement", "a displacement series (mode fuse): SAC, MiniSEED or CSV")
    parser.add_argument("--rotation-deg", type=float, default=0.0, metavar="DEG",
                        help="turn the sensor: E' = E cos + N sin, N' = N cos − E sin")  # fmt: skip
    parser.add_argument("--withhold", type=int, default=1, metavar="N", help="mode fuse: use every Nth displacement")
    parser.add_argument("--reference", type=_vector, metavar="X,Y,Z", help="reference position, ECEF, m")
    parser.add_argument("--antenna-height", type=float, default=0.0, metavar="M")
    parser.add_argument("--systems", default="GREC")
    parser.add_argument("--elevation-mask", type=float, default=7.0, metavar="DEG")
    parser.add_argument("--ar", choices=("off",), default="off", help="of PPP: float alone")
    parser.add_argument("--quality-log", type=Path, metavar="FILE", help="JSON lines: tests and observations an epoch")
    parser.add_argument("--quality-control", choices=("on", "off"), default="on", help="off: leave nothing out")
    parser.add_argument("--test-significance", type=float, metavar="A", help="of the global test (default 0.05)")
    parser.add_argument("--test-power", type=float, metavar="G", help="minimal detectable biases' (default 0.80)")
    parser.add_argument("--w-test-significance", type=float, metavar="A", help="of an observation's (default 0.001)")
    parser.add_argument("--output", type=Path, required=True, metavar="FILE", help="CSV to write")
    add_imu_options(parser)
    parser.set_defaults(run=_process, motion=AntennaMotion.KINEMATIC)


def _add_characterise(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("files", nargs="+", type=Path, metavar="FILE", help="a static record of an IMU")
    parser.add_argument("--imu-format", choices=IMU_FORMATS, default="auto")
    parser.add_argument("--from", dest="begin", type=float, default=0.0, metavar="S", help="use the record from here")
    parser.add_argument("--to", dest="end", type=float, metavar="S", help="up to here")
    parser.add_argument("--output", type=Path, metavar="FILE", help="TOML for `process --imu-characteristics`")
    parser.add_argument("--displacement", nargs="+", type=Path, metavar="FILE",
                        help="compare FILE (an accelerometer's components) with GNSS: how is it mounted?")  # fmt: skip
    parser.add_argument("--pole-zero", nargs="+", type=Path, default=[], metavar="FILE")
    parser.add_argument("--band", type=float, nargs=2, default=(0.05, 0.4), metavar="HZ", help="common band")
    parser.set_defaults(run=_characterise)


def _characterise(options: argparse.Namespace) -> int:
    from plumbline import offline_characterise

    if options.displacement:
        print(offline_characterise.propose_mounting(
            options.files, options.pole_zero, options.displacement, tuple(options.band)))  # fmt: skip
        return 0
    for path in options.files:
        print(offline_characterise.characterise(path, options.imu_format, options.begin, options.end, options.output))
    return 0


def _vector(text: str) -> tuple[float, float, float]:
    values = [float(part) for part in text.split(",")]
    if len(values) != 3:
        raise argparse.ArgumentTypeError("want three numbers: X,Y,Z")
    return values[0], values[1], values[2]


def _serve(options: argparse.Namespace) -> int:
    from plumbline import app

    settings = read_server_settings(
        options.config,
        data_dir=options.data_dir,
        http_port=options.http_port,
        ingest_port=options.ingest_port,
        workers=options.workers,
    )
    return app.main(settings, frozenset(options.role or ROLES))


def _process(options: argparse.Namespace) -> int:
    if options.mode == "fuse":
        return _fuse(options)
    options.obs = [*options.obs, *options.rover]
    mode = Mode(options.mode)
    if mode is Mode.RTK_IMU_LOOSE and options.positions is not None:
        return _process_positions(options)
    if not options.obs:
        raise PlumblineError(f"mode {mode} wants --rover (or --obs)")
    if mode.value.startswith("rtk") and not options.base:
        raise PlumblineError(f"mode {mode} wants --base")
    if mode.value.startswith("rtk-imu") and options.imu is None and not options.station_ids:
        raise PlumblineError(f"mode {mode} wants --imu (or --station-ids, where one recording holds it all)")
    return _run_pipeline(options, _station_settings(options, mode, platform_settings(options)))


def _run_pipeline(options: argparse.Namespace, settings: StationSettings) -> int:
    from plumbline import offline, offline_csv

    request = offline.ProcessRequest(
        settings, tuple(options.obs), tuple(options.nav), tuple(options.ssr), tuple(options.sp3), tuple(options.clk),
        tuple(options.accel), tuple(options.pole_zero), gps_ns_from_unix_ns(time.time_ns()),
        tuple(options.base), further_antennas(options), options.imu, options.imu_format,
    )  # fmt: skip
    with tqdm(total=100, unit="%", disable=None, bar_format="{l_bar}{bar}| {elapsed}<{remaining}") as bar:
        outputs = offline.run(request, partial(_advance, bar))
    rows = offline_csv.write_csv(options.output, outputs, settings.mode, options.every_sample)
    print(f"{options.output}: {rows} rows", file=sys.stderr)
    if options.quality_log is not None:
        lines = offline_csv.write_quality_log(options.quality_log, outputs)
        print(f"{options.quality_log}: {lines} epochs", file=sys.stderr)
    return 0


def _levels(options: argparse.Namespace) -> dict[str, float | None]:
    """Significance and power of the tests, as far as they are given."""
    return {name: getattr(options, name) for name in ("test_significance", "test_power", "w_test_significance")}


def _station_settings(
    options: argparse.Namespace, mode: Mode, platform: Mapping[str, object] | None = None
) -> StationSettings:
    from plumbline import offline

    rtk = {"base_position_ecef_m": options.base_position, "base_stream": "base", "integers": options.integers,
           "frequencies": options.frequencies}  # fmt: skip
    if options.phase_sigma is not None:
        rtk["phase_sigma_m"] = options.phase_sigma
    return offline.settings_of(
        mode, options.reference, options.antenna_height, options.systems, options.elevation_mask, options.motion,
        options.ar, options.rotation_deg, options.antex, rtk, options.quality_control,
        levels=_levels(options), platform=platform,
    )  # fmt: skip


def _process_positions(options: argparse.Namespace) -> int:
    """Mode rtk-imu-loose with a receiver's own positions."""
    from plumbline import offline_imu, offline_imu_loose
    from plumbline.offline_imu_outages import outages_of

    if options.imu is None:
        raise PlumblineError(f"mode {options.mode} wants --imu")
    request = offline_imu.ImuRequest(
        _station_settings(options, Mode.RTK), inertial_settings(options, of_a_logger=True), options.imu,
        options.imu_format, options.output, position_log=options.positions, smooth=not options.forward,
        outages_s=outages_of(options.outages), find_velocity_delay=options.velocity_delay is None,
    )  # fmt: skip
    with tqdm(total=100, unit="%", disable=None, bar_format="{l_bar}{bar}| {elapsed}<{remaining}") as bar:
        report = offline_imu_loose.run_loose(request, partial(_advance, bar))
    print(report, file=sys.stderr)
    return 0


def _advance(bar: "tqdm[NoReturn]", fraction: float) -> None:
    bar.update(100 * fraction - bar.n)


def _fuse(options: argparse.Namespace) -> int:
    from plumbline import offline_fusion

    if not options.displacement or not options.accel:
        raise PlumblineError("mode fuse wants --displacement and --accel")
    report = offline_fusion.run(
        options.displacement, options.accel, options.pole_zero, options.rotation_deg, options.withhold, options.output
    )
    print(report, file=sys.stderr)
    return 0


def _inspect(options: argparse.Namespace) -> int:
    from plumbline.rtcm3.inspection import inspect_bytes

    for path in options.files:
        data = path.read_bytes()
        if data[:2] == b"\x1f\x8b":
            import gzip

            data = gzip.decompress(data)
        inspection = inspect_bytes(data, str(path))
        print(inspection.to_json() if options.json else inspection.to_text())
    return 0


if __name__ == "__main__":
    sys.exit(main())
