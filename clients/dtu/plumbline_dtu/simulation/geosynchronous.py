"""BeiDou's other orbits, for places where they fill the sky: geostationary, inclined geosynchronous, BeiDou-2's medium.

Longitudes of the geostationary satellites and of the inclined ones' crossings are those of the BeiDou-2 and BeiDou-3
systems (BDS-OS-PS-3.0, section 3.1, and the test service centre's constellation pages), phases are nominal.
"""

import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Final

import numpy as np

from plumbline.constants import EARTH_GM_BEIDOU_M3_S2, EARTH_ROTATION_RATE_BEIDOU_RAD_S
from plumbline.records import KeplerEphemeris
from plumbline.signals import System, number_of, satellite_id

#: East longitudes of the geostationary satellites, degrees, by number.
GEOSTATIONARY_DEG: Final = {1: 140.1, 2: 80.3, 3: 110.5, 4: 160.0, 5: 58.75, 59: 140.0, 60: 80.0, 61: 110.4}
#: Longitude at which the inclined geosynchronous satellites cross the equator northwards, and their phase, degrees.
INCLINED_DEG: Final = {
    6: (118.0, 0.0), 7: (118.0, 120.0), 8: (118.0, 240.0), 9: (94.5, 180.0), 10: (94.5, 300.0), 13: (94.5, 60.0),
    16: (112.0, 200.0), 43: (111.0, 30.0), 44: (111.0, 150.0), 45: (111.0, 270.0),
}  # fmt: skip
#: BeiDou-2's medium orbits: node and phase, degrees.
MEDIUM_DEG: Final = {11: (0.0, 0.0), 12: (0.0, 45.0), 14: (120.0, 15.0)}
#: Numbers of the satellites of the second generation.
BEIDOU_2: Final = frozenset({*range(1, 15), 16})
_RADIUS_M: Final = (EARTH_GM_BEIDOU_M3_S2 / EARTH_ROTATION_RATE_BEIDOU_RAD_S**2) ** (1.0 / 3.0)
_INCLINATION_RAD: Final = math.radians(55.0)
_GEO_TILT_RAD: Final = math.radians(5.0)  # the frame that geostationary elements are given in is turned by this


def geosynchronous_orbits(medium: KeplerEphemeris, tow_s: float, seed: int) -> Iterator[KeplerEphemeris]:
    """True elements at the reference time of ``medium``, a satellite of the medium orbit that lends the rest.

    ``tow_s`` is that time in the BeiDou week, s.
    """
    turned = EARTH_ROTATION_RATE_BEIDOU_RAD_S * tow_s
    for number, degrees in GEOSTATIONARY_DEG.items():
        orbit = _orbit(medium, number, seed, "D2")
        # equatorial: seen from the tilted frame the node lies at 180 degrees, and longitudes count on from there
        yield replace(
            orbit,
            inclination_rad=_GEO_TILT_RAD,
            ascending_node_rad=math.pi + turned,
            ascending_node_rate_rad_s=0.0,
            mean_anomaly_rad=math.radians(degrees) - math.pi,
        )
    for number, (crossing, phase) in INCLINED_DEG.items():
        orbit = _orbit(medium, number, seed, "D1")
        node = math.radians(crossing - phase) + turned
        yield replace(
            orbit,
            inclination_rad=_INCLINATION_RAD,
            ascending_node_rad=node,
            ascending_node_rate_rad_s=0.0,
            mean_anomaly_rad=math.radians(phase),
        )
    for number, (node_deg, phase) in MEDIUM_DEG.items():
        orbit = _orbit(medium, number, seed, "D1")
        yield replace(
            orbit,
            sqrt_semi_major_axis_sqrt_m=medium.sqrt_semi_major_axis_sqrt_m,
            inclination_rad=_INCLINATION_RAD,
            ascending_node_rad=math.radians(node_deg) + turned,
            mean_anomaly_rad=math.radians(phase),
        )


def is_beidou_2(satellite: int) -> bool:
    """Whether a satellite id is one of BeiDou's second generation."""
    return satellite // 64 == System.BEIDOU and number_of(satellite) in BEIDOU_2


def _orbit(medium: KeplerEphemeris, number: int, seed: int, message: str) -> KeplerEphemeris:
    satellite = satellite_id(System.BEIDOU, number)
    random = np.random.default_rng([seed, satellite])
    return replace(
        medium,
        satellite=satellite,
        message=message,
        sqrt_semi_major_axis_sqrt_m=math.sqrt(_RADIUS_M),
        eccentricity=2e-4,
        clock_bias_s=float(random.uniform(-2e-4, 2e-4)),
    )
