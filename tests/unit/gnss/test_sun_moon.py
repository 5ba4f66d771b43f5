"""Oracle: ERFA's epv00 and moon98, turned by IAU 2006/2000A to the Earth-fixed frame (computed with pyerfa 2.0)."""

from datetime import UTC, datetime

import numpy as np
import pytest

from plumbline.gnss.sun_moon import sun_moon_ecef
from plumbline.gps_time import gps_minus_utc_s, gps_ns_from_utc

CASES = [
    ((2015, 9, 16, 23), (-145977391429.0, -35594800379.0, 6497611612.0), (-246169746.0, -312702744.0, -70333071.0)),
    ((2018, 7, 15, 0), (-141379722003.0, -3675300034.0, 55879117947.0), (-301785137.0, -168524498.0, 100621043.0)),
    ((2020, 6, 25, 6), (-1670995868.0, 139583408748.0, 60325046873.0), (-287567142.0, 212274352.0, 114128366.0)),
    ((2023, 1, 21, 12), (138267508279.0, 6775142951.0, -50103921855.0), (321148925.0, -9852667.0, -154952318.0)),
    ((2026, 2, 6, 20), (-63421813460.0, -127295128605.0, -39232438316.0), (-185416823.0, 341959063.0, -69781912.0)),
]


def _angle_arcmin(a: np.ndarray, b: np.ndarray) -> float:
    sine = np.linalg.norm(np.cross(a, b)) / np.linalg.norm(a) / np.linalg.norm(b)
    return float(np.degrees(np.arcsin(sine)) * 60.0)


@pytest.mark.parametrize(("moment", "sun", "moon"), CASES)
def test_sun_and_moon_stand_where_erfa_puts_them(
    moment: tuple[int, int, int, int], sun: tuple[float, ...], moon: tuple[float, ...]
) -> None:
    t_gps_ns = gps_ns_from_utc(datetime(*moment, tzinfo=UTC))
    got_sun, got_moon = sun_moon_ecef(t_gps_ns, gps_minus_utc_s(t_gps_ns))
    assert np.dot(got_sun, sun) > 0
    assert np.dot(got_moon, moon) > 0
    assert _angle_arcmin(got_sun, np.array(sun)) < 0.5
    assert _angle_arcmin(got_moon, np.array(moon)) < 2.0
    assert np.linalg.norm(got_sun) == pytest.approx(np.linalg.norm(sun), rel=1e-4)
    assert np.linalg.norm(got_moon) == pytest.approx(np.linalg.norm(moon), rel=6e-4)
