"""Gravity on the ellipsoid, to be taken off the vertical axis of an accelerometer."""

import math
from typing import Final

import numpy as np

from plumbline.constants import STANDARD_GRAVITY_M_S2
from plumbline.gnss.earth_frames import geodetic_from_ecef
from plumbline.records import Floats

_EQUATOR_M_S2: Final = 9.7803253359  # NIMA TR 8350.2 (WGS 84), table 3.4: theoretical gravity at the equator
_SOMIGLIANA_K: Final = 0.00193185265241  # the same
_ECCENTRICITY_SQUARED: Final = 0.00669437999014  # the same
_FREE_AIR_PER_S2: Final = 3.086e-6  # decrease with height, to first order


def normal_gravity_m_s2(latitude_rad: float, height_m: float) -> float:
    """WGS 84 normal gravity (Somigliana, NIMA TR 8350.2 eq. 4-1) with the free-air gradient; gravity, so with the
    centrifugal part: what an accelerometer at rest reads upwards."""
    s2 = math.sin(latitude_rad) ** 2
    on_ellipsoid = _EQUATOR_M_S2 * (1.0 + _SOMIGLIANA_K * s2) / math.sqrt(1.0 - _ECCENTRICITY_SQUARED * s2)
    return on_ellipsoid - _FREE_AIR_PER_S2 * height_m


def gravity_at_m_s2(position_ecef_m: Floats | tuple[float, float, float] | None) -> float:
    """Normal gravity at an Earth-fixed position; the standard value where the position is unknown."""
    if position_ecef_m is None:
        return STANDARD_GRAVITY_M_S2
    latitude_rad, _, height_m = geodetic_from_ecef(np.asarray(position_ecef_m, float))
    return normal_gravity_m_s2(float(latitude_rad), float(height_m))
