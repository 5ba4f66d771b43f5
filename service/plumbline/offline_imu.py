"""A platform's files: what is asked of them, the rows of a CSV, and recordings in the order in which they came."""

import heapq
import math
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import numpy as np

from plumbline import offline
from plumbline.config import InertialSettings, StationSettings
from plumbline.epochs.assembler import EpochAssembler
from plumbline.epochs.recording import read_recording
from plumbline.epochs.stream import Books, NavigationFeed, StreamDecoder
from plumbline.files.imu import even_times, read_imu
from plumbline.files.rinex_observation import RinexObservations
from plumbline.fusion.inertial_run import (
    ROW_ACCELERATION,
    ROW_ATTITUDE_COVARIANCE,
    ROW_POSITION_COVARIANCE,
)
from plumbline.fusion.rotations import angles_from_rotation
from plumbline.fusion.tight_start import angle_sigmas_rad
from plumbline.gps_time import NS_PER_S
from plumbline.offline_csv import seconds_text
from plumbline.records import Epoch, Floats, InertialBlock, Status
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
    smooth: bool = True  # loose: the series that knows what came later, not the one of the moment
    outages_s: tuple[tuple[float, float], ...] = ()  # loose: positions withheld, from and for so long after the first
    find_velocity_delay: bool = False  # loose: from the positions


# ------------------------------------------------------------------------------------------------ recordings


@dataclass(frozen=True, slots=True)
class Arrival:
    """An epoch of a stream (−1 the base, else an antenna) or a block of samples, when it came."""

    t_receive_ns: int
    stream: int
    what: Epoch | InertialBlock


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


# ------------------------------------------------------------------------------------------------ rows


def csv_row(
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
