"""The experiment's numbers (Dai 2024, section 3), and what the paper leaves open.

Stated there: place and day, sky mask, rates, frequencies, the base at 50 m, antennas 1 m apart in a triangle, the IMU's
table 1, the vibrations' frequencies, amplitudes and lengths, ten minutes of rest before and four between.

Left open there, chosen here: the direction of the table (azimuth 60°), the heading of the platform (25°, and half a
degree of tilt), the amplitudes of the mixed vibration (10 mm each), half a minute of rest between vibrations, a minute
for the fourth, two seconds of swelling and fading, the IMU 0.15 m below the antennas' plane, at the centre.
"""

import math
from dataclasses import dataclass, field
from typing import Final

import numpy as np

from plumbline.gnss.earth_frames import ecef_from_geodetic, rotation_enu_from_ecef
from plumbline.gps_time import NS_PER_S, gps_ns_from_calendar
from plumbline.records import Floats, Ints
from plumbline_dtu.simulation.motion import State

START_GPS_NS: Final = gps_ns_from_calendar(2023, 11, 13, 10, 0, 0)  # second 122,400 of the week, as the paper's figures
LATITUDE_DEG, LONGITUDE_DEG, HEIGHT_M = 22.3045, 114.1797, 32.0  # Hong Kong Polytechnic University
BASE_FROM_PLATFORM_ENU_M: Final = (-38.0, 30.0, 12.0)  # 50 m
GNSS_RATE_HZ: Final = 20
IMU_RATE_HZ: Final = 200
ANTENNA_SPACING_M: Final = 1.0
IMU_BELOW_ANTENNAS_M: Final = 0.15
TABLE_AZIMUTH_DEG: Final = 60.0
HEADING_DEG, PITCH_DEG, ROLL_DEG = 25.0, 0.4, -0.3
HEADING_SIGMA_DEG: Final = 0.1  # to which antennas 1 m apart, averaged at rest, give the heading to align an IMU with


@dataclass(frozen=True, slots=True)
class Vibration:
    """Sines along the table's direction, from ``start_s`` on: (amplitude m, frequency Hz) each."""

    start_s: float
    lasting_s: float
    parts: tuple[tuple[float, float], ...]
    ramp_s: float = 2.0  # swelling at the beginning, fading at the end


@dataclass(frozen=True, slots=True)
class Schedule:
    """Rest (period 1), then the vibrations (period 2)."""

    rest_s: float
    vibrations: tuple[Vibration, ...]
    duration_s: float


def schedule(
    rest_s: float = 600.0, minute_s: float = 60.0, pause_s: float = 30.0, between_s: float = 240.0
) -> Schedule:
    """The paper's schedule; shorter with other lengths (a vibration lasts ``minute_s``, the mixed one four)."""
    vibrations: list[Vibration] = []
    at_s = rest_s
    for repeat in range(2):
        for minutes, parts in _PROGRAMME:
            vibrations.append(Vibration(at_s, minutes * minute_s, parts))
            at_s += minutes * minute_s + pause_s
        at_s += (between_s - pause_s) if repeat == 0 else 0.0
    return Schedule(rest_s, tuple(vibrations), at_s)


_PROGRAMME: Final = (
    (1.0, ((0.019, 0.50),)),
    (1.0, ((0.017, 0.67),)),
    (4.0, ((0.010, 0.11), (0.010, 0.34))),
    (1.0, ((0.015, 0.80),)),
)


@dataclass(frozen=True, slots=True)
class Levels:
    """One-sigma errors. Receivers' noise and the base's surroundings are of their kind; the platform's are fitted.

    White phase noise: in the paper's table 3 the IMU, which takes off what is white, brings resting single antennas
    from 3.14 to 2.90 mm, so 1.2 mm of displacement is white; 1.4 mm at the zenith, growing with 1/sin, makes that (data
    sheets of such receivers, "< 1 mm precision in a 1 Hz bandwidth", allow 3.2 mm at 20 Hz). The base stands on an open
    roof: a reflected 0.12 makes the 2 mm of phase multipath that geodetic antennas have there. The platform's
    reflection is the one figure that is fitted: scheme G1 has to come out at the paper's 3.9 mm, on the mean of seeds
    1 to 10.
    """

    phase_m: float = 0.0014
    code_m: float = 0.25
    range_rate_m_s: float = 0.03
    platform_reflection: float = 0.467  # of the direct signal's amplitude at the horizon, root mean square
    base_reflection: float = 0.12
    clock_s: float = 3e-8


PERFECT: Final = Levels(0.0, 0.0, 0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class ImuErrors:
    """ATLANS-C as table 1 of Dai 2024 found it; biases at switching on are ten times their instability, τ = 1000 s."""

    acceleration_noise_m_s2_sqrt_hz: float = 0.046e-3 * 9.80665
    rate_noise_rad_s_sqrt_hz: float = math.radians(0.0035) / 60.0
    acceleration_instability_m_s2: float = 0.0241e-3 * 9.80665
    rate_instability_rad_s: float = math.radians(0.0084) / 3600.0
    start_factor: float = 10.0
    bias_time_s: float = 1000.0


PERFECT_IMU: Final = ImuErrors(0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True)
class Experiment:
    """One run of the experiment; everything random about it follows from the seed."""

    seed: int = 1
    schedule: Schedule = field(default_factory=schedule)
    levels: Levels = Levels()
    imu: ImuErrors = ImuErrors()

    @property
    def platform_ecef_m(self) -> Floats:
        """The IMU at rest."""
        place: Floats = ecef_from_geodetic(math.radians(LATITUDE_DEG), math.radians(LONGITUDE_DEG), HEIGHT_M)
        return place

    @property
    def enu(self) -> Floats:
        """Rotation (3, 3) from Earth-fixed to east, north, up."""
        rotation: Floats = rotation_enu_from_ecef(math.radians(LATITUDE_DEG), math.radians(LONGITUDE_DEG))
        return rotation

    @property
    def base_ecef_m(self) -> Floats:
        """The base's antenna."""
        place: Floats = self.platform_ecef_m + self.enu.T @ np.array(BASE_FROM_PLATFORM_ENU_M)
        return place


def lever_arms_body_m() -> Floats:
    """IMU to antennas 1, 2, 3 (3, 3), right, forward, up: an equilateral triangle about it, antenna 1 in front."""
    radius_m = ANTENNA_SPACING_M / math.sqrt(3.0)
    angles = np.radians([90.0, 210.0, 330.0])
    return np.column_stack([radius_m * np.cos(angles), radius_m * np.sin(angles), np.full(3, IMU_BELOW_ANTENNAS_M)])


def rotation_enu_from_body() -> Floats:
    """Attitude (3, 3) of the platform: heading clockwise from north, pitch forward end up, roll right side down."""
    h, p, r = (math.radians(angle) for angle in (HEADING_DEG, PITCH_DEG, ROLL_DEG))
    heading = np.array([[math.cos(h), math.sin(h), 0.0], [-math.sin(h), math.cos(h), 0.0], [0.0, 0.0, 1.0]])
    pitch = np.array([[1.0, 0.0, 0.0], [0.0, math.cos(p), -math.sin(p)], [0.0, math.sin(p), math.cos(p)]])
    roll = np.array([[math.cos(r), 0.0, math.sin(r)], [0.0, 1.0, 0.0], [-math.sin(r), 0.0, math.cos(r)]])
    rotation: Floats = heading @ pitch @ roll
    return rotation


def table_direction_enu() -> Floats:
    """Unit vector (3,) along which the table moves."""
    azimuth = math.radians(TABLE_AZIMUTH_DEG)
    return np.array([math.sin(azimuth), math.cos(azimuth), 0.0])


def table_motion(plan: Schedule, t_gps_ns: Ints) -> State:
    """Displacement, velocity and acceleration (n, 3), ENU, of the table at GPS times (n,)."""
    t_s = (t_gps_ns - START_GPS_NS) / NS_PER_S
    along = np.zeros((3, len(t_s)))
    for vibration in plan.vibrations:
        since_s = t_s - vibration.start_s
        at = np.flatnonzero((since_s > 0.0) & (since_s < vibration.lasting_s))
        if at.size:
            along[:, at] += _vibration(vibration, since_s[at])
    direction = table_direction_enu()
    return State(*(np.outer(values, direction) for values in along))


def _vibration(vibration: Vibration, since_s: Floats) -> Floats:
    """Displacement, velocity, acceleration (3, n) along the direction."""
    envelope, slope, bend = _envelope(vibration, since_s)
    out = np.zeros((3, len(since_s)))
    for amplitude, frequency in vibration.parts:
        w = 2.0 * math.pi * frequency
        sine, cosine = amplitude * np.sin(w * since_s), amplitude * w * np.cos(w * since_s)
        out[0] += envelope * sine
        out[1] += slope * sine + envelope * cosine
        out[2] += bend * sine + 2.0 * slope * cosine - envelope * w * w * sine
    return out


def _envelope(vibration: Vibration, since_s: Floats) -> tuple[Floats, Floats, Floats]:
    """A fifth-order step up and one down, and their derivatives."""
    ramp = vibration.ramp_s
    left = np.minimum(since_s, vibration.lasting_s - since_s)
    sign = np.where(since_s < 0.5 * vibration.lasting_s, 1.0, -1.0)
    x = np.clip(left / ramp, 0.0, 1.0)
    shape = x**3 * (10.0 - 15.0 * x + 6.0 * x * x)
    slope = 30.0 * x * x * (1.0 - x) ** 2 / ramp
    bend = 60.0 * x * (1.0 - x) * (1.0 - 2.0 * x) / ramp**2
    return shape, sign * slope, bend
