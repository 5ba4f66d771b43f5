"""Earth-fixed, geodetic, local and (simple) inertial coordinates.

Earth-fixed is ITRF/WGS 84, metres. Geodetic is (latitude, longitude, height) on the WGS 84 ellipsoid, radians, metres.
The inertial frame is true enough for the Sun, the Moon and satellites' attitude: Earth-fixed turned by the Greenwich
mean sidereal time, no polar motion, nutation left out (17″ at most).
"""

import math
from typing import Any

import numpy as np
from numba import njit

from plumbline.constants import EARTH_ECCENTRICITY_SQUARED, EARTH_SEMI_MAJOR_AXIS_M
from plumbline.records import Floats

J2000_GPS_NS = 630_763_200 * 1_000_000_000  # 2000-01-01 12:00:00 written in GPS time
DAY_S = 86_400.0
DAYS_PER_CENTURY = 36_525.0
TT_MINUS_GPS_S = 51.184  # TT − TAI 32.184 s, TAI − GPS 19 s


@njit(cache=True)
def geodetic_from_ecef(position_ecef_m: Floats) -> Floats:
    """Geodetic (latitude rad, longitude rad, height m) of an Earth-fixed position (3,), to the nanometre.

    Fixed-point iteration on the sine of the latitude. At the Earth's centre, latitude and longitude come out as zero.
    """
    x, y, z = position_ecef_m[0], position_ecef_m[1], position_ecef_m[2]
    p2 = x * x + y * y
    z_shifted, z_last, prime_vertical_m = z, 0.0, EARTH_SEMI_MAJOR_AXIS_M
    for _ in range(50):
        if abs(z_shifted - z_last) < 1e-9:
            break
        z_last = z_shifted
        sin_latitude = z_shifted / math.sqrt(p2 + z_shifted * z_shifted)
        prime_vertical_m = EARTH_SEMI_MAJOR_AXIS_M / math.sqrt(
            1.0 - EARTH_ECCENTRICITY_SQUARED * sin_latitude * sin_latitude
        )
        z_shifted = z + prime_vertical_m * EARTH_ECCENTRICITY_SQUARED * sin_latitude
    out = np.empty(3)
    out[0] = math.atan2(z_shifted, math.sqrt(p2))
    out[1] = math.atan2(y, x)
    out[2] = math.sqrt(p2 + z_shifted * z_shifted) - prime_vertical_m
    return out


@njit(cache=True)
def ecef_from_geodetic(latitude_rad: float, longitude_rad: float, height_m: float) -> Floats:
    """Earth-fixed position (3,), m, of geodetic coordinates."""
    sin_latitude, cos_latitude = math.sin(latitude_rad), math.cos(latitude_rad)
    n = EARTH_SEMI_MAJOR_AXIS_M / math.sqrt(1.0 - EARTH_ECCENTRICITY_SQUARED * sin_latitude * sin_latitude)
    out = np.empty(3)
    out[0] = (n + height_m) * cos_latitude * math.cos(longitude_rad)
    out[1] = (n + height_m) * cos_latitude * math.sin(longitude_rad)
    out[2] = (n * (1.0 - EARTH_ECCENTRICITY_SQUARED) + height_m) * sin_latitude
    return out


@njit(cache=True)
def rotation_enu_from_ecef(latitude_rad: float, longitude_rad: float) -> Floats:
    """Matrix (3, 3) that turns an Earth-fixed vector into east, north, up at a geodetic latitude and longitude."""
    sp, cp = math.sin(latitude_rad), math.cos(latitude_rad)
    sl, cl = math.sin(longitude_rad), math.cos(longitude_rad)
    return np.array([[-sl, cl, 0.0], [-sp * cl, -sp * sl, cp], [cp * cl, cp * sl, sp]])


@njit(cache=True)
def azimuth_elevation(unit_ecef: Floats, rotation_enu: Floats) -> tuple[Floats, Floats]:
    """Azimuth (n,) in 0…2π clockwise from north and elevation (n,), rad, of unit vectors (n, 3) to satellites."""
    n = unit_ecef.shape[0]
    azimuth, elevation = np.empty(n), np.empty(n)
    for i in range(n):
        enu = rotation_enu @ unit_ecef[i]
        angle = math.atan2(enu[0], enu[1])
        azimuth[i] = angle if angle >= 0.0 else angle + 2.0 * math.pi
        elevation[i] = math.asin(min(1.0, max(-1.0, enu[2])))
    return azimuth, elevation


@njit(cache=True)
def julian_centuries_tt(t_gps_ns: int) -> float:
    """Julian centuries of TT since J2000.0 at a GPS time."""
    return ((t_gps_ns - J2000_GPS_NS) * 1e-9 + TT_MINUS_GPS_S) / (DAY_S * DAYS_PER_CENTURY)


@njit(cache=True)
def ut1_days_since_j2000(t_gps_ns: int, gps_minus_utc_s: float) -> float:
    """Days of UT1 (taken as UTC: 0.9 s at most) since J2000.0 at a GPS time."""
    return ((t_gps_ns - J2000_GPS_NS) * 1e-9 - gps_minus_utc_s) / DAY_S


@njit(cache=True)
def greenwich_sidereal_time_rad(t_gps_ns: int, gps_minus_utc_s: float) -> float:
    """Greenwich mean sidereal time, 0…2π rad, with UT1 taken as UTC.

    IERS Conventions (2010), eqs 5.14 and 5.32: Earth rotation angle plus the accumulated precession in right ascension.
    """
    days = ut1_days_since_j2000(t_gps_ns, gps_minus_utc_s)
    t = julian_centuries_tt(t_gps_ns)
    turns = 0.7790572732640 + 0.00273781191135448 * days + days % 1.0
    precession_arcsec = 0.014506 + (4612.156534 + (1.3915817 - 0.00000044 * t) * t) * t
    return (2.0 * math.pi * (turns % 1.0) + math.radians(precession_arcsec / 3600.0)) % (2.0 * math.pi)


@njit(cache=True)
def rotate_about_z(vector: Any, angle_rad: float) -> Floats:
    """Coordinates (3,) of a vector in a frame turned by ``angle_rad`` about z: R3(angle) of the textbooks."""
    s, c = math.sin(angle_rad), math.cos(angle_rad)
    out = np.empty(3)
    out[0] = c * vector[0] + s * vector[1]
    out[1] = -s * vector[0] + c * vector[1]
    out[2] = vector[2]
    return out
