"""Sun and Moon, Earth-fixed, to an arcminute or two and a thousandth of the distance: enough for tides and attitude.

Series of O. Montenbruck, E. Gill, "Satellite Orbits", Springer 2000, 3.3.2 (eqs 3.43–3.51), referred to the mean
equinox of date, turned by the mean sidereal time.
"""

import math

import numpy as np
from numba import njit

from plumbline.gnss.earth_frames import greenwich_sidereal_time_rad, julian_centuries_tt, rotate_about_z
from plumbline.records import Floats

_ARCSEC = math.pi / 648_000.0


@njit(cache=True)
def _equatorial(longitude_rad: float, latitude_rad: float, radius_m: float, t: float) -> Floats:
    """Ecliptic to equatorial coordinates (3,), mean equator and equinox of date."""
    obliquity = math.radians(23.43929111 - 0.0130042 * t)
    sb, cb = math.sin(latitude_rad), math.cos(latitude_rad)
    sl, cl = math.sin(longitude_rad), math.cos(longitude_rad)
    se, ce = math.sin(obliquity), math.cos(obliquity)
    out = np.empty(3)
    out[0] = radius_m * cb * cl
    out[1] = radius_m * (cb * sl * ce - sb * se)
    out[2] = radius_m * (cb * sl * se + sb * ce)
    return out


@njit(cache=True)
def _sun_equatorial(t: float) -> Floats:
    """Sun (3,), m: eqs 3.43–3.45, with the perihelion's own motion, which the book leaves out (4′ by 2020)."""
    m = math.radians((357.5256 + 35_999.049 * t) % 360.0)
    longitude = math.radians((282.93734 + 1.71946 * t) % 360.0) + m  # perihelion of date (IERS 2010, 7.1.1.2, p_s)
    longitude += _ARCSEC * (6892.0 * math.sin(m) + 72.0 * math.sin(2.0 * m))
    radius_m = (149.619 - 2.499 * math.cos(m) - 0.021 * math.cos(2.0 * m)) * 1e9
    return _equatorial(longitude, 0.0, radius_m, t)


@njit(cache=True)
def _moon_longitude_arcsec(l: float, ls: float, f: float, d: float) -> float:  # noqa: E741 (the book's symbol)
    """Longitude of the Moon less its mean longitude, arc seconds: eq. 3.48."""
    sin = math.sin
    return (
        22_640.0 * sin(l) + 769.0 * sin(2.0 * l) - 4586.0 * sin(l - 2.0 * d) + 2370.0 * sin(2.0 * d)
        - 668.0 * sin(ls) - 412.0 * sin(2.0 * f) - 212.0 * sin(2.0 * l - 2.0 * d) - 206.0 * sin(l + ls - 2.0 * d)
        + 192.0 * sin(l + 2.0 * d) - 165.0 * sin(ls - 2.0 * d) + 148.0 * sin(l - ls) - 125.0 * sin(d)
        - 110.0 * sin(l + ls) - 55.0 * sin(2.0 * f - 2.0 * d)
    )  # fmt: skip


@njit(cache=True)
def _moon_equatorial(t: float) -> Floats:
    """Moon (3,), m: eqs 3.47–3.50 with the mean longitude of date."""
    mean = math.radians((218.31617 + 481_267.88088 * t) % 360.0)
    l = math.radians((134.96292 + 477_198.86753 * t) % 360.0)  # noqa: E741
    ls = math.radians((357.52543 + 35_999.04944 * t) % 360.0)
    f = math.radians((93.27283 + 483_202.01873 * t) % 360.0)
    d = math.radians((297.85027 + 445_267.11135 * t) % 360.0)
    sin, cos = math.sin, math.cos
    excess = _ARCSEC * _moon_longitude_arcsec(l, ls, f, d)
    node = f + excess + _ARCSEC * (412.0 * sin(2.0 * f) + 541.0 * sin(ls))
    latitude = _ARCSEC * (
        18_520.0 * sin(node) - 526.0 * sin(f - 2.0 * d) + 44.0 * sin(l + f - 2.0 * d) - 31.0 * sin(-l + f - 2.0 * d)
        - 25.0 * sin(-2.0 * l + f) - 23.0 * sin(ls + f - 2.0 * d) + 21.0 * sin(-l + f) + 11.0 * sin(-ls + f - 2.0 * d)
    )  # fmt: skip
    radius_m = 1e3 * (
        385_000.0 - 20_905.0 * cos(l) - 3699.0 * cos(2.0 * d - l) - 2956.0 * cos(2.0 * d) - 570.0 * cos(2.0 * l)
        + 246.0 * cos(2.0 * l - 2.0 * d) - 205.0 * cos(ls - 2.0 * d) - 171.0 * cos(l + 2.0 * d)
        - 152.0 * cos(l + ls - 2.0 * d)
    )  # fmt: skip
    return _equatorial(mean + excess, latitude, radius_m, t)


@njit(cache=True)
def sun_moon_ecef(t_gps_ns: int, gps_minus_utc_s: float) -> tuple[Floats, Floats]:
    """Sun (3,) and Moon (3,), Earth-fixed metres, at a GPS time; ``gps_minus_utc_s``: leap seconds, 18 since 2017."""
    t = julian_centuries_tt(t_gps_ns)
    angle = greenwich_sidereal_time_rad(t_gps_ns, gps_minus_utc_s)
    return rotate_about_z(_sun_equatorial(t), angle), rotate_about_z(_moon_equatorial(t), angle)
