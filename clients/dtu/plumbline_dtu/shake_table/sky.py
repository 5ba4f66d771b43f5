"""Which satellites were received in Hong Kong on that day.

The constellation is nominal, its reference time chosen so that as many stand above the mask as the paper's section 3
counts: 8–9 of GPS and 16–17 of BeiDou, eight of them of the second generation, which are all that antenna 2 has.
"""

import math
from typing import Final

import numpy as np
from numpy.typing import NDArray

from plumbline.gps_time import NS_PER_S
from plumbline.records import Booleans, Floats
from plumbline.signals import SATELLITES_PER_SYSTEM, System
from plumbline_dtu.shake_table.experiment import START_GPS_NS
from plumbline_dtu.simulation.constellation import Constellation
from plumbline_dtu.simulation.geosynchronous import is_beidou_2

_REFERENCE_GPS_NS: Final = START_GPS_NS - 45_000 * NS_PER_S
_SEED: Final = 1  # one day, one sky: the same for all runs
#: BeiDou satellites that the receivers track: those of the second generation, and the medium ones of the third.
_BEIDOU_NUMBERS: Final = frozenset({*range(1, 10), *range(19, 43)})
MASK_DEG: Final = 10.0
BLOCKED_BELOW_DEG: Final = 30.0
BLOCKED_AZIMUTHS_DEG: Final = (90.0, 180.0)


def constellation() -> Constellation:
    """GPS and BeiDou of the day."""
    return Constellation(_REFERENCE_GPS_NS, "GC", _SEED, geosynchronous=True)


def tracked(satellites: NDArray[np.int16], beidou_2_only: bool) -> Booleans:
    """Whether a receiver tracks them at all (n,)."""
    system, number = satellites // SATELLITES_PER_SYSTEM, satellites % SATELLITES_PER_SYSTEM + 1
    known = (system == System.GPS) | np.isin(number, sorted(_BEIDOU_NUMBERS))
    if beidou_2_only:
        known &= (system == System.GPS) | np.array([is_beidou_2(int(satellite)) for satellite in satellites])
    return np.asarray(known)


def visible(azimuth_rad: Floats, elevation_rad: Floats) -> Booleans:
    """Whether the surroundings let the satellites through: nothing low in the south-east, where buildings stand."""
    first, last = (math.radians(angle) for angle in BLOCKED_AZIMUTHS_DEG)
    south_east = (azimuth_rad > first) & (azimuth_rad < last)
    return np.asarray(elevation_rad > np.where(south_east, math.radians(BLOCKED_BELOW_DEG), math.radians(MASK_DEG)))
