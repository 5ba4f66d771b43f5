"""Oracles: the IERS Conventions' published test case of DEHANTTIDEINEL, closed forms of single ocean tides."""

import math

import numpy as np
import pytest

from plumbline.gnss.earth_frames import ecef_from_geodetic, rotation_enu_from_ecef
from plumbline.gnss.sun_moon import sun_moon_ecef
from plumbline.gnss.tides import ocean_loading_enu_m, solid_earth_tide_ecef_m
from plumbline.gps_time import gps_ns_from_calendar

NS = 1_000_000_000


def test_the_conventions_own_case() -> None:
    station = np.array([4075578.385, 931852.890, 4801570.154])
    sun = np.array([137859926952.015, 54228127881.4350, 23509422341.6960])
    moon = np.array([-179996231.920342, -312468450.131567, -169288918.592160])
    t_gps_ns = gps_ns_from_calendar(2009, 4, 13, 0, 0, 15 * NS)
    got = solid_earth_tide_ecef_m(station, sun, moon, t_gps_ns, 15.0)
    wanted = [0.7700420357108125891e-01, 0.6304056321824967613e-01, 0.5516568152597246810e-01]
    assert got == pytest.approx(wanted, abs=1e-15)


def test_the_permanent_tide_stays_in() -> None:
    """A year's mean is the permanent tide, −0.12 m (3/2 sin² φ − 1/2) radially (IERS Conventions 2010, eq. 7.14a)."""
    for latitude in (0.1, 0.9, 1.4):
        station = ecef_from_geodetic(latitude, 0.5, 0.0)
        up = rotation_enu_from_ecef(latitude, 0.5)[2]
        heights = []
        for hour in range(0, 24 * 365, 17):
            t_gps_ns = gps_ns_from_calendar(2020, 1, 1, 0, 0, 0) + hour * 3600 * NS
            heights.append(up @ solid_earth_tide_ecef_m(station, *sun_moon_ecef(t_gps_ns, 18.0), t_gps_ns, 18.0))
        assert np.mean(heights) == pytest.approx(-0.1206 * (1.5 * math.sin(latitude) ** 2 - 0.5), abs=0.004)
        assert np.ptp(heights) > 0.15 * math.cos(latitude) ** 2


def test_a_single_ocean_tide_is_a_cosine_of_its_period() -> None:
    amplitude, phase = np.zeros((3, 11)), np.zeros((3, 11))
    amplitude[:, 1] = 0.01, 0.002, 0.003  # S2, whose argument is twice the mean Sun's hour angle: exactly 12 h of UTC
    phase[:, 1] = 0.4, 1.0, -2.0
    noon = gps_ns_from_calendar(2020, 6, 25, 12, 0, 18 * NS)
    for hours in (0.0, 1.7, 6.0, 11.0):
        got = ocean_loading_enu_m(amplitude, phase, noon + round(hours * 3600 * NS), 18.0)
        angle = 2.0 * math.pi * hours / 12.0
        up, west, south = (a * math.cos(angle - p) for a, p in zip(amplitude[:, 1], phase[:, 1], strict=True))
        assert got == pytest.approx([-west, -south, up], abs=2e-7)


def test_ocean_loading_is_continuous_at_midnight() -> None:
    rng = np.random.default_rng(1)
    amplitude, phase = rng.uniform(0, 0.02, (3, 11)), rng.uniform(-3, 3, (3, 11))
    midnight = gps_ns_from_calendar(2023, 3, 1, 0, 0, 18 * NS)
    before = ocean_loading_enu_m(amplitude, phase, midnight - NS, 18.0)
    after = ocean_loading_enu_m(amplitude, phase, midnight, 18.0)
    assert before == pytest.approx(after, abs=5e-5)
