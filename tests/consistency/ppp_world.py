"""A made-up sky and receiver whose every error is known: circular orbits, exact clocks, drawn noise."""

from dataclasses import dataclass, field

import numpy as np

from plumbline.config import PositioningSettings
from plumbline.constants import EARTH_ROTATION_RATE_RAD_S, SPEED_OF_LIGHT_M_S
from plumbline.gnss.line_of_sight import line_of_sight_model
from plumbline.gnss.orbits_broadcast import SatelliteStates as KernelStates
from plumbline.gnss.troposphere import ZENITH_HYDROSTATIC
from plumbline.positioning.facts import StationFacts
from plumbline.positioning.gather import site_of
from plumbline.positioning.ppp_noise import tuning_of
from plumbline.positioning.satellites import Cause, SatelliteStates, SignalBiases
from plumbline.records import Epoch
from plumbline.signals import FREQUENCY_HZ, System, satellite_id, signal_id, system_of

T0_NS = 1_277_000_000 * 1_000_000_000
MARKER_M = np.array([3582104.7628, 532590.1800, 5232755.1333])
SIGNALS = {System.GPS: ("1W", "2W"), System.GALILEO: ("1C", "5Q")}
_GM = 3.986004418e14


def _elements(system):
    """(radius, inclination, node, phase) of a system's satellites."""
    planes, slots, radius, tilt = (6, 4, 26_560e3, 55.0) if system is System.GPS else (3, 8, 29_600e3, 56.0)
    return [
        (radius, np.radians(tilt), 2 * np.pi * k / planes + 0.3 * system, 2 * np.pi * j / slots + 0.7 * k)
        for k in range(planes)
        for j in range(slots)
    ]


def transmitted(satellites, t_ns, code_m):
    """Positions and velocities (n, 3) at the transmission of signals received at a time with codes (n,)."""
    flight_ns = np.round(code_m / SPEED_OF_LIGHT_M_S * 1e9).astype(np.int64)
    found = [orbit(int(s), t_ns - int(f)) for s, f in zip(satellites, flight_ns, strict=True)]
    return tuple(np.array([pair[i] for pair in found]).reshape(-1, 3) for i in (0, 1))


def orbit(satellite, t_ns):
    """Earth-fixed position and velocity of a circular orbit."""
    radius, tilt, node, phase = _elements(system_of(satellite))[satellite % 64]
    t = (t_ns - T0_NS) * 1e-9
    rate = np.sqrt(_GM / radius**3)
    u, turned = phase + rate * t, node - EARTH_ROTATION_RATE_RAD_S * t
    plane = np.array([np.cos(u), np.sin(u), 0.0])
    along = np.array([-np.sin(u), np.cos(u), 0.0])
    c, s, ci, si = np.cos(turned), np.sin(turned), np.cos(tilt), np.sin(tilt)
    rotation = np.array([[c, -s * ci, s * si], [s, c * ci, -c * si], [0.0, si, ci]])
    position = radius * rotation @ plane
    spin = EARTH_ROTATION_RATE_RAD_S * np.array([position[1], -position[0], 0.0])
    return position, radius * rate * rotation @ along + spin


@dataclass
class Sky:
    """A source of exact orbits and zero clocks; what it withholds can be set."""

    systems: tuple = (System.GPS, System.GALILEO)
    cause: dict = field(default_factory=dict)  # system -> Cause of all its satellites
    age_s: float = np.nan
    only: set | None = None  # satellites that have corrections; None: all
    satellites: np.ndarray = field(init=False)

    def __post_init__(self):
        ids = [satellite_id(s, k + 1) for s in self.systems for k in range(24)]
        self.satellites = np.array(sorted(ids), np.int16)

    def _states(self, t_gps_ns, satellite, range_m, cause):
        found = [
            orbit(int(s), t_gps_ns - round(r / SPEED_OF_LIGHT_M_S * 1e9))
            for s, r in zip(satellite, range_m, strict=True)
        ]
        position = np.array([f[0] for f in found]).reshape(-1, 3)
        velocity = np.array([f[1] for f in found]).reshape(-1, 3)
        position[cause != 0] = np.nan
        n = satellite.size
        clock = np.where(cause == 0, 0.0, np.nan)
        return SatelliteStates(
            satellite, cause, position, velocity, clock, np.full(n, 0.02), np.full(n, self.age_s), False, 30.0
        )

    def precise(self, t_gps_ns, t_receive_ns, satellite, range_m):
        cause = np.array([self.cause.get(system_of(int(s)), Cause.USABLE) for s in satellite], np.int8)
        if self.only is not None:
            cause[[int(s) not in self.only for s in satellite]] = Cause.NO_CORRECTIONS
        return self._states(t_gps_ns, satellite, range_m, cause)

    def broadcast(self, t_gps_ns, t_receive_ns, satellite, range_m):
        return self._states(t_gps_ns, satellite, range_m, np.zeros(satellite.size, np.int8))

    def biases(self, t_gps_ns, t_receive_ns, satellite, signal, *, precise):
        n = satellite.size
        return SignalBiases(np.zeros(n), np.full(n, np.nan), np.full(n, -1, np.int16))

    def glonass_channels(self, t_receive_ns, satellite):
        return np.zeros(satellite.size, np.int8)


class Receiver:
    """Observes the sky with errors drawn as the filter's noise model says; ``noise`` 0 switches them off."""

    def __init__(self, sky, settings, seed=0, interval_s=30.0, noise=1.0, motion_m=lambda t_s: np.zeros(3)):
        self.sky, self.tuning, self.rng = sky, tuning_of(settings), np.random.default_rng(seed)
        self.interval_s, self.noise, self.motion_m = interval_s, noise, motion_m
        self.mask = np.radians(settings.elevation_mask_deg)
        self.facts = StationFacts("made-up", tuple(MARKER_M))
        n = sky.satellites.size
        bias = [self.tuning.gps_bias_m if s < 64 else self.tuning.galileo_bias_m for s in sky.satellites]
        self.code_bias_m = noise * self.rng.normal(size=n) * np.array(bias)
        self.cycles = self.rng.integers(-10_000, 10_000, (n, 2))
        self.slow_m = np.zeros(n)
        self.wet_m = 0.12 + noise * 0.06 * self.rng.normal()
        self.gradient_m = noise * 0.0005 * self.rng.normal(size=2)
        self.clock_m = {s: 1e4 * self.rng.normal() for s in sky.systems}
        self.wind_up = np.full(n, np.nan)
        self.code_jump_m = 0.0
        self.k = -1

    def _walk(self):
        root = np.sqrt(self.interval_s) * self.noise
        self.wet_m += self.rng.normal() * self.tuning.zenith_delay_m_sqrt_s * root
        self.gradient_m += self.rng.normal(size=2) * self.tuning.gradient_m_sqrt_s * root
        self.slow_m += self.rng.normal(size=self.slow_m.size) * self.tuning.ambiguity_error_m_sqrt_s * root
        common = 3.0 * self.rng.normal()
        for system in self.clock_m:
            self.clock_m[system] += common + self.rng.normal() * self.tuning.system_clock_m_sqrt_s * root

    def marker_m(self):
        """Where the marker is at the last epoch."""
        return MARKER_M + self.motion_m(self.k * self.interval_s)

    def observe(self, skip=0):
        """The next epoch, ``skip`` intervals left out before it."""
        for _ in range(skip + 1):
            self.k += 1
            self._walk()
        t_ns = T0_NS + round(self.k * self.interval_s * 1e9)
        site = site_of(self.marker_m(), self.facts, t_ns)
        sight, range_m = self._sight(t_ns, site)
        rows = [self._rows(i, sight, range_m) for i in np.flatnonzero(sight.elevation_rad > self.mask)]
        flat = [row for pair in rows for row in pair]
        columns = [np.array(c) for c in zip(*flat, strict=True)]
        n = len(flat)
        return Epoch(
            t_ns, t_ns, columns[0].astype(np.int16), columns[1].astype(np.int16), columns[2], columns[3],
            np.full(n, np.nan), np.full(n, 45.0), np.full(n, np.nan), np.zeros(n, np.bool_), np.zeros(n, np.int8),
            loss_of_lock=np.zeros(n, np.bool_),
        )  # fmt: skip

    def _sight(self, t_ns, site):
        satellites = self.sky.satellites
        n = satellites.size
        clock = np.array([self.clock_m[system_of(int(s))] for s in satellites])
        code_m = np.full(n, 2.4e7)
        for _ in range(3):  # the time of transmission follows from the code, which follows from the range
            found = [
                orbit(int(s), t_ns - round(c / SPEED_OF_LIGHT_M_S * 1e9))
                for s, c in zip(satellites, code_m, strict=True)
            ]
            position, velocity = (np.array([f[i] for f in found]) for i in (0, 1))
            states = KernelStates(position, velocity, np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(n, np.int64))
            sight = line_of_sight_model(
                states, satellites, np.zeros((n, 2), np.int8), site.reference_point_ecef_m, np.zeros(3),
                site.troposphere, site.sun_ecef_m, self.wind_up, self.facts.antennas, False,
            )  # fmt: skip
            code_m = sight.range_m + clock + self.code_jump_m + 8.0
        self.wind_up = sight.windup_cycles
        dry = site.troposphere[ZENITH_HYDROSTATIC]
        assert dry > 1.0
        slant = sight.hydrostatic_m + sight.wet_mapping * self.wet_m
        slant = slant + sight.gradient_north * self.gradient_m[0] + sight.gradient_east * self.gradient_m[1]
        return sight, sight.range_m + sight.shapiro_m + slant + clock

    def _rows(self, i, sight, range_m):
        satellite = int(self.sky.satellites[i])
        system = system_of(satellite)
        sine = np.sin(sight.elevation_rad[i])
        first_delay_m = 3.0 / np.sqrt(1.0 - (0.94 * np.cos(sight.elevation_rad[i])) ** 2)
        rows = []
        for j, code in enumerate(SIGNALS[system]):
            signal = signal_id(system, code)
            f = FREQUENCY_HZ[signal]
            delay_m = first_delay_m * (FREQUENCY_HZ[signal_id(system, SIGNALS[system][0])] / f) ** 2
            code_noise, phase_noise = self.noise * self.rng.normal(size=2) / sine
            range_code = range_m[i] + delay_m + self.code_bias_m[i] + code_noise * self.tuning.code_sigma_m
            range_phase = range_m[i] - delay_m + self.slow_m[i] + phase_noise * self.tuning.phase_sigma_m
            cycles = range_phase * f / SPEED_OF_LIGHT_M_S + sight.windup_cycles[i] + self.cycles[i, j]
            rows.append((satellite, signal, range_code + self.code_jump_m, cycles))
        return rows


def settings_of(**changes):
    """Settings of a test."""
    return PositioningSettings(systems="GE", **changes)
