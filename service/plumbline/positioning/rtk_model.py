"""What the single differences should have measured at an approximate position, and what each of them is worth.

A receiver's residual is its measurement less range and troposphere (the satellite's clock and orbit come from the
same broadcast set for both receivers and cancel); the single difference is rover's residual less base's. With base data
of an earlier instant (bridged), each residual belongs to its own instant and the satellite's clock, which no longer
cancels by itself, is modelled by the broadcast set, with its short-term instability in the variance.
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from numba import njit

from plumbline.config import RtkSettings
from plumbline.constants import SPEED_OF_LIGHT_M_S
from plumbline.gnss.earth_frames import geodetic_from_ecef, rotation_enu_from_ecef
from plumbline.gnss.line_of_sight import light_time_range, light_time_range_rate
from plumbline.gnss.troposphere import ZENITH_HYDROSTATIC, ZENITH_WET, map_troposphere, troposphere_site
from plumbline.positioning.rtk_observations import satellites_in
from plumbline.positioning.satellites import Cause, SatelliteSource, SatelliteStates
from plumbline.positioning.state import Records
from plumbline.records import Epoch, Floats, Ints
from plumbline.signals import System

_GLONASS: Final = int(System.GLONASS)
_NS: Final = 1_000_000_000
_SAME_INSTANT_NS: Final = 2_000_000  # receivers' clocks steer to the millisecond
_CN0_REFERENCE_DB_HZ: Final = 45.0
_GLONASS_CODE_FACTOR: Final = 3.0  # inter-channel code biases
_CLOCK_INSTABILITY_M_S: Final = 0.0016  # of satellite clock and orbit predictions over some seconds
_ATMOSPHERE_RELATIVE: Final = 1e-6  # differential ionosphere and troposphere a distance between the antennas


@dataclass(frozen=True, slots=True)
class Place:
    """A receiver's antenna and what surrounds it."""

    position_ecef_m: Floats  # (3,) phase reference
    enu: Floats  # (3, 3)
    troposphere: Floats  # site row


def place_of(position_ecef_m: Floats, t_gps_ns: int) -> Place:
    """The place of an antenna."""
    geodetic = geodetic_from_ecef(position_ecef_m)
    site = troposphere_site(geodetic[0], geodetic[1], geodetic[2], t_gps_ns)
    return Place(position_ecef_m, rotation_enu_from_ecef(geodetic[0], geodetic[1]), site)


@njit(cache=True)
def _residual_range(position, velocity, place, enu, site, turned, unit):  # type: ignore[no-untyped-def]
    """(range + troposphere, range rate, sine of elevation) from a receiver; ``unit`` is filled."""
    rho = light_time_range(position, place, turned)
    for k in range(3):
        unit[k] = (turned[k] - place[k]) / rho
    east = enu[0, 0] * unit[0] + enu[0, 1] * unit[1] + enu[0, 2] * unit[2]
    north = enu[1, 0] * unit[0] + enu[1, 1] * unit[1] + enu[1, 2] * unit[2]
    up = enu[2, 0] * unit[0] + enu[2, 1] * unit[1] + enu[2, 2] * unit[2]
    elevation = np.arcsin(min(1.0, max(-1.0, up)))
    mapped = map_troposphere(site, np.arctan2(east, north), elevation)
    delay = mapped[0] * site[ZENITH_HYDROSTATIC] + mapped[1] * site[ZENITH_WET]
    rate = light_time_range_rate(turned, velocity, unit, rho, np.zeros(3))
    return rho + delay, rate, up


@njit(cache=True)
def _noise_factor(sine: float, cn0_db_hz: float) -> float:
    """Variance over that at the zenith: half of it constant, half with 1/sin² of the elevation, and by C/N0."""
    s = max(sine, 0.05)
    factor = 0.5 + 0.5 / (s * s)
    if not np.isnan(cn0_db_hz) and cn0_db_hz < _CN0_REFERENCE_DB_HZ:
        factor *= 10.0 ** (0.1 * min(_CN0_REFERENCE_DB_HZ - cn0_db_hz, 20.0) * 0.5)
    return factor


@njit(cache=True)
def _weigh(row, age_s, distance_m, sigma):  # type: ignore[no-untyped-def]
    """Set a row's weights from ``sigma`` (code, phase, range rate) of one receiver at the zenith."""
    factor = 2.0 * _noise_factor(row.sine, row.cn0_db_hz)
    common = (_CLOCK_INSTABILITY_M_S * age_s) ** 2 + (_ATMOSPHERE_RELATIVE * distance_m / max(row.sine, 0.1)) ** 2
    code = sigma[0] * (_GLONASS_CODE_FACTOR if row.system == _GLONASS else 1.0)
    row.code_weight = 0.0 if np.isnan(row.code_oc_m) else 1.0 / (factor * code * code + common)
    row.phase_weight = 0.0 if np.isnan(row.phase_oc_m) else 1.0 / (factor * sigma[1] * sigma[1] + common)
    row.range_rate_weight = 0.0 if np.isnan(row.range_rate_oc_m_s) else 1.0 / (factor * sigma[2] * sigma[2])


@njit(cache=True)
def _model(rows, index, states, base_states, rover, base, mask_sine, age_s, sigma):  # type: ignore[no-untyped-def]
    """Fill the rows' model; ``index`` names each row's satellite in the states (position, velocity, clock)."""
    distance_m = np.sqrt(np.sum((rover[0] - base[0]) ** 2))
    turned, unit, away = np.empty(3), np.empty(3), np.empty(3)
    last = -1
    range_m, rate, sine, range_base_m, rate_base = 0.0, 0.0, 0.0, 0.0, 0.0
    for i in range(rows.size):
        row, k = rows[i], index[i]
        row.code_weight, row.phase_weight, row.range_rate_weight = 0.0, 0.0, 0.0
        row.code_oc_m, row.phase_oc_m, row.range_rate_oc_m_s = np.nan, np.nan, np.nan
        row.sine = np.nan
        if np.isnan(states[2][k]) or np.isnan(base_states[2][k]):
            continue
        if k != last:
            velocity = states[1][k]
            range_m, rate, sine = _residual_range(states[0][k], velocity, rover[0], rover[1], rover[2], turned, unit)
            position = base_states[0][k].copy()
            if base_states[3]:  # states for the rover's signal: the base's left at another instant, less than ms away
                lead_s = (row.code_m - row.base_code_m) / SPEED_OF_LIGHT_M_S
                position += velocity * lead_s
            range_base_m, rate_base, _ = _residual_range(
                position, base_states[1][k], base[0], base[1], base[2], turned, away
            )
            range_m -= states[2][k]
            range_base_m -= base_states[2][k]
            last = k
        row.sine = sine
        if sine < mask_sine:
            continue
        for c in range(3):
            row.line[c] = unit[c]
        row.code_oc_m = (row.code_m - range_m) - (row.base_code_m - range_base_m)
        row.phase_oc_m = (row.phase_m - range_m) - (row.base_phase_m - range_base_m)
        own = row.range_rate_m_s - rate
        row.range_rate_oc_m_s = (
            own if np.isnan(row.base_range_rate_m_s) else own - (row.base_range_rate_m_s - rate_base)
        )
        _weigh(row, age_s, distance_m, sigma)


def satellites_of(
    rows: Records, rover: Epoch, base: Epoch, source: SatelliteSource
) -> tuple[SatelliteStates, SatelliteStates | None, Ints]:
    """States for the rover's signals, for the base's (None: the same instant), and each row's index among them.

    Both ask the source for the rover's instant, so that both get the same broadcast set; a base epoch that lies back is
    a pseudorange that much longer.
    """
    first, index = satellites_in(rows, False, False)
    satellite = rows["satellite"][first]
    t_ns, t_receive_ns = rover.t_gps_ns, rover.t_receive_ns
    states = source.broadcast(t_ns, t_receive_ns, satellite, rows["code_m"][first])
    lag_ns = t_ns - base.t_gps_ns
    if abs(lag_ns) < _SAME_INSTANT_NS:
        return states, None, index
    longer = rows["base_code_m"][first] + SPEED_OF_LIGHT_M_S * (lag_ns / _NS)
    return states, source.broadcast(t_ns, t_receive_ns, satellite, longer), index


def fill_model(
    rows: Records, states: SatelliteStates, base_states: SatelliteStates | None, index: Ints, rover: Place,
    base: Place, mask_rad: float, age_s: float, settings: RtkSettings,
) -> None:  # fmt: skip
    """Fill lines, differences and weights of the rows in place; not usable rows keep a weight of zero."""

    def usable_clock(s: SatelliteStates) -> Floats:
        clock: Floats = np.where(s.cause == Cause.USABLE, s.clock_m, np.nan)
        return clock

    other = base_states or states
    _model(
        rows, index,
        (states.position_ecef_m, states.velocity_ecef_m_s, usable_clock(states)),
        (other.position_ecef_m, other.velocity_ecef_m_s, usable_clock(other), base_states is None),
        (rover.position_ecef_m, rover.enu, rover.troposphere), (base.position_ecef_m, base.enu, base.troposphere),
        np.sin(mask_rad), abs(age_s),
        np.array([settings.code_sigma_m, settings.phase_sigma_m, settings.doppler_sigma_m_s]),
    )  # fmt: skip
