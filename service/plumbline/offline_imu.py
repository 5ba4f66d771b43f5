"""`plumbline process --mode rtk-imu-loose | rtk-imu-tight`: an IMU with a receiver's positions or raw observations.

Loose: positions (RTKLIB's .pos, or mode ``rtk`` over ``--rover`` and ``--base``) and an IMU table or recording. Tight:
recordings of one or more antennas, of a base and of an IMU.
"""

import csv
import heapq
import math
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from plumbline import offline
from plumbline.config import InertialSettings, StationSettings
from plumbline.epochs.assembler import EpochAssembler
from plumbline.epochs.recording import read_recording
from plumbline.epochs.stream import Books, NavigationFeed, StreamDecoder
from plumbline.errors import ConfigurationError
from plumbline.files.imu import even_times, read_imu
from plumbline.files.position_log import read_position_log
from plumbline.files.rinex_observation import RinexObservations
from plumbline.fusion.inertial_run import (
    ROW_ACCELERATION,
    ROW_ATTITUDE_COVARIANCE,
    ROW_POSITION_COVARIANCE,
    ROW_SIZE,
    write_row,
)
from plumbline.fusion.loose_eskf import initial_loose_state, receive_samples, receive_solution
from plumbline.fusion.loose_state import Innovation, LooseState
from plumbline.fusion.rotations import angles_from_rotation
from plumbline.fusion.tight_platform import (
    Platform,
    PlatformState,
    initial_platform_state,
    receive_platform_epochs,
    receive_platform_inertial,
)
from plumbline.fusion.tight_start import angle_sigmas_rad
from plumbline.fusion.tight_update import TightNode
from plumbline.fusion.timeline import Rows
from plumbline.gnss.earth_frames import ecef_from_geodetic, geodetic_from_ecef, rotation_enu_from_ecef
from plumbline.gps_time import NS_PER_S
from plumbline.offline_csv import seconds_text
from plumbline.positioning.broadcast_source import BroadcastSource
from plumbline.positioning.facts import StationFacts
from plumbline.positioning.rtk_base import base_view
from plumbline.records import Epoch, Floats, InertialBlock, Ints, Solution, Status
from plumbline.rtcm3 import InertialMessage, Observations

ATTITUDE_COLUMNS: Final = (
    "roll_deg", "pitch_deg", "heading_deg", "sigma_roll_deg", "sigma_pitch_deg", "sigma_heading_deg",
)  # fmt: skip
COLUMNS: Final = (
    "t_gps_s", "status", "n_satellites", "e_m", "n_m", "u_m", "sigma_e_m", "sigma_n_m", "sigma_u_m",
    "x_ecef_m", "y_ecef_m", "z_ecef_m", "ve_m_s", "vn_m_s", "vu_m_s", "ae_m_s2", "an_m_s2", "au_m_s2",
    *ATTITUDE_COLUMNS, "reason",
)  # fmt: skip
_COASTING_NS: Final = 2 * NS_PER_S


@dataclass(frozen=True, slots=True)
class ImuRequest:
    """What to process, as the command line says it."""

    settings: StationSettings
    inertial: InertialSettings
    imu: Path
    imu_format: str
    output: Path
    rovers: tuple[Path, ...] = ()  # one an antenna, in the order of the lever arms
    base: Path | None = None
    navigation: tuple[Path, ...] = ()
    position_log: Path | None = None  # loose: instead of rovers and base
    t_near_gps_ns: int = 0
    every_sample: bool = False  # tight: a row a sample, not one an epoch


# ------------------------------------------------------------------------------------------------ loose


def run_loose(request: ImuRequest, report: Callable[[float], None] = lambda fraction: None) -> str:
    """Fuse positions with the samples, write the CSV and return the figures of the run in words."""
    times, samples = imu_samples(request)
    solutions = _solutions(request)
    reference = _reference(request, solutions)
    state = initial_loose_state("process")
    innovations: list[Innovation] = []
    with request.output.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(COLUMNS)
        for first, last, due in _shares(times, solutions):
            result = receive_samples(state, times[first:last], samples[first:last], request.inertial)
            state, rows = result.state, [result.rows]
            innovations += result.innovations
            for solution in due:
                result = receive_solution(state, solution, request.inertial)
                state, rows = result.state, [*rows, result.rows]
                innovations += result.innovations
            writer.writerows(_loose_rows(rows, state, reference, request.inertial))
            report(last / times.size)
    return _figures(state, innovations)


def imu_samples(request: ImuRequest) -> tuple[Ints, Floats]:
    """Times (n,) and samples (n, 6) of a table in body axes, stamps evened out, the time offset added."""
    series = read_imu(request.imu, request.imu_format)
    if not np.isfinite(series.angular_rate_rad_s).all():
        raise ConfigurationError(f"{request.imu}: no angular rates")
    turn = np.array(request.inertial.rotation_body_from_sensor)
    samples = np.hstack([series.specific_force_m_s2 @ turn.T, series.angular_rate_rad_s @ turn.T])
    return even_times(series.t_gps_ns) + round(request.inertial.inertial_time_offset_s * NS_PER_S), samples


def _solutions(request: ImuRequest) -> list[Solution]:
    if request.position_log is not None:
        return read_position_log(request.position_log)
    if request.base is None or not request.rovers:
        raise ConfigurationError("mode rtk-imu-loose wants --positions, or --rover and --base")
    asked = offline.ProcessRequest(
        request.settings, request.rovers[:1], request.navigation, t_near_gps_ns=request.t_near_gps_ns,
        base=(request.base,),
    )  # fmt: skip
    return [output for output in offline.run(asked) if isinstance(output, Solution)]


def _shares(times: Ints, solutions: Sequence[Solution]) -> Iterator[tuple[int, int, list[Solution]]]:
    """Samples a second, and the solutions of that second."""
    bounds = np.searchsorted(times, np.arange(times[0], times[-1] + NS_PER_S, NS_PER_S))
    at = 0
    for first, last in zip(bounds, [*bounds[1:].tolist(), times.size], strict=True):
        until_ns, due = times[last - 1], []
        while at < len(solutions) and (solutions[at].t_gps_ns <= until_ns or last == times.size):
            due.append(solutions[at])
            at += 1
        yield int(first), int(last), due


def _reference(request: ImuRequest, solutions: Sequence[Solution]) -> Floats:
    """The reference position, ECEF; without a setting, the first position."""
    given = request.settings.reference_position_ecef_m
    first = next((s.position_ecef_m for s in solutions if s.position_ecef_m is not None), None)
    if given is None and first is None:
        raise ConfigurationError("no position in the input")
    return np.array(given if given is not None else first, float)


def _loose_rows(
    parts: Sequence[Rows], state: LooseState, reference: Floats, inertial: InertialSettings
) -> Iterator[list[str]]:
    """The last word on each sample of a second."""
    place = geodetic_from_ecef(reference)
    enu = rotation_enu_from_ecef(place[0], place[1])
    arm = np.array(inertial.lever_arms_body_m[0])
    latest = {int(t): row for part in parts for t, row in zip(part.t_gps_ns, part.values, strict=True)}
    extra = state.timeline.nodes[-1].extra if state.timeline.nodes else None
    for t_ns in sorted(latest):
        row = latest[t_ns]
        rotation = row[6:15].reshape(3, 3)
        local = rotation_enu_from_ecef(row[0], row[1])
        position = ecef_from_geodetic(row[0], row[1], row[2]) + local.T @ (rotation @ arm)
        late = extra is None or extra.t_fix_gps_ns is None or t_ns - extra.t_fix_gps_ns > _COASTING_NS
        status = Status.COASTING if late or extra is None else extra.status
        yield _row(t_ns, status, 0, enu @ (position - reference), position, row, rotation, np.eye(3), "")


def _figures(state: LooseState, innovations: Sequence[Innovation]) -> str:
    """What the run says of itself."""
    used = [i for i in innovations if i.used]
    if not used:
        return "no attitude was found: " + (", ".join(f"{k} {n}" for k, n in state.timeline.counters.items()) or "why?")
    lines = [f"aligned: {state.aligned}", f"fixes used {len(used)} of {len(innovations)}"]
    for words, values in (("one-step prediction", [i.value for i in used]), ("filtered", [i.left for i in used])):
        errors = np.array(values)[:, :3]
        rms = np.sqrt(np.nanmean(errors**2, axis=0))
        lines.append(f"{words} against GNSS, RMS E N U: {rms[0]:.4f} {rms[1]:.4f} {rms[2]:.4f} m")
    return "\n".join([*lines, *(f"{reason}: {n}" for reason, n in state.timeline.counters.items())])


# ------------------------------------------------------------------------------------------------ tight


@dataclass(frozen=True, slots=True)
class Arrival:
    """An epoch of a stream (−1 the base, else an antenna) or a block of samples, when it came."""

    t_receive_ns: int
    stream: int
    what: Epoch | InertialBlock


def run_tight(request: ImuRequest, report: Callable[[float], None] = lambda fraction: None) -> str:
    """Run the tight filter over recordings, write the CSV and return the figures of the run in words."""
    if request.base is None or not request.rovers:
        raise ConfigurationError("mode rtk-imu-tight wants --rover and --base")
    if len(request.inertial.lever_arms_body_m) != len(request.rovers):
        raise ConfigurationError("mode rtk-imu-tight wants a lever arm for each rover antenna")
    books = Books()
    source = BroadcastSource(books.ephemerides, books.corrections, request.settings.positioning)
    platform = Platform(request.settings, request.inertial, StationFacts("process"), source)
    statuses: Counter[str] = Counter()
    with request.output.open("w", newline="", encoding="utf-8") as stream:
        writer = csv.writer(stream, lineterminator="\n")
        writer.writerow(COLUMNS)
        given = request.settings.reference_position_ecef_m
        reference = None if given is None else np.array(given)
        last = initial_platform_state("process")
        for last, rows in _tight_steps(request, books, platform):  # noqa: B007 - the last one is reported
            for row in rows:
                reference = row.nav[:3].copy() if reference is None else reference
                statuses[str(row.status)] += 1
                writer.writerow(_tight_row(row, reference))
        report(1.0)
    return "\n".join(
        [f"aligned: {last.aligned or 'not: ' + last.reason}", *(f"{name}: {n}" for name, n in statuses.items())]
    )


@dataclass(frozen=True, slots=True)
class _TightRow:
    t_gps_ns: int
    status: Status
    n_satellites: int
    nav: Floats  # a row of plumbline.fusion.inertial_run


def _tight_steps(
    request: ImuRequest, books: Books, platform: Platform
) -> Iterator[tuple[PlatformState, list[_TightRow]]]:
    """Feed arrivals to the platform, instants of all antennas together."""
    state, n = initial_platform_state("process"), len(request.rovers)
    waiting: dict[int, list[Epoch | None]] = {}
    for arrival in arrivals(request, books):
        if isinstance(arrival.what, InertialBlock):
            result = receive_platform_inertial(state, arrival.what, platform)
            state = result.state
            yield state, _rows_of(result.rows, result.updated, request.every_sample)
            continue
        instant = waiting.setdefault(arrival.what.t_gps_ns, [None] * n)
        instant[arrival.stream] = arrival.what
        for t_ns in sorted(waiting):
            if None in waiting[t_ns] and t_ns > arrival.what.t_gps_ns - NS_PER_S // 5:
                break
            epochs = waiting.pop(t_ns)
            seen = max(e.t_receive_ns for e in epochs if e is not None)
            base = base_view(books.bases, t_ns, max(seen, arrival.t_receive_ns), request.settings.rtk)
            done = receive_platform_epochs(state, epochs, base, platform)
            state = done.state
            yield state, _rows_of(done.rows, done.updated, request.every_sample)


def _rows_of(rows: Rows, nodes: Sequence[TightNode], every_sample: bool) -> list[_TightRow]:
    """Rows to write: of every sample passed, or of every epoch applied."""
    if every_sample:
        extra = nodes[-1].extra if nodes else None
        status = extra.status if extra else Status.COASTING
        count = extra.n_satellites if extra else 0
        return [_TightRow(int(t), status, count, row) for t, row in zip(rows.t_gps_ns, rows.values, strict=True)]
    made = []
    for node in nodes:
        row, at = np.empty(ROW_SIZE), int(np.searchsorted(rows.t_gps_ns, node.t_gps_ns))
        acceleration = rows.values[at, ROW_ACCELERATION:] if at < len(rows.values) else np.full(3, np.nan)
        write_row(node.nav, node.p, acceleration, row)
        made.append(_TightRow(node.t_gps_ns, node.extra.status, node.extra.n_satellites, row))
    return made


def arrivals(request: ImuRequest, books: Books) -> Iterator[Arrival]:
    """Everything that the recordings hold, in the order in which it came; the base's goes into the books on the way."""
    if request.base is None:
        return
    near_ns = offline.time_near(offline.ProcessRequest(
        request.settings, request.rovers, request.navigation, t_near_gps_ns=request.t_near_gps_ns, base=(request.base,)
    ), books)  # fmt: skip
    feed = NavigationFeed(request.settings.rtk.base_stream or "base", books)
    pieces = [(p.t_ns, -1, p) for p in read_recording(request.base, request.base.name, t_near_ns=near_ns)]
    streams: list[Iterator[tuple[int, int, object]]] = [iter(pieces)]
    for number, path in enumerate(request.rovers):
        streams.append(_antenna(path, number, books, near_ns))
    streams.append(_inertial(request, near_ns))
    for t_ns, number, what in heapq.merge(*streams, key=lambda entry: (entry[0], entry[1])):
        if number < 0:
            feed.receive(what.data, t_ns)  # type: ignore[attr-defined]
        elif isinstance(what, Epoch | InertialBlock):
            yield Arrival(t_ns, number, what)


def _antenna(path: Path, number: int, books: Books, near_ns: int) -> Iterator[tuple[int, int, object]]:
    """Epochs of one antenna's file."""
    if offline.is_rinex(path):
        yield from ((epoch.t_receive_ns, number, epoch) for epoch in RinexObservations(path))
        return
    decoder, assembler = StreamDecoder(), EpochAssembler(NS_PER_S * 4 // 5)
    t_ns = near_ns
    for piece in read_recording(path, path.name, t_near_ns=near_ns):
        t_ns = piece.t_ns
        epochs = assembler.advance(t_ns)
        for message in decoder.receive(piece.data):
            if not books.learn(message, t_ns) and isinstance(message, Observations):
                epochs += assembler.receive(message, message.t_gps_ns(books.time_base.near(t_ns)), t_ns)
        yield from ((t_ns, number, epoch) for epoch in epochs)
    yield from ((t_ns, number, epoch) for epoch in assembler.flush())


def _inertial(request: ImuRequest, near_ns: int) -> Iterator[tuple[int, int, object]]:
    """Blocks of samples: of a recording, or of a table in blocks of a tenth of a second."""
    last = len(request.rovers)
    if request.imu.suffix.lower() in (".rtcm3", ".rtcm", ".rtc", ".bin"):
        decoder = StreamDecoder()
        for piece in read_recording(request.imu, request.imu.name, t_near_ns=near_ns):
            for message in decoder.receive(piece.data):
                if isinstance(message, InertialMessage):
                    yield piece.t_ns, last, message.block(piece.t_ns, piece.t_ns)
        return
    series = read_imu(request.imu, request.imu_format)
    times, interval_ns = even_times(series.t_gps_ns), round(series.interval_s * NS_PER_S)
    size = max(round(0.1 / series.interval_s), 1)
    for first in range(0, times.size, size):
        part = slice(first, first + size)
        t_ns = int(times[part][-1])
        yield t_ns, last, InertialBlock(
            int(times[first]), t_ns, interval_ns, series.specific_force_m_s2[part], series.angular_rate_rad_s[part]
        )  # fmt: skip


def _tight_row(row: _TightRow, reference: Floats) -> list[str]:
    place = geodetic_from_ecef(reference)
    enu = rotation_enu_from_ecef(place[0], place[1])
    position = row.nav[0:3]
    turned = row.nav.copy()
    turned[3:6], turned[ROW_ACCELERATION:] = enu @ row.nav[3:6], enu @ row.nav[ROW_ACCELERATION:]
    rotation = enu @ row.nav[6:15].reshape(3, 3)
    displacement = enu @ (position - reference)
    return _row(row.t_gps_ns, row.status, row.n_satellites, displacement, position, turned, rotation, enu, "")


# ------------------------------------------------------------------------------------------------ rows


def _row(
    t_gps_ns: int, status: Status, n_satellites: int, displacement: Floats, position: Floats, row: Floats,
    rotation_enu: Floats, enu_from_frame: Floats, reason: str,
) -> list[str]:  # fmt: skip
    """A row of the CSV; velocity and acceleration of ``row`` are east, north, up, its covariances in its own frame."""

    def covariance(at: int) -> Floats:
        turned: Floats = enu_from_frame @ row[at : at + 9].reshape(3, 3) @ enu_from_frame.T
        return turned

    angles = angles_from_rotation(rotation_enu)
    sigmas = angle_sigmas_rad(covariance(ROW_ATTITUDE_COVARIANCE), angles[0], angles[1])
    numbers = [
        *displacement, *np.sqrt(np.diag(covariance(ROW_POSITION_COVARIANCE))), *position, *row[3:6],
        *row[ROW_ACCELERATION:],
    ]  # fmt: skip
    degrees = np.degrees([angles[2], angles[1], angles[0], sigmas[2], sigmas[1], sigmas[0]])
    texts = [_text(value, 5) for value in numbers] + [_text(value, 5) for value in degrees]
    return [seconds_text(t_gps_ns), str(status), str(n_satellites), *texts, reason]


def _text(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if math.isfinite(value) else ""
