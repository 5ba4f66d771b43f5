"""A simulated station: an antenna with a known motion, a receiver with its errors, an accelerometer beside it."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Final

import numpy as np
from numpy.typing import NDArray

from plumbline.constants import SPEED_OF_LIGHT_M_S
from plumbline.gnss.antenna import empty_antenna_book
from plumbline.gnss.earth_frames import geodetic_from_ecef, rotation_enu_from_ecef
from plumbline.gnss.line_of_sight import LineOfSight, line_of_sight_model
from plumbline.gnss.satellite_states import broadcast_at_transmission
from plumbline.gnss.sun_moon import sun_moon_ecef
from plumbline.gnss.tides import solid_earth_tide_ecef_m
from plumbline.gnss.troposphere import ZENITH_WET, troposphere_site
from plumbline.gps_time import NS_PER_S, gps_minus_utc_s
from plumbline.records import Epoch, Floats
from plumbline.signals import BAND_FREQUENCIES_HZ, System, signal_code, signal_id
from plumbline_dtu.encoding import ReceiverEncoder, ephemeris_frame, inertial_frame, station_frames
from plumbline_dtu.simulation.accelerometer import Accelerometer, Sampler
from plumbline_dtu.simulation.atmosphere import (
    CorrelatedNoise,
    ionosphere_m,
    repeating_multipath,
    slant_tecu,
    wet_departure_m,
)
from plumbline_dtu.simulation.constellation import Constellation, clock_wave_s
from plumbline_dtu.simulation.motion import Motion, static

SIGNALS: Final = {System.GPS: ("1C", "1W", "2W"), System.GALILEO: ("1C", "5Q"), System.BEIDOU: ("2I", "6I")}
_MAX_SAMPLES: Final = 112  # of an accelerometer in one frame
_DESCRIPTION_INTERVAL_S: Final = 10
_EPHEMERIS_INTERVAL_S: Final = 60
_FIRST_RANGE_M: Final = 2.3e7
_ITERATIONS: Final = 4


@dataclass(frozen=True, slots=True)
class Errors:
    """Errors of a receiver and its surroundings, one sigma at the zenith; all zero makes a perfect one."""

    code_m: float = 0.20
    phase_m: float = 0.0015
    code_multipath_m: float = 0.25  # correlated over a minute; as much again repeats with the geometry
    phase_multipath_m: float = 0.0015
    ionosphere: bool = True
    wet_delay: bool = True  # departures from the climatological delay, which is always there
    clock_s: float = 3e-8
    slips_per_hour: float = 0.0  # per signal
    lost_epochs: float = 0.0  # probability that an epoch does not come


PERFECT: Final = Errors(0.0, 0.0, 0.0, 0.0, False, False, 0.0)


@dataclass(frozen=True, slots=True)
class StationPlan:
    """What a station is: marker, motion, rates, errors, sensor, and the seed of its randomness."""

    name: str
    marker_ecef_m: tuple[float, float, float]
    motion: Motion = field(default_factory=static)
    antenna_motion: Motion = field(default_factory=static)  # that only the receiver shows: nothing else moves with it
    errors: Errors = Errors()
    epoch_rate_hz: int = 1
    accelerometer: Accelerometer | None = None
    accelerometer_rate_hz: int = 100
    antenna_height_m: float = 0.0
    elevation_mask_rad: float = 0.1
    station_id: int = 1
    sends_ephemerides: bool = True
    seed: int = 1


class Receiver:
    """Makes a station's epochs in order."""

    def __init__(self, plan: StationPlan, constellation: Constellation) -> None:
        self._plan, self._constellation = plan, constellation
        self._rows = constellation.rows()
        self._marker = np.array(plan.marker_ecef_m)
        place = geodetic_from_ecef(self._marker)
        self._longitude_rad = float(place[1])
        self._place = (float(place[0]), float(place[1]), float(place[2]))
        self._enu = rotation_enu_from_ecef(place[0], place[1])
        self._random = np.random.default_rng([plan.seed, 11])
        self._code_path = CorrelatedNoise(np.random.default_rng([plan.seed, 12]), 60.0)
        self._phase_path = CorrelatedNoise(np.random.default_rng([plan.seed, 13]), 60.0)
        self._windup = np.full(len(constellation.satellites), np.nan)
        self._ambiguity: dict[int, int] = {}
        self._site: tuple[int, Floats] | None = None
        n = len(constellation.satellites)
        self._bands = np.zeros((n, 1), np.int8)
        self._antennas = empty_antenna_book()
        self._range_m = np.full(n, _FIRST_RANGE_M)

    def truth_ecef_m(self, t_gps_ns: int) -> Floats:
        """The antenna reference point, tides and motion in it."""
        leap_s = gps_minus_utc_s(t_gps_ns)
        sun, moon = sun_moon_ecef(t_gps_ns, leap_s)
        tide = solid_earth_tide_ecef_m(self._marker, sun, moon, t_gps_ns, leap_s)
        at = np.array([t_gps_ns])
        moved = self._plan.motion(at).displacement_m[0] + self._plan.antenna_motion(at).displacement_m[0]
        offset = moved + np.array([0.0, 0.0, self._plan.antenna_height_m])
        point: Floats = self._marker + tide + self._enu.T @ offset
        return point

    def _troposphere(self, t_gps_ns: int) -> Floats:
        hour = t_gps_ns // (3600 * NS_PER_S)
        if self._site is None or self._site[0] != hour:
            self._site = hour, troposphere_site(*self._place, t_gps_ns)
        return self._site[1]

    def _clock(self, t_gps_ns: int) -> tuple[float, float]:
        """Receiver clock offset, s, and rate, s/s: a wave of twenty minutes."""
        w = 2.0 * np.pi / 1200.0
        phase = w * ((t_gps_ns % (1200 * NS_PER_S)) / NS_PER_S) + self._plan.seed
        size = self._plan.errors.clock_s
        return size * float(np.sin(phase)), size * w * float(np.cos(phase))

    def _geometry(self, t_gps_ns: int, clock_s: float) -> tuple[LineOfSight, Floats, Floats]:
        """Lines of sight, and the satellites' clocks and clock rates, s, at transmission."""
        satellites = self._constellation.satellites
        times = np.full(len(satellites), t_gps_ns, np.int64)
        velocity = self._enu.T @ self._plan.motion(np.array([t_gps_ns])).velocity_m_s[0]
        position = self.truth_ecef_m(t_gps_ns)
        site = self._troposphere(t_gps_ns)
        sun, _ = sun_moon_ecef(t_gps_ns, gps_minus_utc_s(t_gps_ns))
        for _ in range(_ITERATIONS):
            states = broadcast_at_transmission(self._rows, t_gps_ns, self._range_m)
            sight = line_of_sight_model(
                states, satellites, self._bands, position, velocity, site, sun, self._windup, self._antennas, False
            )
            satellite_clock = states.clock_s + clock_wave_s(satellites, times)
            self._range_m = sight.range_m + SPEED_OF_LIGHT_M_S * (clock_s - satellite_clock)
        visible = sight.elevation_rad > 0.0
        self._windup = np.where(visible, sight.windup_cycles, np.nan)
        return sight, satellite_clock, states.clock_rate_s_s

    def epoch(self, t_gps_ns: int) -> Epoch:
        """The observations at a receiver time tag."""
        plan, errors = self._plan, self._plan.errors
        clock_s, clock_rate = self._clock(t_gps_ns)
        sight, satellite_clock, satellite_rate = self._geometry(t_gps_ns, clock_s)
        up = np.flatnonzero(sight.elevation_rad > plan.elevation_mask_rad)
        satellite, signal, index = self._cells(up)
        frequency = np.array([BAND_FREQUENCIES_HZ[System(s // 64)][signal_code(int(i))[0]] for s, i in
                              zip(satellite, signal, strict=True)])  # fmt: skip
        wavelength = SPEED_OF_LIGHT_M_S / frequency
        wet = float(self._troposphere(t_gps_ns)[ZENITH_WET])
        wet += wet_departure_m(t_gps_ns, plan.seed) if errors.wet_delay else 0.0
        base = (sight.range_m + sight.shapiro_m + sight.hydrostatic_m + sight.wet_mapping * wet)[index]
        base = base + SPEED_OF_LIGHT_M_S * (clock_s - satellite_clock[index])
        delay = np.zeros(len(index))
        if errors.ionosphere:
            tecu = slant_tecu(t_gps_ns, self._longitude_rad, sight.elevation_rad, sight.azimuth_rad)
            delay = ionosphere_m(tecu[index], frequency)
        code_error, phase_error = self._noise(sight, satellite, signal, index)
        slipped = self._slips(satellite, signal)
        ambiguity = np.array([self._ambiguity[_key(s, i)] for s, i in zip(satellite, signal, strict=True)])
        phase = (base - delay + phase_error) / wavelength + sight.windup_cycles[index] + ambiguity
        rate = sight.range_rate_m_s[index] + SPEED_OF_LIGHT_M_S * (clock_rate - satellite_rate[index])
        n = len(index)
        return Epoch(
            t_gps_ns=t_gps_ns,
            t_receive_ns=t_gps_ns,
            satellite=satellite,
            signal=signal,
            pseudorange_m=base + delay + code_error,
            carrier_phase_cycles=phase,
            doppler_hz=-rate / wavelength,
            cn0_db_hz=np.round(30.0 + 20.0 * np.sin(sight.elevation_rad[index]), 2),
            lock_time_s=np.full(n, np.nan),
            half_cycle_ambiguous=np.zeros(n, bool),
            glonass_channel=np.zeros(n, np.int8),
            antenna=plan.station_id,
            loss_of_lock=slipped,
        )

    def _cells(self, up: NDArray[np.intp]) -> tuple[NDArray[np.int16], NDArray[np.int16], NDArray[np.intp]]:
        """(satellite, signal, index of the satellite) of every observation."""
        rows = []
        for k in up:
            satellite = int(self._constellation.satellites[k])
            system = System(satellite // 64)
            rows += [(satellite, signal_id(system, code) or 0, int(k)) for code in SIGNALS[system]]
        table = np.array(sorted(rows), np.int64).reshape(-1, 3)
        return table[:, 0].astype(np.int16), table[:, 1].astype(np.int16), table[:, 2].astype(np.intp)

    def _noise(
        self, sight: LineOfSight, satellite: NDArray[np.int16], signal: NDArray[np.int16], index: NDArray[np.intp]
    ) -> tuple[Floats, Floats]:
        """Errors of code and phase, m: white by 1/sin(elevation), and multipath, correlated and repeating."""
        errors, step_s = self._plan.errors, 1.0 / self._plan.epoch_rate_hz
        elevation, azimuth = sight.elevation_rad[index], sight.azimuth_rad[index]
        keys = [_key(s, i) for s, i in zip(satellite, signal, strict=True)]
        low = np.cos(elevation)
        weight = 1.0 / np.maximum(np.sin(elevation), 0.1)
        again = repeating_multipath(azimuth, elevation, 0)
        code = errors.code_m * weight * self._random.normal(0.0, 1.0, len(keys))
        code += errors.code_multipath_m * (low * self._code_path.next(keys, step_s) + again)
        phase = errors.phase_m * weight * self._random.normal(0.0, 1.0, len(keys))
        phase += errors.phase_multipath_m * (low * self._phase_path.next(keys, step_s) + again)
        return code, phase

    def _slips(self, satellite: NDArray[np.int16], signal: NDArray[np.int16]) -> NDArray[np.bool_]:
        """Give new signals an ambiguity and let others slip; returns which did, as the receiver flags it."""
        probability = self._plan.errors.slips_per_hour / (3600.0 * self._plan.epoch_rate_hz)
        chance = self._random.random(len(satellite))
        slipped = np.zeros(len(satellite), bool)
        for k, key in enumerate(_key(s, i) for s, i in zip(satellite, signal, strict=True)):
            if key not in self._ambiguity:
                self._ambiguity[key] = int(self._random.integers(-1_000_000, 1_000_000))
            elif chance[k] < probability:
                self._ambiguity[key] += int(self._random.choice([-3, -2, -1, 1, 2, 3]))
                slipped[k] = True
        return slipped


def _key(satellite: int, signal: int) -> int:
    return int(satellite) * 1000 + int(signal)


def simulate_station(
    plan: StationPlan, constellation: Constellation, t_first_gps_ns: int, t_last_gps_ns: int
) -> Iterator[tuple[int, bytes]]:
    """A station's bytes, (GPS time at which they are sent, bytes), from one whole second to another.

    Each second: description and ephemerides when due, the epochs at their times, and the second's inertial samples at
    its end.
    """
    receiver, encoder = Receiver(plan, constellation), ReceiverEncoder(plan.station_id)
    sampler = None
    if plan.accelerometer is not None:
        sampler = Sampler(plan.accelerometer, plan.motion, plan.accelerometer_rate_hz, plan.seed)
    lost = np.random.default_rng([plan.seed, 14])
    first_s, last_s = -(-t_first_gps_ns // NS_PER_S), t_last_gps_ns // NS_PER_S
    for second in range(first_s, last_s + 1):
        t_ns = second * NS_PER_S
        head = _head(plan, constellation, t_ns, second == first_s)
        for k in range(plan.epoch_rate_hz):
            t_epoch_ns = t_ns + k * NS_PER_S // plan.epoch_rate_hz
            frames = b"".join(encoder.frames(receiver.epoch(t_epoch_ns)))
            if lost.random() >= plan.errors.lost_epochs:
                yield t_epoch_ns, head + frames
                head = b""
        if sampler is not None:
            yield t_ns + NS_PER_S, _samples(sampler, plan, t_ns)


def _head(plan: StationPlan, constellation: Constellation, t_gps_ns: int, first: bool) -> bytes:
    second, data = t_gps_ns // NS_PER_S, b""
    if first or second % _DESCRIPTION_INTERVAL_S == 0:
        up = rotation_enu_from_ecef(*geodetic_from_ecef(np.array(plan.marker_ecef_m))[:2])[2]
        x, y, z = (float(v) for v in np.array(plan.marker_ecef_m) + up * plan.antenna_height_m)
        frames = station_frames(plan.station_id, (x, y, z), plan.antenna_height_m, "", "", "plumbline simulation")
        data += b"".join(frames)
    if plan.sends_ephemerides and (first or second % _EPHEMERIS_INTERVAL_S == 0):
        data += b"".join(ephemeris_frame(e) for e in constellation.broadcast(t_gps_ns).values())
    return data


def _samples(sampler: Sampler, plan: StationPlan, t_gps_ns: int) -> bytes:
    rate, data = plan.accelerometer_rate_hz, b""
    for first in range(0, rate, _MAX_SAMPLES):
        block = sampler.block(t_gps_ns, first, min(_MAX_SAMPLES, rate - first))
        data += inertial_frame(block, plan.station_id)
    return data
