"""Satellite positions and clocks from broadcast ephemerides: one table row an ephemeris, one kernel for all systems.

The position is that of the antenna's phase centre, Earth-fixed *at the time asked for*; the clock belongs to the
system's reference signals (:mod:`plumbline.gnss.group_delays` leads to others).
"""

import math
from typing import Final, NamedTuple

import numpy as np
from numba import njit

from plumbline.constants import (
    EARTH_GM_BEIDOU_M3_S2,
    EARTH_GM_GALILEO_M3_S2,
    EARTH_GM_GPS_M3_S2,
    EARTH_ROTATION_RATE_BEIDOU_RAD_S,
    EARTH_ROTATION_RATE_RAD_S,
    SPEED_OF_LIGHT_M_S,
)
from plumbline.gnss.orbits_glonass import integrate
from plumbline.gnss.relativity import periodic_clock_s
from plumbline.records import Ephemeris, Floats, GlonassEphemeris, Ints, KeplerEphemeris
from plumbline.signals import System, number_of, system_of

# Columns of a packed ephemeris. Times are split into whole seconds and nanoseconds so that float64 holds them exactly.
SATELLITE: Final = 0
KIND: Final = 1  # NONE, KEPLER, KEPLER_GEO, GLONASS
TOE_S: Final = 2
TOE_NS: Final = 3
TOC_S: Final = 4
TOC_NS: Final = 5
AF0: Final = 6
AF1: Final = 7
AF2: Final = 8
ISSUE: Final = 9
SQRT_A: Final = 10
ECCENTRICITY: Final = 11
M0: Final = 12
DELTA_N: Final = 13
I0: Final = 14
IDOT: Final = 15
OMEGA0: Final = 16
OMEGA_DOT: Final = 17
ARGUMENT: Final = 18
CUC: Final = 19
CUS: Final = 20
CRC: Final = 21
CRS: Final = 22
CIC: Final = 23
CIS: Final = 24
GM: Final = 25
EARTH_RATE: Final = 26
TOE_OF_WEEK_S: Final = 27
N_COLUMNS: Final = 28
STATE: Final = 10  # GLONASS: position and velocity in 10…15, luni-solar acceleration in 16…18
LUNI_SOLAR: Final = 16

NONE: Final = 0.0
KEPLER: Final = 1.0
KEPLER_GEO: Final = 2.0
GLONASS: Final = 3.0

MAX_INTEGRATION_S: Final = 21_600.0  # GLONASS: kilometres wrong by then, and the time an epoch may take is bounded
_WEEK_S: Final = 604_800
_BEIDOU_TOE_SHIFT_S: Final = 14  # BDT − GPST in the node's reference: its longitude counts from the BDT week's start
_GEO_TILT_RAD: Final = math.radians(-5.0)
_NS: Final = 1_000_000_000


class SatelliteStates(NamedTuple):
    """Satellites at given times: position (n, 3) and velocity (n, 3), Earth-fixed at that time, clock offset (n,).

    The clock offset includes the periodic relativistic term, which stands alone in ``relativity_s`` too. ``status``
    (n,) is zero where the row can be used (:class:`plumbline.gnss.satellite_states.StateStatus`); elsewhere NaN.
    """

    position_ecef_m: Floats
    velocity_ecef_m_s: Floats
    clock_s: Floats
    clock_rate_s_s: Floats
    relativity_s: Floats
    status: Ints


def is_beidou_geo(satellite: int) -> bool:
    """Whether a satellite id is a geostationary BeiDou satellite (C01–C05, C59–C63)."""
    return system_of(satellite) is System.BEIDOU and (number_of(satellite) <= 5 or number_of(satellite) >= 59)


def empty_row() -> Floats:
    """A row (N_COLUMNS,) that says 'no ephemeris'."""
    return np.zeros(N_COLUMNS)


def pack(ephemeris: Ephemeris) -> Floats:
    """Row (N_COLUMNS,) of an ephemeris, Kepler or GLONASS."""
    return _pack_glonass(ephemeris) if isinstance(ephemeris, GlonassEphemeris) else _pack_kepler(ephemeris)


def _pack_glonass(e: GlonassEphemeris) -> Floats:
    row = empty_row()
    row[SATELLITE], row[KIND], row[ISSUE] = e.satellite, GLONASS, e.issue
    row[TOE_S], row[TOE_NS] = divmod(e.toe_gps_ns, _NS)
    row[TOC_S], row[TOC_NS] = divmod(e.toe_gps_ns, _NS)
    row[AF0], row[AF1] = e.clock_bias_s, e.frequency_bias
    row[STATE : STATE + 3] = e.position_pz90_m
    row[STATE + 3 : STATE + 6] = e.velocity_pz90_m_s
    row[LUNI_SOLAR : LUNI_SOLAR + 3] = e.acceleration_pz90_m_s2
    return row


def _pack_kepler(e: KeplerEphemeris) -> Floats:
    system = system_of(e.satellite)
    beidou = system is System.BEIDOU
    row = empty_row()
    row[SATELLITE], row[ISSUE] = e.satellite, e.issue
    row[KIND] = KEPLER_GEO if is_beidou_geo(e.satellite) else KEPLER
    row[TOE_S], row[TOE_NS] = divmod(e.toe_gps_ns, _NS)
    row[TOC_S], row[TOC_NS] = divmod(e.toc_gps_ns, _NS)
    row[AF0 : AF2 + 1] = e.clock_bias_s, e.clock_drift_s_s, e.clock_drift_rate_s_s2
    row[SQRT_A : M0 + 1] = e.sqrt_semi_major_axis_sqrt_m, e.eccentricity, e.mean_anomaly_rad
    row[DELTA_N : IDOT + 1] = e.mean_motion_difference_rad_s, e.inclination_rad, e.inclination_rate_rad_s
    row[OMEGA0 : ARGUMENT + 1] = e.ascending_node_rad, e.ascending_node_rate_rad_s, e.argument_of_perigee_rad
    row[CUC : CIS + 1] = e.cuc_rad, e.cus_rad, e.crc_m, e.crs_m, e.cic_rad, e.cis_rad
    row[GM] = EARTH_GM_GPS_M3_S2
    if beidou:
        row[GM] = EARTH_GM_BEIDOU_M3_S2
    elif system is System.GALILEO:
        row[GM] = EARTH_GM_GALILEO_M3_S2
    row[EARTH_RATE] = EARTH_ROTATION_RATE_BEIDOU_RAD_S if beidou else EARTH_ROTATION_RATE_RAD_S
    toe_s = e.toe_gps_ns / _NS - (_BEIDOU_TOE_SHIFT_S if beidou else 0)
    row[TOE_OF_WEEK_S] = toe_s % _WEEK_S
    return row


@njit(cache=True)
def seconds_since(t_ns: int, whole_s: float, rest_ns: float) -> float:
    """``t_ns`` minus the split time, s, without loss of precision."""
    elapsed_ns: int = t_ns - (int(whole_s) * _NS + int(rest_ns))
    return elapsed_ns * 1e-9


@njit(cache=True)
def broadcast_clock_s(row: Floats, t_ns: int) -> float:
    """Satellite clock offset (3-term polynomial), s, without the relativistic term, at the GPS time ``t_ns``."""
    dt = seconds_since(t_ns, row[TOC_S], row[TOC_NS])
    return float(row[AF0] + (row[AF1] + row[AF2] * dt) * dt)


@njit(cache=True)
def _eccentric_anomaly(mean_anomaly_rad: float, eccentricity: float) -> float:
    """Kepler's equation by Newton's method."""
    e = mean_anomaly_rad
    for _ in range(30):
        step = (e - eccentricity * math.sin(e) - mean_anomaly_rad) / (1.0 - eccentricity * math.cos(e))
        e -= step
        if abs(step) < 1e-14:
            break
    return e


@njit(cache=True)
def _orbital_plane(row: Floats, dt: float) -> tuple[float, float, float, float, float, float]:
    """In-plane coordinates x, y [m], inclination [rad] and their rates (IS-GPS-200 table 20-IV, and derivatives)."""
    a = row[SQRT_A] * row[SQRT_A]
    n = math.sqrt(row[GM] / (a * a * a)) + row[DELTA_N]
    ecc = row[ECCENTRICITY]
    anomaly = _eccentric_anomaly(row[M0] + n * dt, ecc)
    sin_e, cos_e = math.sin(anomaly), math.cos(anomaly)
    one_minus = 1.0 - ecc * cos_e
    anomaly_rate = n / one_minus
    root = math.sqrt(1.0 - ecc * ecc)
    phi = math.atan2(root * sin_e, cos_e - ecc) + row[ARGUMENT]
    phi_rate = anomaly_rate * root / one_minus
    s2, c2 = math.sin(2.0 * phi), math.cos(2.0 * phi)
    u = phi + row[CUS] * s2 + row[CUC] * c2
    u_rate = phi_rate * (1.0 + 2.0 * (row[CUS] * c2 - row[CUC] * s2))
    r = a * one_minus + row[CRS] * s2 + row[CRC] * c2
    r_rate = a * ecc * sin_e * anomaly_rate + 2.0 * phi_rate * (row[CRS] * c2 - row[CRC] * s2)
    inclination = row[I0] + row[IDOT] * dt + row[CIS] * s2 + row[CIC] * c2
    inclination_rate = row[IDOT] + 2.0 * phi_rate * (row[CIS] * c2 - row[CIC] * s2)
    su, cu = math.sin(u), math.cos(u)
    x, y = r * cu, r * su
    return x, y, inclination, r_rate * cu - y * u_rate, r_rate * su + x * u_rate, inclination_rate


@njit(cache=True)
def _kepler(row: Floats, t_ns: int, position: Floats, velocity: Floats) -> None:
    """Earth-fixed position and velocity of a Kepler row at the GPS time ``t_ns``, into (3,) arrays."""
    dt = seconds_since(t_ns, row[TOE_S], row[TOE_NS])
    x, y, inclination, x_rate, y_rate, inclination_rate = _orbital_plane(row, dt)
    geo = row[KIND] == KEPLER_GEO
    node_rate = row[OMEGA_DOT] - (0.0 if geo else row[EARTH_RATE])
    node = row[OMEGA0] + node_rate * dt - row[EARTH_RATE] * row[TOE_OF_WEEK_S]
    si, ci, so, co = math.sin(inclination), math.cos(inclination), math.sin(node), math.cos(node)
    position[0] = x * co - y * ci * so
    position[1] = x * so + y * ci * co
    position[2] = y * si
    tilt_rate = y_rate * ci - y * si * inclination_rate
    velocity[0] = x_rate * co - tilt_rate * so - position[1] * node_rate
    velocity[1] = x_rate * so + tilt_rate * co + position[0] * node_rate
    velocity[2] = y_rate * si + y * ci * inclination_rate
    if geo:
        _turn_geo(row[EARTH_RATE], dt, position, velocity)


@njit(cache=True)
def _turn_geo(rate: float, dt: float, position: Floats, velocity: Floats) -> None:
    """R_z(rate·dt) R_x(−5°) of BDS-SIS-ICD B1I 3.0, 5.2.4.12 (GEO), applied to position and velocity in place."""
    st, ct = math.sin(_GEO_TILT_RAD), math.cos(_GEO_TILT_RAD)
    sz, cz = math.sin(rate * dt), math.cos(rate * dt)
    x, y, z = position[0], ct * position[1] + st * position[2], -st * position[1] + ct * position[2]
    vx, vy, vz = velocity[0], ct * velocity[1] + st * velocity[2], -st * velocity[1] + ct * velocity[2]
    position[0], position[1], position[2] = cz * x + sz * y, -sz * x + cz * y, z
    velocity[0] = cz * vx + sz * vy + rate * position[1]
    velocity[1] = -sz * vx + cz * vy - rate * position[0]
    velocity[2] = vz


@njit(cache=True)
def broadcast_state(row: Floats, t_ns: int, position: Floats, velocity: Floats) -> tuple[float, float, float]:
    """One satellite at a GPS time: fills position [m] and velocity [m/s]; returns clock, rate, relativity [s]."""
    clock = broadcast_clock_s(row, t_ns)
    dt = seconds_since(t_ns, row[TOC_S], row[TOC_NS])
    rate = row[AF1] + 2.0 * row[AF2] * dt
    if row[KIND] == GLONASS:
        duration_s = seconds_since(t_ns, row[TOE_S], row[TOE_NS])
        state = integrate(row[STATE : STATE + 6], row[LUNI_SOLAR : LUNI_SOLAR + 3], duration_s)
        position[:] = state[:3]
        velocity[:] = state[3:]
        return clock, rate, 0.0
    _kepler(row, t_ns, position, velocity)
    relativity = periodic_clock_s(position, velocity)
    speed2 = velocity[0] * velocity[0] + velocity[1] * velocity[1] + velocity[2] * velocity[2]
    cross = row[EARTH_RATE] * (position[0] * velocity[1] - position[1] * velocity[0])
    plane2 = (row[EARTH_RATE] * row[EARTH_RATE]) * (position[0] * position[0] + position[1] * position[1])
    r = math.sqrt(position[0] * position[0] + position[1] * position[1] + position[2] * position[2])
    rate += -2.0 * (speed2 + 2.0 * cross + plane2 - row[GM] / r) / (SPEED_OF_LIGHT_M_S * SPEED_OF_LIGHT_M_S)
    return clock + relativity, rate, relativity


@njit(cache=True)
def row_status(row: Floats, t_ns: int) -> int:
    """0: usable; 1: no ephemeris; 11: a GLONASS state vector more than ``MAX_INTEGRATION_S`` away."""
    if row[KIND] == NONE:
        return 1
    if row[KIND] == GLONASS and abs(seconds_since(t_ns, row[TOE_S], row[TOE_NS])) > MAX_INTEGRATION_S:
        return 11
    return 0


@njit(cache=True)
def broadcast_states(rows: Floats, t_gps_ns: Ints) -> SatelliteStates:
    """Satellites of packed ephemerides (n, N_COLUMNS) at GPS times (n,) int64 ns: see :class:`SatelliteStates`.

    Rows of kind NONE give NaN and status 1, GLONASS states too far to integrate 11. GLONASS has no separate
    relativistic term: its message has it inside.
    """
    n = rows.shape[0]
    position, velocity = np.full((n, 3), np.nan), np.full((n, 3), np.nan)
    clock, rate, relativity = np.full(n, np.nan), np.full(n, np.nan), np.full(n, np.nan)
    status = np.zeros(n, np.int64)
    for i in range(n):
        status[i] = row_status(rows[i], t_gps_ns[i])
        if status[i] != 0:
            continue
        clock[i], rate[i], relativity[i] = broadcast_state(rows[i], t_gps_ns[i], position[i], velocity[i])
    return SatelliteStates(position, velocity, clock, rate, relativity, status)
