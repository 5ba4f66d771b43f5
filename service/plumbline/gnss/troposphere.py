"""Tropospheric delay: zenith delays a priori, mapping functions and gradients.

What changes slowly (everything but the satellites' directions) is computed once for a place and a day as a *site* row
by :func:`troposphere_site`; :func:`map_troposphere` then costs well under a microsecond a satellite.
"""

import math
from importlib.resources import files
from typing import Final

import numpy as np
from numba import njit

from plumbline.records import Floats

# Columns of a site row
ZENITH_HYDROSTATIC: Final = 0  # m
ZENITH_WET: Final = 1  # m, a rough value a priori
A_HYDROSTATIC: Final = 2
C_HYDROSTATIC: Final = 3
A_WET: Final = 4
HEIGHT_KM: Final = 5  # above the geoid
PRESSURE_HPA: Final = 6
N_SITE: Final = 7

MIN_ELEVATION_RAD: Final = math.radians(1.0)  # mapping functions are evaluated no lower
_B_HYDROSTATIC: Final = 0.0029
_B_WET: Final = 0.00146
_C_WET: Final = 0.04391
_MJD_1980_01_28_GPS_NS: Final = 22 * 86_400 * 1_000_000_000
_DAY_NS: Final = 86_400 * 1_000_000_000
_DEGREE: Final = 9
_N_TERMS: Final = 55
_RELATIVE_HUMIDITY: Final = 0.5


def _read_coefficients() -> Floats:
    """(14, 55): rows as the CSV's columns after n and m."""
    with files("plumbline.gnss").joinpath("global_troposphere.csv").open(encoding="ascii") as stream:
        table = np.loadtxt(stream, delimiter=",", skiprows=4)
    return np.ascontiguousarray(table[:, 2:].T)


_COEFFICIENTS: Final = _read_coefficients()


@njit(cache=True)
def _harmonics(latitude_rad: float, longitude_rad: float) -> tuple[Floats, Floats]:
    """Unnormalised P_nm(sin latitude) times cos and sin of m·longitude, n = 0…9, m = 0…n: two (55,) arrays."""
    x = math.cos(latitude_rad) * math.cos(longitude_rad)
    y = math.cos(latitude_rad) * math.sin(longitude_rad)
    z = math.sin(latitude_rad)
    v, w = np.zeros((_DEGREE + 1, _DEGREE + 1)), np.zeros((_DEGREE + 1, _DEGREE + 1))
    v[0, 0] = 1.0
    for m in range(_DEGREE + 1):
        if m > 0:
            v[m, m] = (2 * m - 1) * (x * v[m - 1, m - 1] - y * w[m - 1, m - 1])
            w[m, m] = (2 * m - 1) * (x * w[m - 1, m - 1] + y * v[m - 1, m - 1])
        for n in range(m + 1, _DEGREE + 1):
            below_v = v[n - 2, m] if n > m + 1 else 0.0
            below_w = w[n - 2, m] if n > m + 1 else 0.0
            v[n, m] = ((2 * n - 1) * z * v[n - 1, m] - (n + m - 1) * below_v) / (n - m)
            w[n, m] = ((2 * n - 1) * z * w[n - 1, m] - (n + m - 1) * below_w) / (n - m)
    cosine, sine = np.empty(_N_TERMS), np.empty(_N_TERMS)
    i = 0
    for n in range(_DEGREE + 1):
        for m in range(n + 1):
            cosine[i], sine[i] = v[n, m], w[n, m]
            i += 1
    return cosine, sine


@njit(cache=True)
def _season(t_gps_ns: int) -> float:
    """Phase of the year, rad, from 28 January (Niell 1996)."""
    return 2.0 * math.pi * ((t_gps_ns - _MJD_1980_01_28_GPS_NS) / _DAY_NS) / 365.25


@njit(cache=True)
def _troposphere_site(
    coefficients: Floats, latitude_rad: float, longitude_rad: float, height_m: float, t_gps_ns: int
) -> Floats:
    cosine, sine = _harmonics(latitude_rad, longitude_rad)
    value = np.empty(7)
    for k in range(7):
        value[k] = np.dot(coefficients[2 * k], cosine) + np.dot(coefficients[2 * k + 1], sine)
    season = math.cos(_season(t_gps_ns))
    height_geoid_m = min(max(height_m - value[6], -1000.0), 30_000.0)
    out = np.empty(N_SITE)
    out[A_HYDROSTATIC] = (value[0] + value[1] * season) * 1e-5
    out[A_WET] = (value[2] + value[3] * season) * 1e-5
    south = latitude_rad < 0.0
    swing = math.cos(_season(t_gps_ns) + (math.pi if south else 0.0)) + 1.0
    c11, c10 = (0.007, 0.002) if south else (0.005, 0.001)
    out[C_HYDROSTATIC] = 0.062 + (swing * c11 / 2.0 + c10) * (1.0 - math.cos(latitude_rad))
    out[HEIGHT_KM] = height_geoid_m / 1000.0
    out[PRESSURE_HPA] = (value[4] + value[5] * season) * (1.0 - 2.26e-5 * height_geoid_m) ** 5.225
    out[ZENITH_HYDROSTATIC] = zenith_hydrostatic_delay_m(out[PRESSURE_HPA], latitude_rad, height_geoid_m)
    out[ZENITH_WET] = zenith_wet_delay_m(height_geoid_m)
    return out


def troposphere_site(latitude_rad: float, longitude_rad: float, height_m: float, t_gps_ns: int) -> Floats:
    """Site row (N_SITE,): zenith delays and mapping coefficients of a place (geodetic, ellipsoidal height) and a time.

    Pressure: GPT (Boehm et al. 2007). Mapping: GMF (Boehm et al. 2006). Heights are held to −1…30 km. To be renewed
    when the place changes by more than a kilometre or a hundred metres of height, or daily.
    """
    return _troposphere_site(_COEFFICIENTS, latitude_rad, longitude_rad, height_m, t_gps_ns)  # type: ignore[no-any-return]


@njit(cache=True)
def zenith_hydrostatic_delay_m(pressure_hpa: float, latitude_rad: float, height_m: float) -> float:
    """Zenith hydrostatic delay, m: Saastamoinen in Davis' form, IERS Conventions (2010), eq. 9.3."""
    gravity = 1.0 - 0.00266 * math.cos(2.0 * latitude_rad) - 0.28e-6 * height_m
    return 0.0022768 * pressure_hpa / gravity


@njit(cache=True)
def zenith_wet_delay_m(height_m: float) -> float:
    """Rough zenith wet delay, m: Saastamoinen 1972 in a standard atmosphere of 50 % humidity (15 °C at sea level)."""
    temperature_k = max(288.15 - 0.0065 * height_m, 216.65)
    vapour_hpa = 6.108 * _RELATIVE_HUMIDITY * math.exp((17.15 * temperature_k - 4684.0) / (temperature_k - 38.45))
    return 0.002277 * (1255.0 / temperature_k + 0.05) * vapour_hpa


@njit(cache=True)
def _continued_fraction(sine: float, a: float, b: float, c: float) -> float:
    """Marini's form as normed by Herring: IERS Conventions (2010), eq. 9.13."""
    return (1.0 + a / (1.0 + b / (1.0 + c))) / (sine + a / (sine + b / (sine + c)))


@njit(cache=True)
def map_troposphere(site: Floats, azimuth_rad: float, elevation_rad: float) -> tuple[float, float, float, float]:
    """Hydrostatic and wet mapping factor and the partials to the north and east gradient (m per m) of one direction.

    GMF with Niell's height correction; gradients after Chen and Herring 1997 (IERS Conventions 2010, eq. 9.12).
    Below ``MIN_ELEVATION_RAD`` the values at that elevation.
    """
    elevation = max(elevation_rad, MIN_ELEVATION_RAD)
    sine = math.sin(elevation)
    hydrostatic = _continued_fraction(sine, site[A_HYDROSTATIC], _B_HYDROSTATIC, site[C_HYDROSTATIC])
    hydrostatic += (1.0 / sine - _continued_fraction(sine, 2.53e-5, 5.49e-3, 1.14e-3)) * site[HEIGHT_KM]
    wet = _continued_fraction(sine, site[A_WET], _B_WET, _C_WET)
    gradient = 1.0 / (sine * math.tan(elevation) + 0.0032)
    return hydrostatic, wet, gradient * math.cos(azimuth_rad), gradient * math.sin(azimuth_rad)
