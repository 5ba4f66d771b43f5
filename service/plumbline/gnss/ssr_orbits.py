"""State-space corrections applied to broadcast orbits and clocks (RTCM 10403.3, 3.5.12; IGS SSR 1.00, section 7).

Orbit: e_along = v/|v|, e_cross = r × v/|r × v|, e_radial = e_along × e_cross with r and v of the broadcast ephemeris in
the Earth-fixed frame; the correction, radial, along, cross, advanced by its rate, is *subtracted* from the broadcast
position. Clock: the correction, a polynomial in metres, is divided by c and *added* to the satellite's clock offset.
Rates apply from the reference time t0 + update interval / 2 (t0 itself for an interval of zero).
"""

import math
from typing import Final

import numpy as np
from numba import njit

from plumbline.constants import SPEED_OF_LIGHT_M_S
from plumbline.gnss.orbits_broadcast import seconds_since
from plumbline.records import Floats, SsrClock, SsrHeader, SsrOrbit

# Columns of a packed correction of one satellite; NaN in ORBIT or CLOCK means that there is none.
ORBIT_T_S: Final = 0
ORBIT_T_NS: Final = 1
ORBIT: Final = 2  # radial, along, cross: 2…4
ORBIT_RATE: Final = 5  # 5…7
CLOCK_T_S: Final = 8
CLOCK_T_NS: Final = 9
CLOCK: Final = 10  # c0, c1, c2: 10…12
HIGH_RATE_CLOCK: Final = 13  # metres, added to the polynomial
N_SSR_COLUMNS: Final = 14
_NS: Final = 1_000_000_000


def reference_time_ns(header: SsrHeader) -> int:
    """GPS time from which a correction's rates count (RTCM 10403.3, DF391 and 3.5.12)."""
    return header.t_gps_ns + round(header.update_interval_s * 0.5 * _NS)


def no_correction() -> Floats:
    """A row (N_SSR_COLUMNS,) without any correction."""
    return np.full(N_SSR_COLUMNS, np.nan)


def pack_correction(
    orbit: SsrOrbit | None, orbit_index: int, clock: SsrClock | None, clock_index: int, high_rate_clock_m: float = 0.0
) -> Floats:
    """Row (N_SSR_COLUMNS,) of one satellite: row ``orbit_index`` of an orbit and ``clock_index`` of a clock message."""
    row = no_correction()
    row[HIGH_RATE_CLOCK] = high_rate_clock_m
    if orbit is not None:
        row[ORBIT_T_S], row[ORBIT_T_NS] = divmod(reference_time_ns(orbit.header), _NS)
        row[ORBIT : ORBIT + 3] = orbit.delta_rac_m[orbit_index]
        row[ORBIT_RATE : ORBIT_RATE + 3] = orbit.delta_rate_rac_m_s[orbit_index]
    if clock is not None:
        row[CLOCK_T_S], row[CLOCK_T_NS] = divmod(reference_time_ns(clock.header), _NS)
        row[CLOCK : CLOCK + 3] = clock.polynomial_m[clock_index]
    return row


@njit(cache=True)
def rotation_ecef_from_rac(position_ecef_m: Floats, velocity_ecef_m_s: Floats) -> Floats:
    """Matrix (3, 3) whose columns are the radial, along-track and cross-track unit vectors."""
    out = np.empty((3, 3))
    along = velocity_ecef_m_s / math.sqrt(np.sum(velocity_ecef_m_s * velocity_ecef_m_s))
    cross = np.cross(position_ecef_m, velocity_ecef_m_s)
    cross = cross / math.sqrt(np.sum(cross * cross))
    out[:, 0] = np.cross(along, cross)
    out[:, 1] = along
    out[:, 2] = cross
    return out


@njit(cache=True)
def has_orbit_and_clock(correction: Floats) -> bool:
    """Whether a packed row holds both corrections."""
    return not (math.isnan(correction[ORBIT]) or math.isnan(correction[CLOCK]))


@njit(cache=True)
def clock_correction_s(correction: Floats, t_ns: int) -> float:
    """Clock correction, s, *added* to the broadcast clock offset at the GPS time ``t_ns``."""
    dt = seconds_since(t_ns, correction[CLOCK_T_S], correction[CLOCK_T_NS])
    polynomial_m = correction[CLOCK] + (correction[CLOCK + 1] + correction[CLOCK + 2] * dt) * dt
    return float(polynomial_m + correction[HIGH_RATE_CLOCK]) / SPEED_OF_LIGHT_M_S


@njit(cache=True)
def correct_orbit(correction: Floats, t_ns: int, position: Floats, velocity: Floats) -> None:
    """Subtract the orbit correction at the GPS time ``t_ns`` from a broadcast position and velocity (3,), in place.

    The velocity is corrected by the correction's rate alone; the turning of the axes adds under 1 mm/s.
    """
    dt = seconds_since(t_ns, correction[ORBIT_T_S], correction[ORBIT_T_NS])
    rotation = rotation_ecef_from_rac(position, velocity)
    for i in range(3):
        for k in range(3):
            rate = correction[ORBIT_RATE + k]
            position[i] -= rotation[i, k] * (correction[ORBIT + k] + rate * dt)
            velocity[i] -= rotation[i, k] * rate
