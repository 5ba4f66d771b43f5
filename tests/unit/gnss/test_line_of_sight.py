"""Oracles: light time solved in an inertial frame, derivatives by differences, geometry, the weak-field integral."""

import math

import numpy as np
import pytest

from plumbline.gnss.antenna import empty_antenna_book
from plumbline.gnss.earth_frames import ecef_from_geodetic, rotation_enu_from_ecef
from plumbline.gnss.line_of_sight import LineOfSight, light_time_range, light_time_range_rate, line_of_sight_model
from plumbline.gnss.orbits_broadcast import SatelliteStates, pack
from plumbline.gnss.relativity import shapiro_delay_m
from plumbline.gnss.satellite_states import broadcast_at_transmission
from plumbline.gnss.sun_moon import sun_moon_ecef
from plumbline.gnss.troposphere import ZENITH_HYDROSTATIC, map_troposphere, troposphere_site
from plumbline.gnss.warm_up import warm_up

from .make_ephemeris import T_NS, kepler

OMEGA, C = 7.2921151467e-5, 299_792_458.0
PLACE = (0.97, 0.15, 80.0)
RECEIVER = ecef_from_geodetic(*PLACE)
SATELLITE, VELOCITY = np.array([1.5e7, 1.2e7, 1.85e7]), np.array([-2100.0, 900.0, 1600.0])


def _turn(vector: np.ndarray, angle: float) -> np.ndarray:
    """Earth-fixed to inertial coordinates after the Earth has turned by an angle."""
    c, s = math.cos(angle), math.sin(angle)
    return np.array([c * vector[0] - s * vector[1], s * vector[0] + c * vector[1], vector[2]])


def _inertial_range(satellite: np.ndarray, receiver: np.ndarray) -> float:
    """Both points in the frame that stood over the Earth-fixed one at transmission; the receiver rides along."""
    flight = 0.08
    for _ in range(20):
        distance = float(np.linalg.norm(_turn(receiver, OMEGA * flight) - satellite))
        flight = distance / C
    return distance


def test_the_earth_turns_once_during_the_flight() -> None:
    turned = np.empty(3)
    got = light_time_range(SATELLITE, RECEIVER, turned)
    assert got == pytest.approx(_inertial_range(SATELLITE, RECEIVER), abs=1e-7)
    assert np.linalg.norm(turned - RECEIVER) == pytest.approx(got, abs=1e-7)
    sagnac = OMEGA / C * (SATELLITE[0] * RECEIVER[1] - SATELLITE[1] * RECEIVER[0])
    assert got - np.linalg.norm(SATELLITE - RECEIVER) == pytest.approx(sagnac, abs=1e-4)
    assert abs(sagnac) > 5.0


def test_the_range_rate_is_the_derivative_with_the_time_of_reception() -> None:
    own = np.array([3.0, -4.0, 5.0])

    def at(t: float) -> float:
        """Range at reception time t: find the time of transmission whose light arrives then."""
        transmission = t - 0.08
        for _ in range(10):
            rho = light_time_range(SATELLITE + VELOCITY * transmission, RECEIVER + own * t, np.empty(3))
            transmission = t - rho / C
        return rho

    turned = np.empty(3)
    t0_transmission = -at(0.0) / C
    rho = light_time_range(SATELLITE + VELOCITY * t0_transmission, RECEIVER, turned)
    got = light_time_range_rate(turned, VELOCITY, (turned - RECEIVER) / rho, rho, own)
    assert got == pytest.approx((at(0.5) - at(-0.5)) / 1.0, abs=2e-6)


def test_shapiro_is_the_integral_of_the_potential() -> None:
    gm = 3.986004418e14
    path = np.linspace(0.0, 1.0, 200_001)
    points = RECEIVER + path[:, None] * (SATELLITE - RECEIVER)
    rho = float(np.linalg.norm(SATELLITE - RECEIVER))
    inverse_radius = 1.0 / np.linalg.norm(points, axis=1)
    integral = 2.0 * gm / C**2 * rho * float(np.trapezoid(inverse_radius, path))
    got = shapiro_delay_m(float(np.linalg.norm(SATELLITE)), float(np.linalg.norm(RECEIVER)), rho)
    assert got == pytest.approx(integral, rel=1e-8)
    assert 0.005 < got < 0.03


def _model(states: SatelliteStates, receiver: np.ndarray, windup: np.ndarray) -> LineOfSight:
    n = len(states.status)
    sun, _ = sun_moon_ecef(T_NS, 18.0)
    return line_of_sight_model(
        states,
        np.full(n, 4, np.int16),
        np.ones((n, 2), np.int8),
        receiver,
        np.zeros(3),
        troposphere_site(*PLACE, T_NS),
        sun,
        windup,
        empty_antenna_book(),
        True,
    )


def _states(n: int = 12) -> SatelliteStates:
    rows = np.array([pack(kepler(mean_anomaly_rad=0.5 * k, ascending_node_rad=0.8 * k)) for k in range(n)])
    return broadcast_at_transmission(rows, T_NS, np.full(n, 2.3e7))


def test_the_model_agrees_with_its_parts() -> None:
    states = _states()
    los = _model(states, RECEIVER, np.full(12, np.nan))
    site, rotation = troposphere_site(*PLACE, T_NS), rotation_enu_from_ecef(PLACE[0], PLACE[1])
    for i in range(12):
        assert los.range_m[i] == light_time_range(states.position_ecef_m[i], RECEIVER, np.empty(3))
        enu = rotation @ los.unit_ecef[i]
        assert math.sin(los.elevation_rad[i]) == pytest.approx(enu[2], abs=1e-12)
        assert math.tan(los.azimuth_rad[i]) == pytest.approx(enu[0] / enu[1], rel=1e-9)
        assert 0.0 <= los.azimuth_rad[i] < 2.0 * math.pi
        hydrostatic, wet, north, east = map_troposphere(site, los.azimuth_rad[i], los.elevation_rad[i])
        assert los.hydrostatic_m[i] == pytest.approx(hydrostatic * site[ZENITH_HYDROSTATIC])
        assert (los.wet_mapping[i], los.gradient_north[i], los.gradient_east[i]) == (wet, north, east)
    assert np.all(los.antenna_m == 0.0)
    assert -0.5 <= los.windup_cycles.min() < los.windup_cycles.max() <= 0.5


def test_partials_are_derivatives_of_the_range() -> None:
    states = _states()
    at = _model(states, RECEIVER, np.full(12, np.nan))
    for axis in range(3):
        step = np.zeros(3)
        step[axis] = 1.0
        plus, minus = (_model(states, RECEIVER + s * step, np.full(12, np.nan)) for s in (1, -1))
        assert (plus.range_m - minus.range_m) / 2.0 == pytest.approx(-at.unit_ecef[:, axis], abs=2e-6)


def test_a_missing_state_is_nan_and_harms_no_other() -> None:
    states = _states()
    whole = _model(states, RECEIVER, np.full(12, np.nan))
    states.status[3] = 1
    part = _model(states, RECEIVER, np.full(12, np.nan))
    assert np.isnan(part.range_m[3])
    assert np.isnan(part.windup_cycles[3])
    others = np.arange(12) != 3
    assert np.array_equal(part.range_m[others], whole.range_m[others])


def test_warm_up_runs_every_kernel_without_complaint() -> None:
    warm_up()
