"""Oracles: the IERS Conventions' published test cases of GPT and GMF, closed forms, geometry."""

import math

import numpy as np
import pytest

from plumbline.gnss.troposphere import (
    A_WET,
    C_HYDROSTATIC,
    HEIGHT_KM,
    PRESSURE_HPA,
    ZENITH_HYDROSTATIC,
    ZENITH_WET,
    map_troposphere,
    troposphere_site,
    zenith_hydrostatic_delay_m,
)

DAY_NS = 86_400 * 1_000_000_000
T_NS = (55_055 - 44_244) * DAY_NS  # MJD 55055
GREEN_BANK = (0.6708665767, -1.393397187)
UNDULATION_M = -42.19185643717770517  # GPT's case, revision of 2011


def test_pressure_and_geoid_are_gpts() -> None:
    site = troposphere_site(*GREEN_BANK, 812.546, T_NS)
    assert site[PRESSURE_HPA] == pytest.approx(918.0710638757363995, abs=1e-9)
    assert site[HEIGHT_KM] == pytest.approx((812.546 - UNDULATION_M) / 1000.0, abs=1e-12)


def test_mapping_factors_are_gmfs() -> None:
    site = troposphere_site(*GREEN_BANK, 844.715 + UNDULATION_M, T_NS)
    hydrostatic, wet, _, _ = map_troposphere(site, 0.0, math.pi / 2 - 1.278564131)
    assert hydrostatic == pytest.approx(3.425245519339138678, abs=1e-12)
    assert wet == pytest.approx(3.449589116182419257, abs=1e-12)


def test_the_seasons_are_opposite_on_the_southern_hemisphere() -> None:
    january, july = 15 * DAY_NS + 40 * 365 * DAY_NS, 197 * DAY_NS + 40 * 365 * DAY_NS
    for latitude, sign in ((0.8, 1.0), (-0.8, -1.0)):
        winter, summer = troposphere_site(latitude, 0.0, 0.0, january), troposphere_site(latitude, 0.0, 0.0, july)
        assert (winter[C_HYDROSTATIC] - summer[C_HYDROSTATIC]) * sign > 0.0
        assert winter[A_WET] != summer[A_WET]


def test_zenith_delays_are_saastamoinens() -> None:
    assert zenith_hydrostatic_delay_m(1013.25, math.pi / 4, 0.0) == pytest.approx(0.0022768 * 1013.25, abs=1e-12)
    site = troposphere_site(0.968, 0.147, 60.0, T_NS)
    assert 2.25 < site[ZENITH_HYDROSTATIC] < 2.35
    assert 0.05 < site[ZENITH_WET] < 0.12


def test_the_zenith_maps_to_one_and_has_no_gradient() -> None:
    site = troposphere_site(0.9, 0.2, 300.0, T_NS)
    hydrostatic, wet, north, east = map_troposphere(site, 1.0, math.pi / 2)
    assert (hydrostatic, wet) == pytest.approx((1.0, 1.0), abs=1e-12)
    assert math.hypot(north, east) < 1e-9


@pytest.mark.parametrize("azimuth", [0.0, 1.0, 3.0, 5.5])
def test_gradient_partials_are_chen_and_herrings(azimuth: float) -> None:
    site = troposphere_site(0.9, 0.2, 300.0, T_NS)
    elevation = math.radians(7.0)
    _, _, north, east = map_troposphere(site, azimuth, elevation)
    factor = 1.0 / (math.sin(elevation) * math.tan(elevation) + 0.0032)
    assert (north, east) == pytest.approx((factor * math.cos(azimuth), factor * math.sin(azimuth)))


def test_impossible_heights_and_elevations_stay_finite() -> None:
    for height in (-6.4e6, -5000.0, 2e7):
        site = troposphere_site(0.3, 0.2, height, T_NS)
        assert np.all(np.isfinite(site))
        assert np.all(np.isfinite(map_troposphere(site, 0.3, -1.0)))
