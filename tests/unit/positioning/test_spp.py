"""Single-point positioning on made-up satellites whose geometry is exact."""

import numpy as np
import pytest
from scipy.stats import chi2

from plumbline.constants import EARTH_ROTATION_RATE_RAD_S, SPEED_OF_LIGHT_M_S
from plumbline.gnss.earth_frames import ecef_from_geodetic, rotation_enu_from_ecef
from plumbline.positioning.spp import _troposphere_m, single_point

PLACES = [(0.9, 0.2, 60.0), (-0.8, 2.5, 1200.0), (0.0, -1.6, 0.0), (1.5, 3.0, 2500.0)]


def _scene(place, n=12, systems=(0, 2)):
    """Receiver, satellites at transmission, codes with tropospheric delay, systems."""
    rng = np.random.default_rng(4)
    receiver = ecef_from_geodetic(*place)
    enu = rotation_enu_from_ecef(place[0], place[1])
    azimuth, elevation = rng.uniform(0, 2 * np.pi, n), np.arcsin(rng.uniform(0.15, 1.0, n))
    line = np.stack([np.cos(elevation) * np.sin(azimuth), np.cos(elevation) * np.cos(azimuth), np.sin(elevation)], 1)
    at_reception = receiver + rng.uniform(2.0e7, 2.6e7, n)[:, None] * (line @ enu)
    distance = np.linalg.norm(at_reception - receiver, axis=1)
    angle = -EARTH_ROTATION_RATE_RAD_S * distance / SPEED_OF_LIGHT_M_S
    c, s = np.cos(angle), np.sin(angle)
    x, y, z = at_reception.T
    satellite = np.stack([c * x + s * y, -s * x + c * y, z], axis=1)
    system = np.array([systems[i % len(systems)] for i in range(n)], np.int8)
    up = line @ np.array([0.0, 0.0, 1.0])
    geocentric = np.sum((at_reception - receiver) * receiver, axis=1) / distance / np.linalg.norm(receiver)
    delay = np.array([_troposphere_m(place[2], g) for g in geocentric])
    assert up.min() > 0.1
    return receiver, satellite, distance + delay, system


@pytest.mark.parametrize("place", PLACES)
def test_the_position_is_found_from_the_earths_centre(place):
    """Oracle: the place put in; clocks by system."""
    receiver, satellite, code, system = _scene(place)
    code = code + np.where(system == 0, 30_000.0, 30_050.0)
    point = single_point(satellite, np.zeros(12), code, np.ones(12), system)
    np.testing.assert_allclose(point.position_ecef_m, receiver, atol=0.02)
    assert point.clock_m[0] == pytest.approx(30_000.0, abs=0.02)
    assert point.clock_m[2] == pytest.approx(30_050.0, abs=0.02)
    assert np.isnan(point.clock_m[1])
    assert point.used.all()


def test_two_wrong_codes_are_left_out():
    """Oracle: the errors put in, 200 m and −80 m."""
    receiver, satellite, code, system = _scene(PLACES[0], n=14)
    code[3] += 200.0
    code[8] -= 80.0
    point = single_point(satellite, np.zeros(14), code, np.ones(14), system)
    assert np.flatnonzero(~point.used).tolist() == [3, 8]
    np.testing.assert_allclose(point.position_ecef_m, receiver, atol=0.02)


def test_too_few_or_nothing_is_no_position():
    """Oracle: three satellites, four of two systems, none, NaN everywhere."""
    _, satellite, code, system = _scene(PLACES[0])
    one = np.zeros(12)
    assert single_point(satellite[:3], one[:3], code[:3], one[:3] + 1, system[:3] * 0) is None
    assert single_point(satellite[:4], one[:4], code[:4], one[:4] + 1, system[:4]) is None
    assert single_point(satellite[:0], one[:0], code[:0], one[:0], system[:0]) is None
    assert single_point(satellite * np.nan, one, code, one + 1, system) is None


def test_codes_that_contradict_each_other_are_no_position():
    """Oracle: half of the codes are off by kilometres, each by its own."""
    _, satellite, code, system = _scene(PLACES[0], n=8)
    code[::2] += [3000.0, -5000.0, 8000.0, 13_000.0]
    assert single_point(satellite, np.zeros(8), code, np.ones(8), system) is None


def test_dilution_is_numpys():
    """Oracle: √trace of (AᵀA)⁻¹, NumPy."""
    receiver, satellite, code, system = _scene(PLACES[0])
    point = single_point(satellite, np.zeros(12), code, np.ones(12), system)
    line = satellite - receiver
    line /= np.linalg.norm(line, axis=1)[:, None]
    design = np.hstack([line, (system[:, None] == [0, 2]).astype(float)])
    assert point.pdop == pytest.approx(np.sqrt(np.trace(np.linalg.inv(design.T @ design)[:3, :3])), rel=1e-4)


def test_statistics_of_clean_codes_are_chi_square_and_wrong_ones_are_named():
    """Oracle: χ² of the redundancy over draws; three errors at once, each named in nearly all draws, few others."""
    _, satellite, code, system = _scene(PLACES[0], n=16)
    rng, total, freedom, named, others = np.random.default_rng(8), 0.0, 0, 0, 0
    line = single_point(satellite, np.zeros(16), code, np.ones(16), system)
    for _ in range(150):
        noisy = code + rng.normal(size=16) * _slant(satellite, line.position_ecef_m)
        clean = single_point(satellite, np.zeros(16), noisy, np.ones(16), system)
        total, freedom = total + clean.statistic, freedom + clean.degrees_of_freedom
        wrong = rng.choice(16, 3, replace=False)
        noisy[wrong] += rng.choice([-1.0, 1.0], 3) * rng.uniform(60.0, 300.0, 3)
        found = single_point(satellite, np.zeros(16), noisy, np.ones(16), system)
        if found is not None:
            named += int((~found.used[wrong]).sum())
            others += int((~found.used).sum() - (~found.used[wrong]).sum())
    assert chi2.ppf(0.0005, freedom) < total < chi2.ppf(0.9995, freedom)
    assert named > 0.97 * 450
    assert others < 0.03 * 450


def _slant(satellite, receiver):
    """One over the sine of the elevation, over the geocentric horizon, as the sigmas grow."""
    line = satellite - receiver
    return np.linalg.norm(line, axis=1) * np.linalg.norm(receiver) / (line @ receiver)
