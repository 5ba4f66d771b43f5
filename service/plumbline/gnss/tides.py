"""How the ground moves with the tides: solid Earth tide and ocean loading.

ITRF coordinates are conventionally tide-free: the whole solid Earth tide given here, its permanent part included, is
what an antenna moves by from them (IERS Conventions 2010, 7.1.1; the model of the Conventions' own routine, which
leaves its "step 3" out for the same reason). Both change by at most a millimetre a minute: compute them every 30 s or
so.
"""

import math
from typing import Final

import numpy as np
from numba import njit

from plumbline.gnss.earth_frames import julian_centuries_tt
from plumbline.records import Floats

_EARTH_RADIUS_M: Final = 6_378_136.6  # the Conventions' value for the tide
_SUN_MASS_RATIO: Final = 332_946.0482  # to the Earth
_MOON_MASS_RATIO: Final = 0.0123000371
_H3: Final = 0.292
_L3: Final = 0.015
_DEG: Final = math.pi / 180.0
_DAYS_1975_TO_1980: Final = 1832  # from 1974-12-31 to 1980-01-06

# IERS Conventions (2010), table 7.3a, as the Conventions' routine holds it: multiples of s, h, p, N', p_s beside tau,
# then radial in-phase, radial out-of-phase, transverse in-phase, transverse out-of-phase, mm.
_DIURNAL: Final = np.array([
    [-3, 0, 2, 0, 0, -0.01, 0, 0, 0], [-3, 2, 0, 0, 0, -0.01, 0, 0, 0], [-2, 0, 1, -1, 0, -0.02, 0, 0, 0],
    [-2, 0, 1, 0, 0, -0.08, 0, -0.01, 0.01], [-2, 2, -1, 0, 0, -0.02, 0, 0, 0], [-1, 0, 0, -1, 0, -0.10, 0, 0, 0],
    [-1, 0, 0, 0, 0, -0.51, 0, -0.02, 0.03], [-1, 2, 0, 0, 0, 0.01, 0, 0, 0], [0, -2, 1, 0, 0, 0.01, 0, 0, 0],
    [0, 0, -1, 0, 0, 0.02, 0, 0, 0], [0, 0, 1, 0, 0, 0.06, 0, 0, 0], [0, 0, 1, 1, 0, 0.01, 0, 0, 0],
    [0, 2, -1, 0, 0, 0.01, 0, 0, 0], [1, -3, 0, 0, 1, -0.06, 0, 0, 0], [1, -2, 0, -1, 0, 0.01, 0, 0, 0],
    [1, -2, 0, 0, 0, -1.23, -0.07, 0.06, 0.01], [1, -1, 0, 0, -1, 0.02, 0, 0, 0], [1, -1, 0, 0, 1, 0.04, 0, 0, 0],
    [1, 0, 0, -1, 0, -0.22, 0.01, 0.01, 0], [1, 0, 0, 0, 0, 12.00, -0.80, -0.67, -0.03],
    [1, 0, 0, 1, 0, 1.73, -0.12, -0.10, 0], [1, 0, 0, 2, 0, -0.04, 0, 0, 0],
    [1, 1, 0, 0, -1, -0.50, -0.01, 0.03, 0],
    [1, 1, 0, 0, 1, 0.01, 0, 0, 0], [0, 1, 0, 1, -1, -0.01, 0, 0, 0], [1, 2, -2, 0, 0, -0.01, 0, 0, 0],
    [1, 2, 0, 0, 0, -0.11, 0.01, 0.01, 0], [2, -2, 1, 0, 0, -0.01, 0, 0, 0], [2, 0, -1, 0, 0, -0.02, 0, 0, 0],
])  # fmt: skip

# Table 7.3b (long period): the same multiples, then radial and transverse in-phase, radial and transverse out, mm.
_LONG_PERIOD: Final = np.array([
    [0, 0, 0, 1, 0, 0.47, 0.23, 0.16, 0.07], [0, 2, 0, 0, 0, -0.20, -0.12, -0.11, -0.05],
    [1, 0, -1, 0, 0, -0.11, -0.08, -0.09, -0.04], [2, 0, 0, 0, 0, -0.13, -0.11, -0.15, -0.07],
    [2, 0, 0, 1, 0, -0.05, -0.05, -0.06, -0.03],
])  # fmt: skip

# Ocean loading, in BLQ's order: speed, rad/s, multiples of h0, s0, p0, one turn (E. W. Schwiderski's arguments, as the
# Conventions' ARG2 and the GPS analysis centres use them); then the 18.6-year modulation by the Moon's node N: factor
# f = f0 + f1 cos N and angle u sin N, degrees (A. T. Doodson, H. D. Warburg, Admiralty Manual of Tides, 1941).
_OCEAN: Final = np.array([
    [1.40519e-4, 2, -2, 0, 0.00, 1.000, -0.037, -2.1],  # M2
    [1.45444e-4, 0, 0, 0, 0.00, 1.000, 0.000, 0.0],  # S2
    [1.37880e-4, 2, -3, 1, 0.00, 1.000, -0.037, -2.1],  # N2
    [1.45842e-4, 2, 0, 0, 0.00, 1.024, 0.286, -17.7],  # K2
    [0.72921e-4, 1, 0, 0, 0.25, 1.006, 0.115, -8.9],  # K1
    [0.67598e-4, 1, -2, 0, -0.25, 1.009, 0.187, 10.8],  # O1
    [0.72523e-4, -1, 0, 0, -0.25, 1.000, 0.000, 0.0],  # P1
    [0.64959e-4, 1, -3, 1, -0.25, 1.009, 0.187, 10.8],  # Q1
    [0.053234e-4, 0, 2, 0, 0.00, 1.043, 0.414, -23.7],  # Mf
    [0.026392e-4, 0, 1, -1, 0.00, 1.000, -0.130, 0.0],  # Mm
    [0.003982e-4, 2, 0, 0, 0.00, 1.000, 0.000, 0.0],  # Ssa
])  # fmt: skip


@njit(cache=True)
def _place(station: Floats) -> tuple[float, float, float, float]:
    """Sine and cosine of the geocentric latitude and of the longitude."""
    r = math.sqrt(np.dot(station, station))
    p = math.sqrt(station[0] * station[0] + station[1] * station[1])
    return station[2] / r, p / r, station[1] / p, station[0] / p


@njit(cache=True)
def _elastic(station: Floats, body: Floats, mass_ratio: float, out: Floats) -> None:
    """Displacement by the in-phase tides of degree 2 and 3, added to ``out`` (3,): eqs 7.5 and 7.6."""
    r, distance = math.sqrt(np.dot(station, station)), math.sqrt(np.dot(body, body))
    cosine = np.dot(station, body) / (r * distance)
    sine_latitude = station[2] / r
    zonal = 1.5 * sine_latitude * sine_latitude - 0.5
    h2, l2 = 0.6078 - 0.0006 * zonal, 0.0847 + 0.0002 * zonal
    ratio = _EARTH_RADIUS_M / distance
    scale2 = mass_ratio * _EARTH_RADIUS_M * ratio * ratio * ratio
    scale3 = scale2 * ratio
    radial = scale2 * h2 * (1.5 * cosine * cosine - 0.5) + scale3 * _H3 * (2.5 * cosine * cosine - 1.5) * cosine
    across = scale2 * 3.0 * l2 * cosine + scale3 * _L3 * (7.5 * cosine * cosine - 1.5)
    for i in range(3):
        out[i] += radial * station[i] / r + across * (body[i] / distance - cosine * station[i] / r)


@njit(cache=True)
def _anelastic_and_l1(station: Floats, body: Floats, mass_ratio: float) -> tuple[float, float, float]:
    """East, north, up by out-of-phase Love numbers and l's latitude term: eqs 7.8–7.11, both bands."""
    sp, cp, sl, cl = _place(station)
    distance = math.sqrt(np.dot(body, body))
    x, y, z = body[0] / distance, body[1] / distance, body[2] / distance
    scale = mass_ratio * _EARTH_RADIUS_M * (_EARTH_RADIUS_M / distance) ** 3
    lag, face = scale * z * (x * sl - y * cl), scale * z * (x * cl + y * sl)
    s2, c2 = 2.0 * sl * cl, cl * cl - sl * sl
    lag2 = scale * ((x * x - y * y) * s2 - 2.0 * x * y * c2)
    face2 = scale * ((x * x - y * y) * c2 + 2.0 * x * y * s2)
    cos_2_latitude = cp * cp - sp * sp
    up = 3.0 * 0.0025 * sp * cp * lag + 0.75 * 0.0022 * cp * cp * lag2
    north = 3.0 * 0.0007 * cos_2_latitude * lag - 1.5 * 0.0007 * sp * cp * lag2
    east = 3.0 * 0.0007 * sp * face + 1.5 * 0.0007 * cp * face2
    north += -3.0 * 0.0012 * sp * sp * face - 1.5 * 0.0024 * sp * cp * face2
    east += 3.0 * 0.0012 * sp * cos_2_latitude * lag - 1.5 * 0.0024 * sp * sp * cp * lag2
    return east, north, up


@njit(cache=True)
def _fundamental_deg(t: float) -> Floats:
    """s, h, p, N', p_s, degrees (5,), of date, at Julian centuries of TT since J2000 (7.1.1.2)."""
    s = 218.31664563 + (481267.88194 + (-0.0014663889 + 0.00000185139 * t) * t) * t
    s += (1.396971278 + (0.000308889 + (0.000000021 + 0.000000007 * t) * t) * t) * t
    out = np.empty(5)
    out[0] = s
    out[1] = 280.46645 + (36000.7697489 + (0.00030322222 + (0.00000002 - 0.00000000654 * t) * t) * t) * t
    out[2] = 83.35324312 + (4069.01363525 + (-0.01032172222 + (-0.0000124991 + 0.00000005263 * t) * t) * t) * t
    out[3] = 234.95544499 + (1934.13626197 + (-0.00207561111 + (-0.00000213944 + 0.0000000165 * t) * t) * t) * t
    out[4] = 282.93734098 + (1.71945766667 + (0.00045688889 + (-0.00000001778 - 0.00000000334 * t) * t) * t) * t
    return out % 360.0


@njit(cache=True)
def _frequency_dependence(station: Floats, t: float, ut_hours: float) -> tuple[float, float, float]:
    """East, north, up, m: corrections for the Love numbers' dependence on frequency, eqs 7.12 and 7.13."""
    sp, cp, sl, cl = _place(station)
    angles = _fundamental_deg(t)
    sidereal = 280.4606184 + (36000.7700536 + (0.00038793 - 0.0000000258 * t) * t) * t
    moon_of_date = 218.31664563 + (481267.88194 + (-0.0014663889 + 0.00000185139 * t) * t) * t
    tau_deg = ut_hours * 15.0 + sidereal - moon_of_date
    longitude = math.atan2(sl, cl)
    east, north, up = 0.0, 0.0, 0.0
    for k in range(_DIURNAL.shape[0]):
        theta = (tau_deg + np.dot(_DIURNAL[k, :5], angles)) * _DEG + longitude
        s, c = math.sin(theta), math.cos(theta)
        up += 2.0 * sp * cp * (_DIURNAL[k, 5] * s + _DIURNAL[k, 6] * c)
        north += (cp * cp - sp * sp) * (_DIURNAL[k, 7] * s + _DIURNAL[k, 8] * c)
        east += sp * (_DIURNAL[k, 7] * c - _DIURNAL[k, 8] * s)
    for k in range(_LONG_PERIOD.shape[0]):
        theta = np.dot(_LONG_PERIOD[k, :5], angles) * _DEG
        s, c = math.sin(theta), math.cos(theta)
        up += (1.5 * sp * sp - 0.5) * (_LONG_PERIOD[k, 5] * c + _LONG_PERIOD[k, 7] * s)
        north += 2.0 * sp * cp * (_LONG_PERIOD[k, 6] * c + _LONG_PERIOD[k, 8] * s)
    return east * 1e-3, north * 1e-3, up * 1e-3


@njit(cache=True)
def solid_earth_tide_ecef_m(
    station_ecef_m: Floats, sun_ecef_m: Floats, moon_ecef_m: Floats, t_gps_ns: int, gps_minus_utc_s: float
) -> Floats:
    """Displacement (3,), Earth-fixed metres, *added* to tide-free coordinates; station, Sun and Moon (3,) Earth-fixed.

    IERS Conventions (2010), 7.1.1.1: step 1 (degree 2 and 3, latitude dependence, out-of-phase parts) and step 2
    (frequency dependence, diurnal and long-period bands). About 2 µs.
    """
    out = np.zeros(3)
    _elastic(station_ecef_m, sun_ecef_m, _SUN_MASS_RATIO, out)
    _elastic(station_ecef_m, moon_ecef_m, _MOON_MASS_RATIO, out)
    sun_enu = _anelastic_and_l1(station_ecef_m, sun_ecef_m, _SUN_MASS_RATIO)
    moon_enu = _anelastic_and_l1(station_ecef_m, moon_ecef_m, _MOON_MASS_RATIO)
    ut_hours = ((t_gps_ns * 1e-9 - gps_minus_utc_s) % 86_400.0) / 3600.0
    step2 = _frequency_dependence(station_ecef_m, julian_centuries_tt(t_gps_ns), ut_hours)
    east = sun_enu[0] + moon_enu[0] + step2[0]
    north = sun_enu[1] + moon_enu[1] + step2[1]
    up = sun_enu[2] + moon_enu[2] + step2[2]
    sp, cp, sl, cl = _place(station_ecef_m)
    out[0] += up * cp * cl - east * sl - north * sp * cl
    out[1] += up * cp * sl + east * cl - north * sp * sl
    out[2] += up * sp + north * cp
    return out


@njit(cache=True)
def ocean_loading_enu_m(amplitude_m: Floats, phase_rad: Floats, t_gps_ns: int, gps_minus_utc_s: float) -> Floats:
    """Displacement (3,), east, north, up, m, *added* to the coordinates, from BLQ coefficients.

    ``amplitude_m`` and ``phase_rad`` (3, 11): rows radial, west, south; columns M2 S2 N2 K2 K1 O1 P1 Q1 Mf Mm Ssa.
    IERS Conventions (2010), eq. 7.16, the 11 tides with their nodal modulation; the minor tides between them are left
    out (5 % of the displacement: a millimetre where it is 24 mm rms).
    """
    seconds_utc = t_gps_ns * 1e-9 - gps_minus_utc_s
    day = math.floor(seconds_utc / 86_400.0)
    of_day_s = seconds_utc - day * 86_400.0
    t = (27392.500528 + 1.000000035 * (day + _DAYS_1975_TO_1980)) / 36525.0
    h0 = (279.69668 + (36000.768930485 + 3.03e-4 * t) * t) * _DEG
    s0 = (270.434358 + (481267.88314137 + (-0.001133 + 1.9e-6 * t) * t) * t) * _DEG
    p0 = (334.329653 + (4069.0340329577 + (-0.010325 - 1.2e-5 * t) * t) * t) * _DEG
    node = -_fundamental_deg(julian_centuries_tt(t_gps_ns))[3] * _DEG
    up, west, south = 0.0, 0.0, 0.0
    for k in range(11):
        tide = _OCEAN[k]
        angle = tide[0] * of_day_s + tide[1] * h0 + tide[2] * s0 + tide[3] * p0 + tide[4] * 2.0 * math.pi
        angle += tide[7] * _DEG * math.sin(node)
        factor = tide[5] + tide[6] * math.cos(node)
        up += factor * amplitude_m[0, k] * math.cos(angle - phase_rad[0, k])
        west += factor * amplitude_m[1, k] * math.cos(angle - phase_rad[1, k])
        south += factor * amplitude_m[2, k] * math.cos(angle - phase_rad[2, k])
    out = np.empty(3)
    out[0], out[1], out[2] = -west, -south, up
    return out
