"""``plumbline-dtu``: replay, convert, simulate, demo."""

import argparse
import asyncio
import json
import sys
from collections.abc import Sequence
from pathlib import Path

from tqdm import tqdm

from plumbline.errors import PlumblineError
from plumbline.signals import SYSTEM_LETTERS
from plumbline_dtu import demo, simulate_cli
from plumbline_dtu.convert import Conversion, convert
from plumbline_dtu.device import DeviceOptions, bytes_of, parse_address, tls_context
from plumbline_dtu.replay import Replay, play


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command; returns the exit code."""
    parsed = _parser().parse_args(arguments)
    try:
        code: int = parsed.run(parsed)
    except PlumblineError as error:
        print(f"plumbline-dtu: {error}", file=sys.stderr)
        return 2
    except KeyboardInterrupt:
        return 130
    return code


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="plumbline-dtu", description="The device side of plumbline.")
    commands = parser.add_subparsers(required=True, metavar="COMMAND")
    _add_replay(commands.add_parser("replay", help="play RTCM3 recordings as DTUs would have sent them"))
    _add_convert(commands.add_parser("convert", help="RINEX, SP3 and clocks to RTCM3 streams"))
    simulate_cli.add_simulate(commands.add_parser("simulate", help="stations with a known motion"))
    demo.add_demo(commands.add_parser("demo", help="a server and three simulated stations"))
    return parser


# --------------------------------------------------------------------------------------------- replay


def _add_replay(parser: argparse.ArgumentParser) -> None:
    parser.description = (
        "Several files are merged by the times in their frames; at equal times the file given first goes first, so give"
        " corrections before observations. Nothing is re-stamped."
    )
    parser.add_argument("files", nargs="+", metavar="[NAME=]FILE", help="recording; NAME defaults to the file's stem")
    add_device_arguments(parser)
    parser.add_argument("--speed", type=float, default=1.0, help="times real time; 0: as fast as the server takes it")
    parser.add_argument(
        "--start-now",
        action="store_true",
        help="do not wait for the second of the minute at which the recording begins (speed 1 only)",
    )
    parser.add_argument("--inertial-message", type=int, default=4001, help="message number of inertial samples")
    parser.set_defaults(run=_replay)


def add_device_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of a DTU's connection."""
    parser.add_argument("--server", required=True, metavar="HOST:PORT")
    parser.add_argument(
        "--registration",
        default="",
        help=r"first bytes of the connection, escapes \r \n \xNN; {name}: a connection per name",
    )
    parser.add_argument("--prefix-packets", action="store_true", help="registration before every packet")
    parser.add_argument("--heartbeat", default="", help="bytes sent between frames")
    parser.add_argument("--heartbeat-interval", type=float, default=30.0, metavar="S")
    parser.add_argument("--largest-segment", type=int, default=1021, metavar="BYTES")
    parser.add_argument("--give-up", type=float, metavar="S", help="end with an error after S without a connection")
    parser.add_argument("--tls", action="store_true")
    parser.add_argument("--tls-ca", metavar="FILE", help="authority to trust instead of the system's")
    parser.add_argument("--tls-insecure", action="store_true", help="do not check the server's certificate")


def device_options(parsed: argparse.Namespace) -> DeviceOptions:
    """The options that :func:`add_device_arguments` added."""
    address = parse_address(parsed.server)
    return DeviceOptions(
        host=address.host,
        port=address.port,
        registration=bytes_of(parsed.registration),
        heartbeat=bytes_of(parsed.heartbeat),
        heartbeat_interval_s=parsed.heartbeat_interval,
        prefix_packets=parsed.prefix_packets,
        largest_segment=max(parsed.largest_segment, 2),
        give_up_s=parsed.give_up,
        tls=tls_context(parsed.tls_ca, parsed.tls_insecure) if parsed.tls else None,
    )


def _replay(parsed: argparse.Namespace) -> int:
    files = []
    for text in parsed.files:
        name, equals, path = text.rpartition("=")
        file = Path(path if equals else text)
        if not file.is_file():
            print(f"plumbline-dtu: no such file: {file}", file=sys.stderr)
            return 2
        files.append((name or file.name.split(".")[0], file))
    replay = Replay(files, device_options(parsed), parsed.speed, parsed.start_now, parsed.inertial_message)
    with tqdm(unit="frame", disable=None) as bar:

        def progress(done: int, total: int) -> None:
            bar.total = total
            bar.update(done - bar.n)

        counters = asyncio.run(play(replay, progress))
    for name, c in counters.items():
        print(
            f"{name}: {c.sent_bytes} bytes in {c.connections} connections, {c.lost_bytes} lost, "
            f"{c.heartbeats} heartbeats, {c.received_bytes} bytes received"
        )
    return 0


# --------------------------------------------------------------------------------------------- convert


def _add_convert(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--obs", nargs="+", type=Path, required=True, metavar="FILE")
    parser.add_argument("--nav", nargs="+", type=Path, required=True, metavar="FILE")
    parser.add_argument("--sp3", nargs="+", type=Path, default=[], metavar="FILE")
    parser.add_argument("--clk", nargs="+", type=Path, default=[], metavar="FILE")
    parser.add_argument("--antex", type=Path, help="send phase centres instead of centres of mass")
    parser.add_argument("--interval", type=float, metavar="S", help="use the epochs on this interval alone")
    parser.add_argument("--correction-interval", type=int, metavar="S", help="one of SSR's update intervals")
    parser.add_argument("--reference", metavar="X,Y,Z", help="marker, m, for message 1006; default: the file's own")
    parser.add_argument("--station-id", type=int, default=1)
    parser.add_argument("--systems", default=SYSTEM_LETTERS)
    parser.add_argument("--msm", type=int, choices=(4, 5, 6, 7), default=7)
    parser.add_argument("--max-epochs", type=int)
    parser.add_argument("--out", type=Path, required=True, metavar="DIR")
    parser.set_defaults(run=_convert)


def _convert(parsed: argparse.Namespace) -> int:
    conversion = Conversion(
        observations=parsed.obs,
        navigation=parsed.nav,
        out=parsed.out,
        orbits=parsed.sp3,
        clocks=parsed.clk,
        antex=parsed.antex,
        interval_s=parsed.interval,
        correction_interval_s=parsed.correction_interval,
        station_id=parsed.station_id,
        reference_ecef_m=vector(parsed.reference) if parsed.reference else None,
        systems=parsed.systems,
        msm=parsed.msm,
        max_epochs=parsed.max_epochs,
    )
    with tqdm(total=100, unit="%", disable=None) as bar:

        def progress(fraction: float) -> None:
            bar.update(round(100 * fraction) - bar.n)

        summary = convert(conversion, progress)
    print(json.dumps(summary, indent=2))
    return 0


def vector(text: str) -> tuple[float, float, float]:
    """Three numbers separated by commas; raises ``argparse.ArgumentTypeError``."""
    try:
        x, y, z = (float(part) for part in text.split(","))
    except ValueError:
        raise argparse.ArgumentTypeError(f"{text!r} is no X,Y,Z") from None
    return x, y, z


if __name__ == "__main__":
    sys.exit(main())
