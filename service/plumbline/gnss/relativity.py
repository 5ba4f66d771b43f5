"""Relativity in the range and in the satellite clock."""

import math

from numba import njit

from plumbline.constants import EARTH_GM_GALILEO_M3_S2, SPEED_OF_LIGHT_M_S
from plumbline.records import Floats


@njit(cache=True)
def periodic_clock_s(position_ecef_m: Floats, velocity_ecef_m_s: Floats) -> float:
    """Periodic relativistic satellite clock term −2 r·v/c², s, *added* to the clock offset.

    Position and velocity (3,): r·v is the same in the Earth-fixed and the inertial frame. IS-GPS-200, 20.3.3.3.3.1.
    """
    dot = float(
        position_ecef_m[0] * velocity_ecef_m_s[0]
        + position_ecef_m[1] * velocity_ecef_m_s[1]
        + position_ecef_m[2] * velocity_ecef_m_s[2]
    )
    return -2.0 * dot / (SPEED_OF_LIGHT_M_S * SPEED_OF_LIGHT_M_S)


@njit(cache=True)
def shapiro_delay_m(satellite_radius_m: float, receiver_radius_m: float, range_m: float) -> float:
    """Signal delay by the Earth's gravitation, m, added to the range: IERS Conventions (2010), eq. 11.17."""
    total = satellite_radius_m + receiver_radius_m
    factor = 2.0 * EARTH_GM_GALILEO_M3_S2 / (SPEED_OF_LIGHT_M_S * SPEED_OF_LIGHT_M_S)
    return factor * math.log((total + range_m) / (total - range_m))
