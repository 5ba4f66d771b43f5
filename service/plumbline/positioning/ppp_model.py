"""What each satellite's code and phase should have measured: the observation equations of dual-frequency PPP.

For the ionosphere-free code P and phase L of one satellite (Kouba & Héroux 2001, eqs 1-2, with gradients after Chen &
Herring 1997)::

    P = |Rω·s − r| + shapiro + c(dt_r − dt_s) + m_h ZHD + m_w ZWD + m_g (G_N cos A + G_E sin A) + antennas + ε
    L = the same + c/(f₁ + f₂) · wind-up + B + ε

``s`` satellite at transmission, ``Rω`` the Earth's turn during flight, ``r`` antenna reference point (marker + antenna
height + tides). The physics is :func:`plumbline.gnss.line_of_sight.line_of_sight_model`; here its terms are combined.
"""

from typing import Final

import numpy as np
from numba import njit
from numpy.typing import NDArray

from plumbline.constants import SPEED_OF_LIGHT_M_S
from plumbline.gnss.antenna import AntennaBook
from plumbline.gnss.line_of_sight import LineOfSight, line_of_sight_model
from plumbline.gnss.orbits_broadcast import SatelliteStates
from plumbline.positioning.preprocess import SIGNAL_BAND
from plumbline.positioning.state import Records
from plumbline.records import Floats

MODEL_DTYPE: Final = np.dtype(
    [
        ("usable", np.bool_),  # orbit, clock and two frequencies are there and the satellite is above the mask
        ("line", np.float64, 3),  # unit vector receiver → satellite, Earth-fixed
        ("sine", np.float64),  # of the elevation; NaN without orbit
        ("wet", np.float64),  # partial to the zenith wet delay
        ("gradient_north", np.float64),
        ("gradient_east", np.float64),
        ("predicted_m", np.float64),  # without receiver clock, wet delay, gradients, ambiguity, wind-up
        ("wind_up_m", np.float64),
        ("wind_up_cycles", np.float64),
        ("eclipsed", np.bool_),
    ],
    align=True,
)


@njit(cache=True)
def previous_wind_up(pairs: Records, arcs: Records) -> Floats:
    """Wind-up of each pair's satellite at the epoch before, cycles (n,), NaN where it had none."""
    out = np.full(pairs.size, np.nan)
    arc = 0
    for i in range(pairs.size):
        while arc < arcs.size and arcs[arc].satellite < pairs[i].satellite:
            arc += 1
        if arc < arcs.size and arcs[arc].satellite == pairs[i].satellite:
            out[i] = arcs[arc].wind_up_cycles
    return out


@njit(cache=True)
def antenna_bands(pairs: Records) -> NDArray[np.int8]:
    """RINEX bands of each pair's two frequencies, (n, 2)."""
    bands = np.zeros((pairs.size, 2), np.int8)
    for i in range(pairs.size):
        if pairs[i].signal_1 >= 0:
            bands[i, 0], bands[i, 1] = SIGNAL_BAND[pairs[i].signal_1], SIGNAL_BAND[pairs[i].signal_2]
        elif pairs[i].frequency_2_hz > 0.0:
            bands[i, 0], bands[i, 1] = 1, 2
    return bands


@njit(cache=True)
def combine(sight: LineOfSight, pairs: Records, clock_m: Floats, mask_rad: float) -> Records:
    """Model rows (n,) of the pairs from their lines of sight and satellite clocks (n,), ionosphere-free."""
    rows = np.zeros(pairs.size, MODEL_DTYPE)
    for i in range(pairs.size):
        row, pair = rows[i], pairs[i]
        row.sine = np.sin(sight.elevation_rad[i])
        row.usable = sight.elevation_rad[i] >= mask_rad and pair.frequency_2_hz > 0.0 and not np.isnan(clock_m[i])
        if not row.usable:
            continue
        for k in range(3):
            row.line[k] = sight.unit_ecef[i, k]
        row.wet = sight.wet_mapping[i]
        row.gradient_north, row.gradient_east = sight.gradient_north[i], sight.gradient_east[i]
        antennas = pair.alpha * sight.antenna_m[i, 0] - (pair.alpha - 1.0) * sight.antenna_m[i, 1]
        row.predicted_m = (
            sight.range_m[i] + sight.shapiro_m[i] + sight.hydrostatic_m[i] - clock_m[i] + antennas
        )  # fmt: skip
        row.wind_up_cycles = sight.windup_cycles[i]
        row.wind_up_m = row.wind_up_cycles * SPEED_OF_LIGHT_M_S / (pair.frequency_1_hz + pair.frequency_2_hz)
        row.eclipsed = sight.eclipsed[i]
    return rows


@njit(cache=True)
def model_rows(
    states: SatelliteStates, pairs: Records, arcs: Records, clock_m: Floats, point_m: Floats, site: Floats,
    sun_m: Floats, antennas: AntennaBook, satellite_antennas_apply: bool, mask_rad: float,
) -> Records:  # fmt: skip
    """Model rows (n,) of the pairs for an antenna reference point (3,) that stands still."""
    satellite = np.empty(pairs.size, np.int16)
    for i in range(pairs.size):
        satellite[i] = pairs[i].satellite
    sight = line_of_sight_model(
        states, satellite, antenna_bands(pairs), point_m, np.zeros(3), site, sun_m, previous_wind_up(pairs, arcs),
        antennas, satellite_antennas_apply,
    )  # fmt: skip
    return combine(sight, pairs, clock_m, mask_rad)


@njit(cache=True)
def keep_wind_up(rows: Records, arcs: Records, arc_of_pair: NDArray[np.int64]) -> None:
    """Remember the wind-up in the arcs, in place."""
    for i in range(rows.size):
        if rows[i].usable and arc_of_pair[i] >= 0:
            arcs[arc_of_pair[i]].wind_up_cycles = rows[i].wind_up_cycles
