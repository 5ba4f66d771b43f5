"""The code biases of BeiDou-2's inclined and medium orbits, which grow with the elevation: up to a metre.

They arise in the satellites and are the same for all receivers. L. Wanninger, S. Beer, "BeiDou satellite-induced code
pseudorange variations: diagnosis and therapy", GPS Solutions 19, 2015, table 4: corrections *added* to the codes, by
orbit, band and elevation in steps of 10°. Geostationary satellites stand at one elevation; BeiDou-3 has no such bias.
"""

from typing import Final

import numpy as np
from numba import njit

from plumbline.constants import SPEED_OF_LIGHT_M_S
from plumbline.positioning.preprocess import SIGNAL_BAND
from plumbline.positioning.state import Records
from plumbline.signals import System

_BEIDOU: Final = int(System.BEIDOU)
#: Rows by RINEX band of the first index of _CORRECTION_M: B1I 2, B2I 7, B3I 6.
_ROW_OF_BAND: Final = np.array([-1, -1, 0, -1, -1, -1, 2, 1, -1, -1])
_CORRECTION_M: Final = np.array(
    [
        [  # inclined
            [-0.55, -0.40, -0.34, -0.23, -0.15, -0.04, 0.09, 0.19, 0.27, 0.35],
            [-0.71, -0.36, -0.33, -0.19, -0.14, -0.03, 0.08, 0.17, 0.24, 0.33],
            [-0.27, -0.23, -0.21, -0.15, -0.11, -0.04, 0.05, 0.14, 0.19, 0.32],
        ],
        [  # medium
            [-0.47, -0.38, -0.32, -0.23, -0.11, 0.06, 0.34, 0.69, 0.97, 1.05],
            [-0.40, -0.31, -0.26, -0.18, -0.06, 0.09, 0.28, 0.48, 0.64, 0.69],
            [-0.22, -0.15, -0.13, -0.10, -0.04, 0.05, 0.14, 0.27, 0.36, 0.47],
        ],
    ]
)


@njit(cache=True)
def _orbit_of(number: int) -> int:
    """0 inclined, 1 medium, −1 neither, of a BeiDou satellite number."""
    if 6 <= number <= 10 or number in (13, 16):
        return 0
    return 1 if number in (11, 12, 14) else -1


@njit(cache=True)
def _correction_m(orbit: int, band: int, elevation_rad: float) -> float:
    row = _ROW_OF_BAND[band]
    if row < 0:
        return 0.0
    step = min(max(elevation_rad * 18.0 / np.pi, 0.0), 9.0)
    k = min(int(step), 8)
    left, right = _CORRECTION_M[orbit, row, k], _CORRECTION_M[orbit, row, k + 1]
    return float(left + (right - left) * (step - k))


@njit(cache=True)
def correct_beidou_codes(pairs: Records, rows: Records) -> None:
    """Add the corrections to the pairs' codes and wide lanes, in place; ``rows`` hold the elevations."""
    for i in range(pairs.size):
        pair = pairs[i]
        if pair.system != _BEIDOU or pair.signal_1 < 0 or np.isnan(rows[i].sine):
            continue
        orbit = _orbit_of(pair.satellite % 64 + 1)
        if orbit < 0:
            continue
        elevation_rad = np.arcsin(rows[i].sine)
        first = _correction_m(orbit, SIGNAL_BAND[pair.signal_1], elevation_rad)
        second = _correction_m(orbit, SIGNAL_BAND[pair.signal_2], elevation_rad)
        f1, f2 = pair.frequency_1_hz, pair.frequency_2_hz
        pair.code_m += pair.alpha * first - (pair.alpha - 1.0) * second
        pair.wide_lane_cycles -= (f1 * first + f2 * second) / (f1 + f2) * (f1 - f2) / SPEED_OF_LIGHT_M_S
