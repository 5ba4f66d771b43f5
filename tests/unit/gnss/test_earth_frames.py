"""Oracles: closed forms both ways, orthogonality, ERFA (IAU 2006 sidereal time; values computed with pyerfa 2.0)."""

import math
from datetime import UTC, datetime

import numpy as np
import pytest

from plumbline.gnss.earth_frames import (
    azimuth_elevation,
    ecef_from_geodetic,
    geodetic_from_ecef,
    greenwich_sidereal_time_rad,
    rotate_about_z,
    rotation_enu_from_ecef,
)
from plumbline.gps_time import gps_minus_utc_s, gps_ns_from_utc


@pytest.mark.parametrize("latitude", [-90.0, -45.3, -1e-9, 0.0, 33.0, 55.49, 89.9999, 90.0])
@pytest.mark.parametrize("height", [-400.0, 0.0, 9000.0, 2.02e7])
def test_geodetic_coordinates_are_the_inverse_of_the_closed_form(latitude: float, height: float) -> None:
    wanted = (math.radians(latitude), math.radians(-171.2), height)
    got = geodetic_from_ecef(ecef_from_geodetic(*wanted))
    assert got[0] == pytest.approx(wanted[0], abs=1e-14)
    assert got[2] == pytest.approx(height, abs=1e-8)
    if abs(latitude) < 90.0:
        assert got[1] == pytest.approx(wanted[1], abs=1e-14)


def test_the_centre_of_the_earth_is_no_trap() -> None:
    assert np.all(np.isfinite(geodetic_from_ecef(np.zeros(3))))


def test_up_is_the_gradient_of_height_and_north_of_latitude() -> None:
    place = np.array([0.9, -2.0, 100.0])
    rotation = rotation_enu_from_ecef(place[0], place[1])
    assert rotation @ rotation.T == pytest.approx(np.eye(3), abs=1e-15)
    here = ecef_from_geodetic(*place)
    for row, step in ((0, [0, 1e-7, 0]), (1, [1e-7, 0, 0]), (2, [0, 0, 1.0])):
        moved = ecef_from_geodetic(*(place + step)) - here
        assert rotation @ moved / np.linalg.norm(moved) == pytest.approx(np.eye(3)[row], abs=1e-6)


def test_azimuth_runs_from_north_over_east() -> None:
    rotation = rotation_enu_from_ecef(0.6, 0.3)
    enu = np.array([[1.0, 1.0, 0.0], [1.0, 0.0, 0.0], [0.0, -1.0, 1.0], [-1.0, 0.0, 1.0]])
    unit = (enu / np.linalg.norm(enu, axis=1)[:, None]) @ rotation
    azimuth, elevation = azimuth_elevation(unit, rotation)
    assert np.degrees(azimuth) == pytest.approx([45.0, 90.0, 180.0, 270.0], abs=1e-9)
    assert np.degrees(elevation) == pytest.approx([0.0, 0.0, 45.0, 45.0], abs=1e-9)


@pytest.mark.parametrize(
    ("moment", "gmst_rad"),
    [
        ((2015, 9, 16, 23), 5.944090790930708),
        ((2018, 7, 15, 0), 5.110332210759274),
        ((2020, 6, 25, 6), 0.06705831275724695),
        ((2026, 2, 6, 20), 1.3433017467070347),
    ],
)
def test_sidereal_time_is_erfas(moment: tuple[int, int, int, int], gmst_rad: float) -> None:
    t_gps_ns = gps_ns_from_utc(datetime(*moment, tzinfo=UTC))
    assert greenwich_sidereal_time_rad(t_gps_ns, gps_minus_utc_s(t_gps_ns)) == pytest.approx(gmst_rad, abs=1e-11)


def test_turning_the_frame_moves_a_fixed_vector_backwards() -> None:
    assert rotate_about_z(np.array([1.0, 0.0, 5.0]), math.pi / 2) == pytest.approx([0.0, -1.0, 5.0], abs=1e-15)
