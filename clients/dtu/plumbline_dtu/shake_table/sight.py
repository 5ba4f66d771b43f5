"""Ranges from a moving antenna to many satellites at many epochs, in one kernel."""

import math
from typing import NamedTuple

import numpy as np
from numba import njit

from plumbline.constants import SPEED_OF_LIGHT_M_S
from plumbline.gnss.line_of_sight import light_time_range, light_time_range_rate
from plumbline.gnss.orbits_broadcast import broadcast_state
from plumbline.gnss.troposphere import ZENITH_HYDROSTATIC, ZENITH_WET, map_troposphere
from plumbline.records import Floats, Ints


class Sight(NamedTuple):
    """At e epochs and s satellites: ``range_m`` with the troposphere, directions, and the satellites' clocks."""

    range_m: Floats  # (e, s)
    range_rate_m_s: Floats
    clock_s: Floats
    clock_rate_s_s: Floats
    unit_enu: Floats  # (e, s, 3)
    azimuth_rad: Floats
    elevation_rad: Floats


@njit(cache=True)
def sight(
    rows: Floats,
    t_gps_ns: Ints,
    clock_s: Floats,
    position_ecef_m: Floats,
    velocity_ecef_m_s: Floats,
    enu: Floats,
    site: Floats,
) -> Sight:
    """What lies between satellites (packed ephemerides, s) and an antenna at receiver times (e,).

    ``clock_s`` (e,) is the receiver's offset, positions and velocities (e, 3), ``enu`` (3, 3) the rotation from
    Earth-fixed, ``site`` a troposphere site row. The signal's flight is found by iteration.
    """
    n_epochs, n_satellites = t_gps_ns.size, rows.shape[0]
    out = np.empty((6, n_epochs, n_satellites))
    units = np.empty((n_epochs, n_satellites, 3))
    place, speed, turned, unit = np.empty(3), np.empty(3), np.empty(3), np.empty(3)
    for s in range(n_satellites):
        flight_s = 0.08
        for e in range(n_epochs):
            clock, clock_rate, rho = 0.0, 0.0, 0.0
            for _ in range(4 if e == 0 else 2):
                t_sent_ns = t_gps_ns[e] - round((clock_s[e] + flight_s) * 1e9)
                clock, clock_rate, _relativity = broadcast_state(rows[s], t_sent_ns, place, speed)
                rho = light_time_range(place, position_ecef_m[e], turned)
                flight_s = rho / SPEED_OF_LIGHT_M_S
            for k in range(3):
                unit[k] = (turned[k] - position_ecef_m[e, k]) / rho
            for k in range(3):
                units[e, s, k] = enu[k, 0] * unit[0] + enu[k, 1] * unit[1] + enu[k, 2] * unit[2]
            azimuth = math.atan2(units[e, s, 0], units[e, s, 1]) % (2.0 * math.pi)
            elevation = math.asin(units[e, s, 2])
            mapped = map_troposphere(site, azimuth, max(elevation, 0.05))
            out[0, e, s] = rho + mapped[0] * site[ZENITH_HYDROSTATIC] + mapped[1] * site[ZENITH_WET]
            out[1, e, s] = light_time_range_rate(turned, speed, unit, rho, velocity_ecef_m_s[e])
            out[2, e, s], out[3, e, s] = clock, clock_rate
            out[4, e, s], out[5, e, s] = azimuth, elevation
    return Sight(out[0], out[1], out[2], out[3], units, out[4], out[5])
