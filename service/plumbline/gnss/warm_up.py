"""Compiles every kernel of this package that runs live, so that the first epoch does not wait for it."""

import math

import numpy as np

from plumbline.gnss.antenna import empty_antenna_book
from plumbline.gnss.earth_frames import (
    azimuth_elevation,
    ecef_from_geodetic,
    geodetic_from_ecef,
    rotation_enu_from_ecef,
)
from plumbline.gnss.line_of_sight import line_of_sight_model
from plumbline.gnss.orbits_broadcast import GLONASS, GM, KEPLER, KIND, N_COLUMNS, SQRT_A, STATE, TOE_S, broadcast_states
from plumbline.gnss.orbits_precise import N_NODES, build_tables
from plumbline.gnss.satellite_states import (
    broadcast_at_transmission,
    corrected_at_transmission,
    precise_at_transmission,
    precise_states,
)
from plumbline.gnss.ssr_orbits import N_SSR_COLUMNS
from plumbline.gnss.sun_moon import sun_moon_ecef
from plumbline.gnss.tides import ocean_loading_enu_m, solid_earth_tide_ecef_m
from plumbline.gnss.troposphere import troposphere_site
from plumbline.records import Floats, PreciseClocks, PreciseOrbits

_T_NS = 1_277_000_000 * 1_000_000_000


def _rows() -> Floats:
    rows = np.zeros((2, N_COLUMNS))
    rows[:, KIND] = KEPLER, GLONASS
    rows[:, TOE_S] = _T_NS // 1_000_000_000
    rows[0, SQRT_A], rows[0, GM] = 5153.7, 3.986005e14
    rows[1, STATE : STATE + 6] = 2.55e7, 0.0, 0.0, 0.0, 3000.0, 0.0
    return rows


def warm_up() -> None:
    """Call every kernel once with arguments of the types that the pipeline uses."""
    satellite, ranges = np.array([0, 64], np.int16), np.full(2, 2.2e7)
    place = geodetic_from_ecef(ecef_from_geodetic(0.9, 0.2, 50.0))
    receiver = ecef_from_geodetic(place[0], place[1], place[2])
    sun, moon = sun_moon_ecef(_T_NS, 18.0)
    states = broadcast_at_transmission(_rows(), _T_NS, ranges)
    broadcast_states(_rows(), np.full(2, _T_NS, np.int64))
    corrected_at_transmission(_rows(), np.full((2, N_SSR_COLUMNS), 0.0), _T_NS, ranges)
    nodes = _T_NS + np.arange(N_NODES, dtype=np.int64) * 900_000_000_000
    orbits = PreciseOrbits(satellite, nodes, np.full((N_NODES, 2, 3), 1.5e7))
    tables = build_tables(orbits, PreciseClocks(satellite, nodes, np.zeros((N_NODES, 2))))
    precise_at_transmission(tables, satellite, _T_NS, ranges)
    precise_states(tables, satellite, np.full(2, _T_NS, np.int64))
    los = line_of_sight_model(
        states,
        satellite,
        np.ones((2, 2), np.int8),
        receiver,
        np.zeros(3),
        troposphere_site(place[0], place[1], place[2], _T_NS),
        sun,
        np.full(2, math.nan),
        empty_antenna_book(),
        True,
    )
    azimuth_elevation(los.unit_ecef, rotation_enu_from_ecef(place[0], place[1]))
    solid_earth_tide_ecef_m(receiver, sun, moon, _T_NS, 18.0)
    ocean_loading_enu_m(np.zeros((3, 11)), np.zeros((3, 11)), _T_NS, 18.0)
