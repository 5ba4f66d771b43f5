"""Everything that lies between a satellite and a receiver, for a whole epoch in one kernel.

Model of a phase range, metres (positive terms lengthen it)::

    range + shapiro + hydrostatic + wet_mapping · zenith_wet + gradient_north · G_n + gradient_east · G_e
          + antenna (per band) + wavelength · windup + c · (receiver clock − satellite clock) ∓ ionosphere + ambiguity
"""

import math
from typing import Final, NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from plumbline.constants import EARTH_ROTATION_RATE_RAD_S, SPEED_OF_LIGHT_M_S
from plumbline.gnss.antenna import AntennaBook, receiver_antenna_m, satellite_antenna_m
from plumbline.gnss.attitude import ORBIT_NORMAL, body_axes, in_shadow
from plumbline.gnss.earth_frames import geodetic_from_ecef, rotation_enu_from_ecef
from plumbline.gnss.orbits_broadcast import SatelliteStates
from plumbline.gnss.relativity import shapiro_delay_m
from plumbline.gnss.troposphere import ZENITH_HYDROSTATIC, map_troposphere
from plumbline.gnss.windup import windup_cycles
from plumbline.records import Booleans, Floats, SatelliteIds
from plumbline.signals import SATELLITES_PER_SYSTEM

_ORBIT_NORMAL: Final = ORBIT_NORMAL


class LineOfSight(NamedTuple):
    """Per satellite (n,); NaN where the satellite's state is not there."""

    range_m: Floats  # geometric, the Earth's turn during flight in it
    range_rate_m_s: Floats  # of the range, against an Earth-fixed receiver of the given velocity
    unit_ecef: Floats  # (n, 3) receiver → satellite: the range's partials to the receiver's position are its negative
    azimuth_rad: Floats
    elevation_rad: Floats
    shapiro_m: Floats
    hydrostatic_m: Floats  # slant
    wet_mapping: Floats
    gradient_north: Floats
    gradient_east: Floats
    windup_cycles: Floats  # hand it back as previous_windup_cycles at the next epoch
    antenna_m: Floats  # (n, bands): satellite and receiver phase centres
    eclipsed: Booleans  # nominal yaw does not hold: wind-up and x, y offsets are unsure


@njit(cache=True)
def light_time_range(position: Floats, receiver: Floats, turned: Floats) -> float:
    """Range, m, from an Earth-fixed position at transmission to a receiver at reception (3,).

    ``turned`` (3,) is filled with the satellite's position in the Earth-fixed frame of reception: the Earth turns once,
    during the flight, which is found by iteration (IS-GPS-200, 20.3.3.4.3.3.2).
    """
    flight_s = 0.07
    distance = 0.0
    for _ in range(3):
        angle = EARTH_ROTATION_RATE_RAD_S * flight_s
        s, c = math.sin(angle), math.cos(angle)
        turned[0] = c * position[0] + s * position[1]
        turned[1] = -s * position[0] + c * position[1]
        turned[2] = position[2]
        dx, dy, dz = turned[0] - receiver[0], turned[1] - receiver[1], turned[2] - receiver[2]
        distance = math.sqrt(dx * dx + dy * dy + dz * dz)
        flight_s = distance / SPEED_OF_LIGHT_M_S
    return distance


@njit(cache=True)
def light_time_range_rate(
    turned: Floats, velocity: Floats, unit: Floats, range_m: float, receiver_velocity: Floats
) -> float:
    """Rate of :func:`light_time_range` with the time of reception, m/s.

    The satellite's velocity is Earth-fixed at transmission; the rate of the flight time, which both delays the
    satellite and turns the Earth, is solved for.
    """
    angle = EARTH_ROTATION_RATE_RAD_S * range_m / SPEED_OF_LIGHT_M_S
    s, c = math.sin(angle), math.cos(angle)
    vx, vy = c * velocity[0] + s * velocity[1], -s * velocity[0] + c * velocity[1]
    along = unit[0] * vx + unit[1] * vy + unit[2] * velocity[2]
    turning = EARTH_ROTATION_RATE_RAD_S * (unit[0] * turned[1] - unit[1] * turned[0])
    own = unit[0] * receiver_velocity[0] + unit[1] * receiver_velocity[1] + unit[2] * receiver_velocity[2]
    return float((along - own) / (1.0 + (along - turning) / SPEED_OF_LIGHT_M_S))


@njit(cache=True)
def _empty(n: int, bands: int) -> LineOfSight:
    nan = np.full((9, n), np.nan)
    return LineOfSight(
        nan[0], nan[1], np.full((n, 3), np.nan), nan[2], nan[3], nan[4], nan[5], nan[6], nan[7], nan[8],
        np.full(n, np.nan), np.zeros((n, bands)), np.zeros(n, np.bool_),
    )  # fmt: skip


@njit(cache=True)
def line_of_sight_model(
    states: SatelliteStates,
    satellite: SatelliteIds,
    bands: NDArray[np.int8],
    receiver_ecef_m: Floats,
    receiver_velocity_ecef_m_s: Floats,
    troposphere: Floats,
    sun_ecef_m: Floats,
    previous_windup_cycles: Floats,
    antennas: AntennaBook,
    satellite_antennas_apply: bool,
) -> LineOfSight:
    """Model of n satellites as seen from one receiver; see :class:`LineOfSight`.

    ``states`` at transmission; ``satellite`` ids (n,) int16; ``bands`` (n, f) int8, RINEX bands whose antenna
    corrections are wanted; receiver (the antenna reference point, tides added) and its velocity (3,), Earth-fixed;
    ``troposphere`` a site row (:func:`plumbline.gnss.troposphere.troposphere_site`); the Sun (3,); the last epoch's
    wind-up (n,), NaN where an arc begins; ``satellite_antennas_apply``: True where states are centres of mass (SP3),
    False for phase centres (broadcast, most SSR).
    """
    n, f = bands.shape
    out = _empty(n, f)
    place = geodetic_from_ecef(receiver_ecef_m)
    enu = rotation_enu_from_ecef(place[0], place[1])
    receiver_radius = math.sqrt(np.dot(receiver_ecef_m, receiver_ecef_m))
    turned, unit_enu = np.empty(3), np.empty(3)
    for i in range(n):
        if states.status[i] != 0:
            continue
        position, velocity = states.position_ecef_m[i], states.velocity_ecef_m_s[i]
        rho = light_time_range(position, receiver_ecef_m, turned)
        unit = (turned - receiver_ecef_m) / rho
        for k in range(3):
            unit_enu[k] = enu[k, 0] * unit[0] + enu[k, 1] * unit[1] + enu[k, 2] * unit[2]
        azimuth = math.atan2(unit_enu[0], unit_enu[1]) % (2.0 * math.pi)
        elevation = math.asin(min(1.0, max(-1.0, unit_enu[2])))
        mapped = map_troposphere(troposphere, azimuth, elevation)
        body = body_axes(turned, velocity, sun_ecef_m, _ORBIT_NORMAL[satellite[i]])
        out.range_m[i] = rho
        out.range_rate_m_s[i] = light_time_range_rate(turned, velocity, unit, rho, receiver_velocity_ecef_m_s)
        out.unit_ecef[i] = unit
        out.azimuth_rad[i], out.elevation_rad[i] = azimuth, elevation
        out.shapiro_m[i] = shapiro_delay_m(math.sqrt(np.dot(turned, turned)), receiver_radius, rho)
        out.hydrostatic_m[i] = mapped[0] * troposphere[ZENITH_HYDROSTATIC]
        out.wet_mapping[i], out.gradient_north[i], out.gradient_east[i] = mapped[1], mapped[2], mapped[3]
        out.windup_cycles[i] = windup_cycles(-unit, body, enu[1], -enu[0], previous_windup_cycles[i])
        out.eclipsed[i] = in_shadow(turned, sun_ecef_m)
        system = satellite[i] // SATELLITES_PER_SYSTEM
        for k in range(f):
            band = bands[i, k]
            out.antenna_m[i, k] = receiver_antenna_m(antennas, system, band, unit_enu, azimuth, elevation)
            if satellite_antennas_apply:
                out.antenna_m[i, k] += satellite_antenna_m(antennas, satellite[i], band, -unit, body)
    return out
