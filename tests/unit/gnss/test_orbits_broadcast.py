"""Oracles: differences, the formulas of IS-GPS-200 written plainly, a truly geostationary orbit, identities."""

import math

import numpy as np
import pytest

from plumbline.constants import EARTH_GM_GLONASS_M3_S2, EARTH_ROTATION_RATE_GLONASS_RAD_S
from plumbline.gnss.orbits_broadcast import (
    KEPLER_GEO,
    KIND,
    broadcast_states,
    empty_row,
    is_beidou_geo,
    pack,
    seconds_since,
)
from plumbline.gnss.orbits_glonass import integrate
from plumbline.records import Ephemeris, KeplerEphemeris
from plumbline.signals import satellite_of_name

from .make_ephemeris import T_NS, glonass, kepler

NS = 1_000_000_000
C = 299_792_458.0


def numpy_position(e: KeplerEphemeris, dt: float, gm: float, rate: float, toe_of_week: float) -> np.ndarray:
    """IS-GPS-200 table 20-IV, written down plainly."""
    a = e.sqrt_semi_major_axis_sqrt_m**2
    m = e.mean_anomaly_rad + (math.sqrt(gm / a**3) + e.mean_motion_difference_rad_s) * dt
    anomaly = m
    for _ in range(50):
        anomaly = m + e.eccentricity * math.sin(anomaly)
    half = math.sqrt((1 + e.eccentricity) / (1 - e.eccentricity)) * math.tan(anomaly / 2)
    phi = 2 * math.atan(half) + e.argument_of_perigee_rad
    u = phi + e.cus_rad * math.sin(2 * phi) + e.cuc_rad * math.cos(2 * phi)
    r = a * (1 - e.eccentricity * math.cos(anomaly)) + e.crs_m * math.sin(2 * phi) + e.crc_m * math.cos(2 * phi)
    i = (
        e.inclination_rad
        + e.inclination_rate_rad_s * dt
        + e.cis_rad * math.sin(2 * phi)
        + e.cic_rad * math.cos(2 * phi)
    )
    node = e.ascending_node_rad + (e.ascending_node_rate_rad_s - rate) * dt - rate * toe_of_week
    x, y = r * math.cos(u), r * math.sin(u)
    return np.array(
        [
            x * math.cos(node) - y * math.cos(i) * math.sin(node),
            x * math.sin(node) + y * math.cos(i) * math.cos(node),
            y * math.sin(i),
        ]
    )


@pytest.mark.parametrize(
    ("name", "gm", "rate", "shift"),
    [("G05", 3.986005e14, 7.2921151467e-5, 0), ("E11", 3.986004418e14, 7.2921151467e-5, 0),
     ("J02", 3.986005e14, 7.2921151467e-5, 0), ("C23", 3.986004418e14, 7.292115e-5, 14)],
)  # fmt: skip
def test_a_kepler_orbit_is_the_interface_documents(name: str, gm: float, rate: float, shift: int) -> None:
    e = kepler(name)
    for dt in (-7200, 0, 3599):
        got = broadcast_states(pack(e)[None], np.array([T_NS + dt * NS])).position_ecef_m[0]
        wanted = numpy_position(e, dt, gm, rate, (T_NS // NS - shift) % 604_800)
        assert got == pytest.approx(wanted, abs=1e-6)


@pytest.mark.parametrize(
    "ephemeris", [kepler("G05"), kepler("C03"), kepler("C20"), glonass()], ids=lambda e: str(e.satellite)
)
def test_velocity_and_clock_rate_are_derivatives(ephemeris: Ephemeris) -> None:
    row, t_ns, step = pack(ephemeris)[None], T_NS + 570 * NS, NS // 4
    before, at, after = (broadcast_states(row, np.array([t_ns + k * step])) for k in (-1, 0, 1))
    difference = (after.position_ecef_m[0] - before.position_ecef_m[0]) / 0.5
    assert at.velocity_ecef_m_s[0] == pytest.approx(difference, abs=2e-5)
    assert at.clock_rate_s_s[0] == pytest.approx((after.clock_s[0] - before.clock_s[0]) / 0.5, abs=1e-13)


def test_the_clock_holds_the_relativistic_term_once() -> None:
    e = kepler("G05")
    state = broadcast_states(pack(e)[None], np.array([T_NS + 100 * NS]))
    polynomial = e.clock_bias_s + e.clock_drift_s_s * 100.0 + e.clock_drift_rate_s_s2 * 1e4
    r_dot_v = float(state.position_ecef_m[0] @ state.velocity_ecef_m_s[0])
    assert state.relativity_s[0] == pytest.approx(-2.0 * r_dot_v / C**2, rel=1e-12)
    assert state.clock_s[0] - state.relativity_s[0] == pytest.approx(polynomial, abs=1e-17)
    assert abs(state.relativity_s[0]) > 1e-9


def test_geostationary_beidou_stays_over_its_place() -> None:
    assert [is_beidou_geo(satellite_of_name(n)) for n in ("C01", "C05", "C06", "C58", "C59", "C63", "G01")] == [
        True, True, False, False, True, True, False,
    ]  # fmt: skip
    radius = 42_164_170.0
    quiet = dict.fromkeys(
        ["eccentricity", "mean_motion_difference_rad_s", "inclination_rate_rad_s", "cuc_rad", "cus_rad", "crc_m",
         "crs_m", "cic_rad", "cis_rad", "ascending_node_rate_rad_s"], 0.0,
    )  # fmt: skip
    node_rad = 7.292115e-5 * ((T_NS // NS - 14) % 604_800) + math.pi  # undoes the frame's tilt: truly equatorial
    e = kepler(
        "C03",
        **quiet,
        sqrt_semi_major_axis_sqrt_m=math.sqrt(radius),
        inclination_rad=math.radians(5.0),
        ascending_node_rad=node_rad,
    )
    row = pack(e)
    assert row[KIND] == KEPLER_GEO
    at = [broadcast_states(row[None], np.array([T_NS + h * 3600 * NS])).position_ecef_m[0] for h in range(-1, 2)]
    for position in at:
        assert np.linalg.norm(position) == pytest.approx(radius, abs=1e-3)
        assert position[2] == pytest.approx(0.0, abs=1e-3)
    assert np.linalg.norm(at[2] - at[0]) < 100.0


def test_glonass_goes_there_and_back_again() -> None:
    state = np.array([1.9e7, 1.2e7, 1.2e7, -1300.0, 300.0, 1750.0])
    pull = np.array([9e-7, -2.8e-6, 1.9e-6])
    there = integrate(state, pull, 900.0)
    assert np.linalg.norm(there[:3] - state[:3]) > 1e6
    assert integrate(there, pull, -900.0) == pytest.approx(state, abs=1e-3)


def test_glonass_keeps_jacobis_integral_and_needs_no_smaller_steps() -> None:
    state = np.array([1.9e7, 1.2e7, 1.2e7, -1300.0, 300.0, 1750.0])
    pieces = state
    for _ in range(90):
        pieces = integrate(pieces, np.zeros(3), 10.0)
    whole = integrate(state, np.zeros(3), 900.0)
    assert whole[:3] == pytest.approx(pieces[:3], abs=1e-3)

    def jacobi(s: np.ndarray) -> float:
        r, omega = float(np.linalg.norm(s[:3])), EARTH_ROTATION_RATE_GLONASS_RAD_S
        oblate = 1.0826257e-3 * (6_378_136.0 / r) ** 2 * (1.5 * (s[2] / r) ** 2 - 0.5)
        turning = 0.5 * omega**2 * float(s[0] ** 2 + s[1] ** 2)
        return float(0.5 * s[3:] @ s[3:] - EARTH_GM_GLONASS_M3_S2 / r * (1.0 - oblate) - turning)

    assert jacobi(whole) == pytest.approx(jacobi(state), rel=1e-11)


def test_glonass_clock_has_the_messages_sign() -> None:
    e = glonass(clock_bias_s=-3e-5, frequency_bias=1e-12)
    state = broadcast_states(pack(e)[None], np.array([T_NS + 300 * NS]))
    assert state.clock_s[0] == pytest.approx(-3e-5 + 1e-12 * 300.0, abs=1e-18)


def test_missing_and_hopeless_rows_have_a_status_and_no_numbers() -> None:
    rows = np.array([empty_row(), pack(glonass()), pack(kepler())])
    states = broadcast_states(rows, np.array([T_NS, T_NS + 7 * 3600 * NS, T_NS]))
    assert list(states.status) == [1, 11, 0]
    assert np.all(np.isnan(states.position_ecef_m[:2]))
    assert np.all(np.isfinite(states.position_ecef_m[2]))


def test_times_are_exact_to_the_nanosecond() -> None:
    row = pack(kepler(toe_gps_ns=T_NS + 7))
    assert seconds_since(T_NS + 10, row[2], row[3]) == pytest.approx(3e-9, abs=1e-18)
