"""A receiver of the experiment: its epochs, second by second, as MSM7 frames."""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

import numpy as np

from plumbline.constants import SPEED_OF_LIGHT_M_S
from plumbline.gnss.earth_frames import geodetic_from_ecef
from plumbline.gnss.troposphere import troposphere_site
from plumbline.gps_time import NS_PER_S
from plumbline.records import Booleans, Epoch, Floats, Ints, SatelliteIds, SignalIds
from plumbline.rtcm3 import encode_epoch, frame
from plumbline.signals import BAND_FREQUENCIES_HZ, SATELLITES_PER_SYSTEM, System, signal_id
from plumbline_dtu.encoding import ephemeris_frame, station_frames
from plumbline_dtu.shake_table.experiment import (
    GNSS_RATE_HZ,
    LONGITUDE_DEG,
    START_GPS_NS,
    Experiment,
    lever_arms_body_m,
    rotation_enu_from_body,
    table_motion,
)
from plumbline_dtu.shake_table.sight import Sight, sight
from plumbline_dtu.shake_table.sky import constellation, tracked, visible
from plumbline_dtu.shake_table.surroundings import Surroundings, multipath, surroundings
from plumbline_dtu.simulation.atmosphere import ionosphere_m, slant_tecu
from plumbline_dtu.simulation.constellation import clock_wave_s

BASE: Final = 0  # stations: 0 the base, 1, 2, 3 the antennas of the platform
_SIGNALS: Final = {System.GPS: "1C", System.BEIDOU: "2I"}
_STEP_NS: Final = NS_PER_S // GNSS_RATE_HZ
_LOCKED_BEFORE_S: Final = 300.0  # the receivers had been on when the recording began
_DESCRIPTION_INTERVAL_S: Final = 10
_EPHEMERIS_INTERVAL_S: Final = 60
_AMBIGUITIES: Final = 1000  # cycles either way
_NOT_LOCKED: Final = -1


@dataclass(frozen=True, slots=True)
class _Satellites:
    """What is fixed for a run: ids (s,), signals, wavelengths, packed true orbits, ambiguities."""

    satellite: SatelliteIds
    signal: SignalIds
    wavelength_m: Floats
    rows: Floats
    ambiguity: Floats


@dataclass(frozen=True, slots=True)
class _Errors:
    """Errors of phase, code and range rate (e, s)."""

    phase_m: Floats
    code_m: Floats
    range_rate_m_s: Floats


def antenna_enu_m(station: int) -> Floats:
    """An antenna of the platform at rest, from the IMU, (3,) ENU."""
    arm: Floats = rotation_enu_from_body() @ lever_arms_body_m()[station - 1]
    return arm


def antenna_ecef_m(experiment: Experiment, station: int) -> Floats:
    """A station's antenna at rest."""
    if station == BASE:
        return experiment.base_ecef_m
    return experiment.platform_ecef_m + experiment.enu.T @ antenna_enu_m(station)


def receive(experiment: Experiment, station: int) -> Iterator[tuple[int, bytes]]:
    """A station's bytes, (GPS time, frames), epoch by epoch."""
    for k, epoch in enumerate(observe(experiment, station)):
        second, part = divmod(k, GNSS_RATE_HZ)
        head = b"" if part else _head(experiment, station, epoch.satellite, second)
        yield epoch.t_gps_ns, head + b"".join(frame(payload) for payload in encode_epoch(epoch, 7, station))


def observe(experiment: Experiment, station: int) -> Iterator[Epoch]:
    """What a station measures, epoch by epoch."""
    satellites = _satellites(experiment, station)
    reflection = experiment.levels.base_reflection if station == BASE else experiment.levels.platform_reflection
    place_seed = [experiment.seed, 21, int(station == BASE)]  # the platform's antennas share its surroundings
    around = surroundings(len(satellites.satellite), reflection, place_seed)
    random = np.random.default_rng([experiment.seed, 22, station])
    since_ns = np.full(len(satellites.satellite), _NOT_LOCKED, np.int64)
    for second in range(round(experiment.schedule.duration_s)):
        times = START_GPS_NS + second * NS_PER_S + _STEP_NS * np.arange(GNSS_RATE_HZ, dtype=np.int64)
        seen, clock_s, clock_rate, moved = _geometry(experiment, station, satellites, times)
        errors = _errors(experiment, station, seen, satellites, around, moved, random)
        yield from _epochs(station, times, satellites, seen, clock_s, clock_rate, errors, since_ns)


def _satellites(experiment: Experiment, station: int) -> _Satellites:
    sky = constellation()
    keep = tracked(sky.satellites, beidou_2_only=station == 2)
    satellite = sky.satellites[keep]
    systems = [System(int(s) // SATELLITES_PER_SYSTEM) for s in satellite]
    signal = np.array([signal_id(system, _SIGNALS[system]) for system in systems], np.int16)
    frequency = np.array([BAND_FREQUENCIES_HZ[system][_SIGNALS[system][0]] for system in systems])
    random = np.random.default_rng([experiment.seed, 20, station])
    ambiguity = random.integers(-_AMBIGUITIES, _AMBIGUITIES, len(satellite)).astype(float)
    return _Satellites(satellite, signal, SPEED_OF_LIGHT_M_S / frequency, sky.rows()[keep], ambiguity)


def _clock(experiment: Experiment, station: int, times: Ints) -> tuple[Floats, Floats]:
    """Receiver clock offset, s, and rate, s/s: a wave of twenty minutes, another at every receiver."""
    w = 2.0 * np.pi / 1200.0
    phase = w * ((times - START_GPS_NS) / NS_PER_S) + experiment.seed + 1.7 * station
    size = experiment.levels.clock_s
    return size * np.sin(phase), size * w * np.cos(phase)


def _geometry(
    experiment: Experiment, station: int, satellites: _Satellites, times: Ints
) -> tuple[Sight, Floats, Floats, Floats]:
    """Sight, receiver clock and rate, and the antenna's place among its surroundings (e, 3), ENU."""
    clock_s, clock_rate = _clock(experiment, station, times)
    position = np.tile(antenna_ecef_m(experiment, station), (len(times), 1))
    velocity, moved = np.zeros((len(times), 3)), np.zeros((len(times), 3))
    if station != BASE:
        motion = table_motion(experiment.schedule, times)
        position += motion.displacement_m @ experiment.enu
        velocity = motion.velocity_m_s @ experiment.enu
        moved = antenna_enu_m(station) + motion.displacement_m
    place = geodetic_from_ecef(position[0])
    site = troposphere_site(place[0], place[1], place[2], START_GPS_NS)
    seen = sight(satellites.rows, times, clock_s, position, velocity, experiment.enu, site)
    return seen, clock_s, clock_rate, moved


def _errors(
    experiment: Experiment, station: int, seen: Sight, satellites: _Satellites, around: Surroundings, moved: Floats,
    random: np.random.Generator,
) -> _Errors:  # fmt: skip
    """White noise that grows with 1/sin of the elevation, and multipath."""
    levels = experiment.levels
    sine = np.maximum(np.sin(seen.elevation_rad), 0.1)
    factor = np.sqrt(0.5 + 0.5 / sine**2)
    white = random.normal(0.0, 1.0, (3, *sine.shape)) * factor
    phase_path, code_path = multipath(
        seen.unit_enu, moved, around.scatterer_enu_m, around.strength, around.phase_rad, satellites.wavelength_m
    )
    return _Errors(
        levels.phase_m * white[0] + phase_path,
        levels.code_m * white[1] + code_path,
        levels.range_rate_m_s * white[2],
    )


def _epochs(
    station: int, times: Ints, satellites: _Satellites, seen: Sight, clock_s: Floats, clock_rate: Floats,
    errors: _Errors, since_ns: Ints,
) -> Iterator[Epoch]:  # fmt: skip
    """The epochs of a second; ``since_ns`` keeps since when each satellite is locked."""
    waves = clock_wave_s(satellites.satellite[None, :], times[:, None])
    base = seen.range_m + SPEED_OF_LIGHT_M_S * (clock_s[:, None] - seen.clock_s - waves)
    tecu = slant_tecu(int(times[0]), np.radians(LONGITUDE_DEG), np.maximum(seen.elevation_rad, 0.05), seen.azimuth_rad)
    delay = ionosphere_m(tecu, SPEED_OF_LIGHT_M_S / satellites.wavelength_m)
    code = base + delay + errors.code_m
    phase = (base - delay + errors.phase_m) / satellites.wavelength_m + satellites.ambiguity
    rate = seen.range_rate_m_s + SPEED_OF_LIGHT_M_S * (clock_rate[:, None] - seen.clock_rate_s_s)
    doppler = -(rate + errors.range_rate_m_s) / satellites.wavelength_m
    cn0 = np.round(36.0 + 14.0 * np.sin(seen.elevation_rad), 2)
    up = visible(seen.azimuth_rad, seen.elevation_rad)
    for e, t_ns in enumerate(times.tolist()):
        at = np.flatnonzero(up[e])
        yield Epoch(
            t_gps_ns=t_ns,
            t_receive_ns=t_ns,
            satellite=satellites.satellite[at],
            signal=satellites.signal[at],
            pseudorange_m=code[e, at],
            carrier_phase_cycles=phase[e, at],
            doppler_hz=doppler[e, at],
            cn0_db_hz=cn0[e, at],
            lock_time_s=_lock_times(since_ns, t_ns, up[e])[at],
            half_cycle_ambiguous=np.zeros(len(at), bool),
            glonass_channel=np.zeros(len(at), np.int8),
            antenna=station,
        )


def _lock_times(since_ns: Ints, t_ns: int, up: Booleans) -> Floats:
    """Seconds of lock (s,); satellites that are not up lose theirs."""
    since_ns[~up] = _NOT_LOCKED
    before_ns = round(_LOCKED_BEFORE_S * NS_PER_S) if t_ns == START_GPS_NS else 0
    since_ns[up & (since_ns == _NOT_LOCKED)] = t_ns - before_ns
    times: Floats = (t_ns - since_ns) / NS_PER_S
    return times


def _head(experiment: Experiment, station: int, up: SatelliteIds, second: int) -> bytes:
    """Description and ephemerides, when due."""
    data = b""
    if second % _DESCRIPTION_INTERVAL_S == 0:
        x, y, z = (float(value) for value in antenna_ecef_m(experiment, station))
        data += b"".join(station_frames(station, (x, y, z), 0.0, "", "", "plumbline shake table"))
    if second % _EPHEMERIS_INTERVAL_S == 0:
        sets = constellation().broadcast(START_GPS_NS + second * NS_PER_S)
        data += b"".join(ephemeris_frame(sets[int(satellite)]) for satellite in up)
    return data
