"""`plumbline process`: the same pipeline over files, without a server.

Files become one line of events in the order of their times, as a server would have received them, and the pipeline's
records become the rows of a CSV.
"""

import gzip
import heapq
import math
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Final, NamedTuple

import numpy as np
from pydantic import ValidationError

from plumbline.config import AntennaMotion, Mode, StationSettings
from plumbline.epochs.base_book import BaseBook
from plumbline.epochs.recording import Piece, read_recording
from plumbline.epochs.stream import Books, NavigationFeed, StreamDecoder
from plumbline.errors import ConfigurationError
from plumbline.files.imu import even_times, read_imu
from plumbline.files.rinex_clock import read_clocks
from plumbline.files.rinex_header import RinexObservationHeader
from plumbline.files.rinex_navigation import read_navigation
from plumbline.files.rinex_observation import RinexObservations
from plumbline.files.seismic import read_components
from plumbline.files.sp3 import read_sp3
from plumbline.gps_time import NS_PER_S
from plumbline.pipeline import Pipeline
from plumbline.positioning.precise_source import PreciseSource, channels_of_ephemerides
from plumbline.positioning.satellites import SatelliteSource
from plumbline.positioning.solutions import rotation_at
from plumbline.records import AntennaDescription, Epoch, InertialBlock, Output

_TABLE_BLOCK_S: Final = 0.1  # an IMU's table is fed in blocks of this
_BLOCK_NS: Final = NS_PER_S  # inertial series are fed in blocks of one second, as a device sends them


@dataclass(frozen=True, slots=True)
class ProcessRequest:
    """What to process, as the command line says it."""

    settings: StationSettings
    obs: tuple[Path, ...]
    nav: tuple[Path, ...] = ()
    ssr: tuple[Path, ...] = ()
    sp3: tuple[Path, ...] = ()
    clk: tuple[Path, ...] = ()
    accel: tuple[Path, ...] = ()
    pole_zero: tuple[Path, ...] = ()  # of `accel`
    t_near_gps_ns: int = 0  # settles the week of recordings without ephemerides
    base: tuple[Path, ...] = ()  # observations of the base station (mode rtk), with its ephemerides
    antennas: tuple[Path, ...] = ()  # of the platform's further antennas, in the order of `settings.antenna_streams`
    imu: Path | None = None  # recording (`settings.inertial_stream` names it) or table
    imu_format: str = "auto"


class Event(NamedTuple):
    """Something that reaches the pipeline at a time."""

    t_receive_ns: int
    deliver: Callable[[Pipeline], list[Output]]


@dataclass(slots=True)
class Progress:
    """How much of the input has been read, 0…1."""

    fraction: float = 0.0
    report: Callable[[float], None] = field(default=lambda fraction: None)

    def at(self, fraction: float) -> None:
        """Report it when it has grown by a thousandth."""
        if fraction - self.fraction >= 1e-3 or fraction >= 1.0:
            self.fraction = fraction
            self.report(fraction)


def is_rinex(path: Path) -> bool:
    """Whether a file, plain or gzip, begins like RINEX (or compact RINEX)."""
    head = path.open("rb").read(2)
    with gzip.open(path) if head == b"\x1f\x8b" else path.open("rb") as stream:
        return b"RINEX" in stream.read(80)


def run(request: ProcessRequest, report: Callable[[float], None] = lambda fraction: None) -> list[Output]:
    """All records that the pipeline makes of the files, in order."""
    books = Books()
    t_near_ns = _load_navigation(request, books)
    pipeline = Pipeline(request.settings, (), books, source=_precise_source(request))
    pipeline.state.description = AntennaDescription(0, antenna_type=_antenna_type(request.obs))
    progress = Progress(report=report)
    corrections = (*request.ssr, *_recordings(request.nav))  # before the observations of the same instant
    streams: list[Iterable[Event]] = [_base_events(path, request.settings, books, t_near_ns) for path in request.base]
    streams += [_correction_events(path, books, t_near_ns) for path in corrections]
    streams += [_observation_events(path, t_near_ns, progress) for path in request.obs]
    antennas = zip(request.antennas, request.settings.antenna_streams, strict=True)
    streams[:0] = [_antenna_events(path, name, books, t_near_ns) for path, name in antennas]
    if request.imu is not None:
        streams.insert(0, _imu_events(request, request.imu, books, t_near_ns))
    if request.accel:
        streams.append(_inertial_events(request, t_near_ns))
    outputs: list[Output] = []
    t_ns = t_near_ns
    for event in heapq.merge(*streams, key=lambda event: event.t_receive_ns):
        outputs += event.deliver(pipeline)
        t_ns = event.t_receive_ns
    progress.at(1.0)
    return outputs + pipeline.finish(t_ns)


# ------------------------------------------------------------------------------------------------ inputs


def _recordings(paths: Sequence[Path]) -> list[Path]:
    return [path for path in paths if not is_rinex(path)]


def time_near(request: ProcessRequest, books: Books) -> int:
    """RINEX navigation into the books; returns a time within half a week of the recordings."""
    return _load_navigation(request, books)


def _load_navigation(request: ProcessRequest, books: Books) -> int:
    """RINEX navigation into the books; returns a time within half a week of the recordings."""
    for path in request.nav:
        if is_rinex(path):
            for ephemeris in read_navigation(path).ephemerides:
                books.ephemerides.add(ephemeris)
    for path in request.obs:
        if is_rinex(path):
            return next(iter(RinexObservations(path))).t_gps_ns
    for path in (*_recordings(request.obs), *_recordings((*request.base, *request.nav)), *request.ssr):
        t_ns = _time_of_ephemerides(path, request.t_near_gps_ns)
        if t_ns is not None:
            return t_ns
    return request.t_near_gps_ns


def _time_of_ephemerides(path: Path, t_near_ns: int) -> int | None:
    """When a recording was made, to within hours, if its ephemerides tell."""
    books, decoder = Books(), StreamDecoder()
    for piece in read_recording(path, path.name):
        for message in decoder.receive(piece.data):
            books.learn(message, t_near_ns)
            if books.time_base.known:
                return books.time_base.near(t_near_ns)
    return None


def _antenna_type(paths: Sequence[Path]) -> str | None:
    """What a RINEX header says of its antenna; recordings say it in their own messages."""
    return next((RinexObservations(path).header.antenna_type for path in paths if is_rinex(path)), None)


def _precise_source(request: ProcessRequest) -> SatelliteSource | None:
    if not request.sp3:
        return None
    orbits, clocks = read_sp3(request.sp3)
    if request.clk:
        clocks = read_clocks(request.clk).clocks
    ephemerides = [e for path in request.nav if is_rinex(path) for e in read_navigation(path).ephemerides]
    return PreciseSource(orbits, clocks, channels_of_ephemerides(ephemerides))


def _observation_events(path: Path, t_near_ns: int, progress: Progress) -> Iterator[Event]:
    if is_rinex(path):
        observations = RinexObservations(path)
        for epoch in observations:
            progress.at(observations.fraction)
            yield Event(epoch.t_receive_ns, partial(_deliver_epoch, epoch))
        return
    pieces = read_recording(path, path.name, t_near_ns=t_near_ns)
    for i, piece in enumerate(pieces):
        progress.at((i + 1) / len(pieces))
        yield Event(piece.t_ns, partial(_deliver_piece, piece))


def _base_events(path: Path, settings: StationSettings, books: Books, t_near_ns: int) -> Iterator[Event]:
    """A base's epochs into the books: a recording through its feed, RINEX as it is."""
    stream = path.name if settings.mode is Mode.RTK_NETWORK else settings.rtk.base_stream or path.name
    if not is_rinex(path):
        yield from _correction_events(path, books, t_near_ns, stream)
        return
    yield from _rinex_events(path, stream, books)


def _antenna_events(path: Path, stream: str, books: Books, t_near_ns: int) -> Iterator[Event]:
    """A further antenna's epochs into the books."""
    return _rinex_events(path, stream, books) if is_rinex(path) else _correction_events(path, books, t_near_ns, stream)


def _rinex_events(path: Path, stream: str, books: Books) -> Iterator[Event]:
    observations, book = RinexObservations(path), BaseBook()
    books.bases[stream] = book
    header = observations.header
    book.describe(AntennaDescription(0, _reference_point(header), antenna_type=header.antenna_type or None), 0)
    for epoch in observations:
        yield Event(epoch.t_receive_ns, partial(_deliver_base, book, epoch))


def _reference_point(header: RinexObservationHeader) -> tuple[float, float, float] | None:
    """Antenna reference point of a RINEX header, ECEF, m."""
    if header.approximate_position_ecef_m is None or not any(header.approximate_position_ecef_m):
        return None
    up, east, north = header.antenna_delta_hen_m
    marker = np.array(header.approximate_position_ecef_m)
    x, y, z = (marker + rotation_at(marker).T @ np.array([east, north, up])).tolist()
    return x, y, z


def _deliver_base(book: BaseBook, epoch: Epoch, pipeline: Pipeline) -> list[Output]:
    book.add(epoch)
    return []


def _correction_events(path: Path, books: Books, t_near_ns: int, stream: str | None = None) -> Iterator[Event]:
    feed = NavigationFeed(stream or path.name, books)
    for piece in read_recording(path, path.name, t_near_ns=t_near_ns):
        yield Event(piece.t_ns, partial(_deliver_correction, feed, piece))


def _imu_events(request: ProcessRequest, path: Path, books: Books, t_near_ns: int) -> Iterator[Event]:
    """An IMU's samples: a recording through its feed, a table in blocks that are due with their last sample."""
    if _is_recording(path):
        yield from _correction_events(path, books, t_near_ns, request.settings.inertial_stream)
        return
    series = read_imu(path, request.imu_format)
    if not np.isfinite(series.angular_rate_rad_s).all():
        raise ConfigurationError(f"{path}: no angular rates")
    times, interval_ns = even_times(series.t_gps_ns), round(series.interval_s * NS_PER_S)
    size = max(round(_TABLE_BLOCK_S / series.interval_s), 1)
    for first in range(0, times.size, size):
        part = slice(first, first + size)
        forces, rates, t_last_ns = (
            series.specific_force_m_s2[part],
            series.angular_rate_rad_s[part],
            int(times[part][-1]),
        )
        block = InertialBlock(int(times[first]), t_last_ns, interval_ns, forces, rates)
        yield Event(t_last_ns, partial(_deliver_samples, block))


def _inertial_events(request: ProcessRequest, t_near_ns: int) -> Iterator[Event]:
    """Samples of a recording, or of a series' one or three files, in blocks of a second due when their last is in."""
    if all(_is_recording(path) for path in request.accel):
        for path in request.accel:
            yield from _observation_events(path, t_near_ns, Progress())
        return
    series = read_components(request.accel, request.pole_zero)
    if series.values.shape[1] != 3:
        raise ConfigurationError(f"--accel wants three components, not {series.values.shape[1]}")
    size = max(1, round(_BLOCK_NS / series.interval_ns))
    for start in range(0, len(series.values), size):
        values = series.values[start : start + size]
        t_first_ns = series.t_first_gps_ns + start * series.interval_ns
        t_last_ns = t_first_ns + len(values) * series.interval_ns
        block = InertialBlock(t_first_ns, t_last_ns, series.interval_ns, values)
        yield Event(t_last_ns, partial(_deliver_samples, block))


def _deliver_epoch(epoch: Epoch, pipeline: Pipeline) -> list[Output]:
    return pipeline.advance(epoch.t_receive_ns) + pipeline.process_epoch(epoch)


def _deliver_piece(piece: Piece, pipeline: Pipeline) -> list[Output]:
    return pipeline.receive(piece.data, piece.t_ns)


def _deliver_correction(feed: NavigationFeed, piece: Piece, pipeline: Pipeline) -> list[Output]:
    feed.receive(piece.data, piece.t_ns)
    return []


def _deliver_samples(block: InertialBlock, pipeline: Pipeline) -> list[Output]:
    return pipeline.advance(block.t_receive_ns) + pipeline.receive_inertial(block)


def _is_recording(path: Path) -> bool:
    return path.suffix.lower() in (".rtcm3", ".rtcm", ".rtc", ".bin")


# ------------------------------------------------------------------------------------------------ settings


def rotation_about_up(angle_deg: float) -> tuple[tuple[float, float, float], ...]:
    """The matrix of E' = E cos + N sin, N' = N cos − E sin, U' = U."""
    c, s = math.cos(math.radians(angle_deg)), math.sin(math.radians(angle_deg))
    return (c, s, 0.0), (-s, c, 0.0), (0.0, 0.0, 1.0)


def settings_of(
    mode: Mode,
    reference: tuple[float, float, float] | None,
    antenna_height_m: float,
    systems: str,
    elevation_mask_deg: float,
    motion: AntennaMotion,
    ambiguity_resolution: str,
    rotation_deg: float = 0.0,
    antex: Path | None = None,
    rtk: Mapping[str, object] | None = None,
    quality_control: str = "on",
    *,
    levels: Mapping[str, float | None] | None = None,
    platform: Mapping[str, object] | None = None,
) -> StationSettings:
    """Station settings from the command line's words; raises ConfigurationError for what does not go together.

    ``platform``: settings of several antennas and an IMU, by their names.
    """
    values = {
        "station": "process",
        "mode": mode,
        "reference_position_ecef_m": reference,
        "antenna_height_m": antenna_height_m,
        "antex": None if antex is None else str(antex),
        "positioning": {
            "systems": systems,
            "elevation_mask_deg": elevation_mask_deg,
            "motion": motion,
            "ambiguity_resolution": ambiguity_resolution,
            "quality_control": quality_control,
            **{name: value for name, value in (levels or {}).items() if value is not None},
        },
        "rtk": dict(rtk or {}),
        "fusion": {"rotation_enu_from_sensor": rotation_about_up(rotation_deg)},
        **(platform or {}),
    }
    try:
        return StationSettings.model_validate(values)
    except ValidationError as error:
        words = "; ".join(f"{'.'.join(map(str, item['loc']))} {item['msg']}".strip() for item in error.errors())
        raise ConfigurationError(words) from error
