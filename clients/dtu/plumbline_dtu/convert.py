"""RINEX observations and navigation, SP3 and clocks → the RTCM3 streams that a receiver and a correction service send.

``observations.rtcm3``: 1006, 1008, 1033, ephemerides and MSM7, as a receiver sends them. ``corrections.rtcm3`` (where
precise products are given): ephemerides and SSR orbits, clocks and code biases; phase biases too where the clock file
has wide-lane biases, as integer-recovery clocks do. ``streams.json`` says what is in them; above all the reference
point of the orbits, which both sides must treat alike: ``centre_of_mass`` without ANTEX (SP3 as it is: `plumbline
process` without ``--antex`` does the same), ``antenna_phase_centre`` with it.
"""

import json
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, BinaryIO, Final

import numpy as np

from plumbline.errors import ConfigurationError
from plumbline.files.antex import read_antex
from plumbline.files.rinex_clock import read_clocks
from plumbline.files.rinex_header import RinexObservationHeader
from plumbline.files.rinex_navigation import read_navigation
from plumbline.files.rinex_observation import RinexObservations
from plumbline.files.sp3 import read_sp3
from plumbline.gnss.antenna import build_antenna_book
from plumbline.gnss.earth_frames import geodetic_from_ecef, rotation_enu_from_ecef
from plumbline.gnss.orbits_precise import PreciseTables, build_tables
from plumbline.gps_time import NS_PER_S
from plumbline.records import Ephemeris, Epoch, KeplerEphemeris, SsrHeader
from plumbline.rtcm3.ssr import UPDATE_INTERVALS_S
from plumbline.signals import SYSTEM_LETTERS, System, system_of
from plumbline_dtu.corrections import (
    EphemerisShelf,
    OffsetOf,
    corrections_at,
    integer_phase_biases,
    phase_centre_offsets,
    zero_code_biases,
)
from plumbline_dtu.encoding import ReceiverEncoder, as_received, correction_frames, ephemeris_frame, station_frames

_EPHEMERIS_REPEAT_NS: Final = 300 * NS_PER_S
_STATION_REPEAT_NS: Final = 60 * NS_PER_S
_BIAS_INTERVAL_S: Final = 60


@dataclass(frozen=True, slots=True)
class Conversion:
    """What to convert and how; intervals in seconds, one of :data:`UPDATE_INTERVALS_S`."""

    observations: Sequence[Path]
    navigation: Sequence[Path]
    out: Path
    orbits: Sequence[Path] = ()
    clocks: Sequence[Path] = ()
    antex: Path | None = None
    interval_s: float | None = None  # None: every epoch of the file
    correction_interval_s: int | None = None  # None: the epochs' own, at least 5, at most 30
    station_id: int = 1
    reference_ecef_m: tuple[float, float, float] | None = None  # of the marker; None: the file's own position
    systems: str = SYSTEM_LETTERS
    msm: int = 7
    max_epochs: int | None = None


@dataclass(slots=True)
class _Ephemerides:
    """Sends a satellite's set when it becomes the current one, and again every five minutes."""

    shelf: EphemerisShelf
    _sent: dict[int, tuple[Ephemeris, int]] = field(default_factory=dict)

    def current(self, t_gps_ns: int) -> dict[int, Ephemeris]:
        """The current sets by satellite."""
        found = {satellite: self.shelf.current(satellite, t_gps_ns) for satellite in self.shelf.satellites()}
        return {satellite: ephemeris for satellite, ephemeris in found.items() if ephemeris is not None}

    def due(self, t_gps_ns: int) -> list[Ephemeris]:
        """The sets to be sent now."""
        due = []
        for satellite, ephemeris in self.current(t_gps_ns).items():
            last, t_sent_ns = self._sent.get(satellite, (None, 0))
            if ephemeris is not last or t_gps_ns - t_sent_ns >= _EPHEMERIS_REPEAT_NS:
                self._sent[satellite] = (ephemeris, t_gps_ns)
                due.append(ephemeris)
        return due


def convert(conversion: Conversion, on_progress: Callable[[float], None] | None = None) -> dict[str, Any]:
    """Write the streams; returns what ``streams.json`` says. Raises FileFormatError and ConfigurationError."""
    conversion.out.mkdir(parents=True, exist_ok=True)
    counts: Counter[str] = Counter()
    ephemerides = _read_ephemerides(conversion, counts)
    first = RinexObservations(conversion.observations[0])
    header = first.header
    interval_s = _correction_interval_s(conversion, header)
    service = _Service.create(conversion, ephemerides, interval_s, first.header.t_first_gps_ns or 0, counts)
    receiver = _Receiver(conversion, header, ephemerides, counts)
    with (conversion.out / "observations.rtcm3").open("wb") as observations:
        corrections = (conversion.out / "corrections.rtcm3").open("wb") if service else None
        try:
            for epoch, fraction in _epochs(conversion):
                if service and corrections:
                    service.write_until(epoch.t_gps_ns, corrections)
                receiver.write(epoch, observations)
                if on_progress:
                    on_progress(fraction)
        finally:
            if corrections:
                corrections.close()
    summary = _summary(conversion, header, interval_s if service else None, counts)
    (conversion.out / "streams.json").write_text(json.dumps(summary, indent=2) + "\n", encoding="utf-8")
    return summary


def _epochs(conversion: Conversion) -> Any:
    """Epochs of all files on the wanted interval, of the wanted systems, with the fraction read."""
    wanted = [SYSTEM_LETTERS.index(letter) for letter in conversion.systems]
    step_ns = round((conversion.interval_s or 0) * NS_PER_S)
    count = 0
    for k, path in enumerate(conversion.observations):
        observations = RinexObservations(path)
        for epoch in observations:
            if step_ns and epoch.t_gps_ns % step_ns:
                continue
            if conversion.max_epochs is not None and count >= conversion.max_epochs:
                return
            count += 1
            yield _only(epoch, wanted), (k + observations.fraction) / len(conversion.observations)


def _only(epoch: Epoch, systems: list[int]) -> Epoch:
    keep = np.isin(epoch.satellite // 64, systems)
    if keep.all():
        return epoch
    names = [name for name in epoch.__slots__ if isinstance(getattr(epoch, name), np.ndarray)]
    others = {name: getattr(epoch, name) for name in epoch.__slots__ if name not in names}
    return Epoch(**others, **{name: getattr(epoch, name)[keep] for name in names})


def _read_ephemerides(conversion: Conversion, counts: Counter[str]) -> list[Ephemeris]:
    """Ephemerides as a server will have them; of Galileo I/NAV alone, so that an issue names one set."""
    kept: list[Ephemeris] = []
    for path in conversion.navigation:
        navigation = read_navigation(path)
        counts.update({f"navigation: {reason}": n for reason, n in navigation.skipped.items()})
        for ephemeris in navigation.ephemerides:
            if isinstance(ephemeris, KeplerEphemeris) and ephemeris.message == "FNAV":
                continue
            if system_of(ephemeris.satellite).letter not in conversion.systems:
                continue
            received = as_received(ephemeris)
            if received is None:
                counts["ephemeris that RTCM cannot carry"] += 1
            else:
                kept.append(received)
    return kept


def _correction_interval_s(conversion: Conversion, header: RinexObservationHeader) -> int:
    wanted = conversion.correction_interval_s
    if wanted is None:
        own = conversion.interval_s or header.interval_s or 5.0
        wanted = max(seconds for seconds in UPDATE_INTERVALS_S if seconds <= min(max(own, 5.0), 30.0))
    if wanted not in UPDATE_INTERVALS_S:
        raise ConfigurationError(f"no SSR update interval of {wanted} s: one of {UPDATE_INTERVALS_S}")
    return wanted


class _Receiver:
    """Writes what a receiver sends."""

    def __init__(
        self, conversion: Conversion, header: RinexObservationHeader, ephemerides: list[Ephemeris], counts: Counter[str]
    ) -> None:
        self._encoder = ReceiverEncoder(conversion.station_id, conversion.msm)
        self._ephemerides = _Ephemerides(EphemerisShelf(ephemerides))
        self._station = _station(conversion, header)
        self._station_sent_ns = -_STATION_REPEAT_NS
        self._counts = counts

    def write(self, epoch: Epoch, file: BinaryIO) -> None:
        """An epoch, and before it what is due by then."""
        for ephemeris in self._ephemerides.due(epoch.t_gps_ns):
            file.write(ephemeris_frame(ephemeris))
            self._counts["ephemerides sent by the receiver"] += 1
        if epoch.t_gps_ns - self._station_sent_ns >= _STATION_REPEAT_NS:
            file.writelines(self._station)
            self._station_sent_ns = epoch.t_gps_ns
        file.writelines(self._encoder.frames(epoch))
        self._counts["epochs"] += 1


def _station(conversion: Conversion, header: RinexObservationHeader) -> list[bytes]:
    up, east, north = header.antenna_delta_hen_m
    marker = np.array(conversion.reference_ecef_m or header.approximate_position_ecef_m or (0.0, 0.0, 0.0))
    reference_point = marker
    if marker.any():
        latitude, longitude, _ = geodetic_from_ecef(marker)
        reference_point = marker + rotation_enu_from_ecef(latitude, longitude).T @ np.array([east, north, up])
    x, y, z = (float(value) for value in reference_point)
    hardware = (header.antenna_type, header.antenna_serial, header.receiver_type)
    return station_frames(conversion.station_id, (x, y, z), up, *hardware)


@dataclass(slots=True)
class _Service:
    """Writes what a correction service sends."""

    tables: PreciseTables
    wide_lane_cycles: Mapping[int, float]  # by satellite id, where the clocks are integer-recovery clocks
    ephemerides: _Ephemerides
    offset_of: OffsetOf | None
    interval_s: int
    counts: Counter[str]
    next_ns: int
    biased: set[int] = field(default_factory=set)  # satellites that had biases when those were last sent

    @classmethod
    def create(
        cls,
        conversion: Conversion,
        ephemerides: list[Ephemeris],
        interval_s: int,
        t_first_gps_ns: int,
        counts: Counter[str],
    ) -> "_Service | None":
        """None without precise products; their SP3's own clocks serve where no clock file is given."""
        if not conversion.orbits:
            return None
        orbits, clocks = read_sp3(conversion.orbits)
        wide_lane_cycles: Mapping[int, float] = {}
        if conversion.clocks:
            files = read_clocks(conversion.clocks)
            clocks, wide_lane_cycles = files.clocks, files.wide_lane_cycles
        offset_of = None
        if conversion.antex is not None:
            book = build_antenna_book(read_antex(conversion.antex), t_first_gps_ns, None)
            offset_of = phase_centre_offsets(book)
        step_ns = interval_s * NS_PER_S
        shelf = _Ephemerides(EphemerisShelf(ephemerides))
        next_ns = t_first_gps_ns // step_ns * step_ns
        return cls(build_tables(orbits, clocks), wide_lane_cycles, shelf, offset_of, interval_s, counts, next_ns)

    def write_until(self, t_gps_ns: int, file: BinaryIO) -> None:
        """Everything up to and including a time."""
        while self.next_ns <= t_gps_ns:
            self._write(self.next_ns, file)
            self.next_ns += self.interval_s * NS_PER_S

    def _write(self, t_gps_ns: int, file: BinaryIO) -> None:
        for ephemeris in self.ephemerides.due(t_gps_ns):
            file.write(ephemeris_frame(ephemeris))
        current = self.ephemerides.current(t_gps_ns)
        header = SsrHeader(t_gps_ns, t_gps_ns, float(self.interval_s) if self.interval_s > 1 else 0.0, 0, 0, 0)
        for system in System:
            own = {satellite: e for satellite, e in current.items() if system_of(satellite) is system}
            correction = corrections_at(self.tables, own, header, self.offset_of)
            if not len(correction.orbit.satellite):
                continue
            file.writelines(correction_frames(correction.orbit))
            file.writelines(correction_frames(correction.clock))
            satellites = correction.orbit.satellite.tolist()
            if t_gps_ns // NS_PER_S % _BIAS_INTERVAL_S == 0 or not self.biased.issuperset(satellites):
                self._write_biases(header, satellites, file)
                self.biased = self.biased.difference(own).union(satellites)
            self.counts[f"corrections of {system.name}"] += len(correction.orbit.satellite)

    def _write_biases(self, header: SsrHeader, satellites: list[int], file: BinaryIO) -> None:
        phase_biases = integer_phase_biases(header, satellites, self.wide_lane_cycles)
        self.counts["phase biases"] += len(phase_biases.signal)
        file.writelines(correction_frames(zero_code_biases(header, satellites)))
        file.writelines(correction_frames(phase_biases))


def _summary(
    conversion: Conversion, header: RinexObservationHeader, interval_s: int | None, counts: Counter[str]
) -> dict[str, Any]:
    streams: dict[str, Any] = {"observations.rtcm3": {"carries": "1006, 1008, 1033, ephemerides, MSM7"}}
    if interval_s is not None:
        streams["corrections.rtcm3"] = {
            "carries": "ephemerides, SSR orbits, clocks, code biases of the clocks' reference signals"
            + (", phase biases" if counts["phase biases"] else ""),
            "reference_point": "centre_of_mass" if conversion.antex is None else "antenna_phase_centre",
            "interval_s": interval_s,
        }
    return {
        "streams": streams,
        "replay_order": list(reversed(streams)),
        "station_id": conversion.station_id,
        "marker": header.marker_name,
        "antenna_type": header.antenna_type,
        "antenna_height_m": header.antenna_delta_hen_m[0],
        "counts": dict(sorted(counts.items())),
    }
