"""Satellites at the time of transmission, from whichever source: broadcast, broadcast with SSR, or precise products.

The time of transmission of a signal is the time of reception on the receiver's own clock, less pseudorange / c, less
the satellite's clock offset: the receiver's clock error cancels (IS-GPS-200, 20.3.3.3.3).
"""

from enum import IntEnum
from typing import Final

import numpy as np
from numba import njit

from plumbline.constants import SPEED_OF_LIGHT_M_S
from plumbline.gnss.orbits_broadcast import SatelliteStates, broadcast_clock_s, broadcast_state, row_status
from plumbline.gnss.orbits_precise import PreciseTables, interpolate_clock, interpolate_orbit
from plumbline.gnss.relativity import periodic_clock_s
from plumbline.gnss.ssr_orbits import clock_correction_s, correct_orbit, has_orbit_and_clock
from plumbline.records import Floats, Ints, SatelliteIds


class StateStatus(IntEnum):
    """Why a satellite's state is not there (``SatelliteStates.status``)."""

    OK = 0
    NO_EPHEMERIS = 1
    NO_CORRECTION = 2
    NO_PSEUDORANGE = 3
    NO_ORBIT = 4  # the precise orbits do not hold the satellite at all
    ORBIT_OUTSIDE = 5  # before the first or after the last node
    ORBIT_GAP = 6  # too few nodes in a row around the time
    NO_CLOCK = 7
    CLOCK_OUTSIDE = 8
    CLOCK_GAP = 9
    CLOCK_JUMP = 10  # the clock jumped between the two nodes
    EPHEMERIS_TOO_OLD = 11  # GLONASS: hours away from its state vector


STATE_TEXT: Final[dict[int, str]] = {
    StateStatus.OK: "",
    StateStatus.NO_EPHEMERIS: "no ephemeris",
    StateStatus.NO_CORRECTION: "no orbit and clock correction",
    StateStatus.NO_PSEUDORANGE: "no pseudorange",
    StateStatus.NO_ORBIT: "not in the precise orbits",
    StateStatus.ORBIT_OUTSIDE: "time outside the precise orbits",
    StateStatus.ORBIT_GAP: "gap in the precise orbits",
    StateStatus.NO_CLOCK: "not in the precise clocks",
    StateStatus.CLOCK_OUTSIDE: "time outside the precise clocks",
    StateStatus.CLOCK_GAP: "gap in the precise clocks",
    StateStatus.CLOCK_JUMP: "jump of the precise clock",
    StateStatus.EPHEMERIS_TOO_OLD: "ephemeris too old to integrate",
}


@njit(cache=True)
def _empty_states(n: int) -> SatelliteStates:
    position, velocity = np.full((n, 3), np.nan), np.full((n, 3), np.nan)
    clock, rate, relativity = np.full(n, np.nan), np.full(n, np.nan), np.full(n, np.nan)
    return SatelliteStates(position, velocity, clock, rate, relativity, np.zeros(n, np.int64))


@njit(cache=True)
def _flight_ns(pseudorange_m: float, clock_s: float) -> int:
    return round((pseudorange_m / SPEED_OF_LIGHT_M_S + clock_s) * 1e9)


@njit(cache=True)
def broadcast_at_transmission(rows: Floats, t_receive_clock_ns: int, pseudorange_m: Floats) -> SatelliteStates:
    """States (n) at transmission from broadcast ephemerides.

    ``rows`` (n, N_COLUMNS) from :func:`plumbline.gnss.orbits_broadcast.pack`, ``t_receive_clock_ns`` the epoch's own
    time tag, GPS ns, ``pseudorange_m`` (n,) any code of the satellite. Positions are Earth-fixed at transmission.
    """
    n = rows.shape[0]
    out = _empty_states(n)
    for i in range(n):
        out.status[i] = row_status(rows[i], t_receive_clock_ns)
        if out.status[i] != 0:
            continue
        if not pseudorange_m[i] > 0.0:
            out.status[i] = 3
        else:
            t_ns = t_receive_clock_ns - _flight_ns(pseudorange_m[i], 0.0)
            t_ns = t_receive_clock_ns - _flight_ns(pseudorange_m[i], broadcast_clock_s(rows[i], t_ns))
            out.clock_s[i], out.clock_rate_s_s[i], out.relativity_s[i] = broadcast_state(
                rows[i], t_ns, out.position_ecef_m[i], out.velocity_ecef_m_s[i]
            )
    return out


@njit(cache=True)
def corrected_at_transmission(
    rows: Floats, corrections: Floats, t_receive_clock_ns: int, pseudorange_m: Floats
) -> SatelliteStates:
    """States (n) at transmission from broadcast ephemerides with SSR; status 2 where a correction is missing.

    ``corrections`` (n, N_SSR_COLUMNS) from :func:`plumbline.gnss.ssr_orbits.pack_correction`; the caller has matched
    issues of data and ages. The rest as :func:`broadcast_at_transmission`.
    """
    out = broadcast_at_transmission(rows, t_receive_clock_ns, pseudorange_m)
    for i in range(rows.shape[0]):
        if out.status[i] != 0:
            continue
        if not has_orbit_and_clock(corrections[i]):
            out.status[i] = 2
            out.position_ecef_m[i], out.velocity_ecef_m_s[i], out.clock_s[i] = np.nan, np.nan, np.nan
            continue
        t_ns = t_receive_clock_ns - _flight_ns(pseudorange_m[i], out.clock_s[i])
        correct_orbit(corrections[i], t_ns, out.position_ecef_m[i], out.velocity_ecef_m_s[i])
        out.clock_s[i] += clock_correction_s(corrections[i], t_ns)
    return out


@njit(cache=True)
def precise_at_transmission(
    tables: PreciseTables, satellite: SatelliteIds, t_receive_clock_ns: int, pseudorange_m: Floats
) -> SatelliteStates:
    """States (n) at transmission of satellite ids (n,) from precise orbits and clocks (centres of mass).

    ``tables`` from :func:`plumbline.gnss.orbits_precise.build_tables`. The periodic relativistic term is added to the
    clock.
    """
    n = satellite.shape[0]
    out = _empty_states(n)
    for i in range(n):
        if not pseudorange_m[i] > 0.0:
            out.status[i] = 3
            continue
        t_ns = t_receive_clock_ns - _flight_ns(pseudorange_m[i], 0.0)
        clock, rate, status = interpolate_clock(tables, satellite[i], t_ns)
        if status == 0:
            t_ns = t_receive_clock_ns - _flight_ns(pseudorange_m[i], clock)
            clock, rate, status = interpolate_clock(tables, satellite[i], t_ns)
        if status == 0:
            status = interpolate_orbit(tables, satellite[i], t_ns, out.position_ecef_m[i], out.velocity_ecef_m_s[i])
        out.status[i] = status
        if status == 0:
            out.relativity_s[i] = periodic_clock_s(out.position_ecef_m[i], out.velocity_ecef_m_s[i])
            out.clock_s[i] = clock + out.relativity_s[i]
            out.clock_rate_s_s[i] = rate
    return out


@njit(cache=True)
def precise_states(tables: PreciseTables, satellite: SatelliteIds, t_gps_ns: Ints) -> SatelliteStates:
    """States of satellite ids (n,) at GPS times (n,) int64 ns from precise orbits and clocks; else as above."""
    n = satellite.shape[0]
    out = _empty_states(n)
    for i in range(n):
        clock, rate, status = interpolate_clock(tables, satellite[i], t_gps_ns[i])
        orbit_status = interpolate_orbit(
            tables, satellite[i], t_gps_ns[i], out.position_ecef_m[i], out.velocity_ecef_m_s[i]
        )
        out.status[i] = orbit_status if orbit_status != 0 else status
        if orbit_status == 0:
            out.relativity_s[i] = periodic_clock_s(out.position_ecef_m[i], out.velocity_ecef_m_s[i])
            out.clock_s[i] = clock + out.relativity_s[i]
            out.clock_rate_s_s[i] = rate
    return out
