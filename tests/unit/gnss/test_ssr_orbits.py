"""Oracle: the definitions of RTCM 10403.3 by hand: axes, subtraction, sign of the clock, reference times."""

import numpy as np
import pytest

from plumbline.gnss.orbits_broadcast import pack
from plumbline.gnss.satellite_states import StateStatus, broadcast_at_transmission, corrected_at_transmission
from plumbline.gnss.ssr_orbits import (
    clock_correction_s,
    correct_orbit,
    no_correction,
    pack_correction,
    reference_time_ns,
    rotation_ecef_from_rac,
)
from plumbline.records import SsrClock, SsrHeader, SsrOrbit

from .make_ephemeris import T_NS, kepler

NS = 1_000_000_000
C = 299_792_458.0
POSITION, VELOCITY = np.array([2.6e7, 0.0, 0.0]), np.array([0.0, 3000.0, 0.0])


def _header(interval_s: float = 0.0) -> SsrHeader:
    return SsrHeader(T_NS, T_NS, interval_s, 3, 1, 1)


def _orbit(rac: tuple[float, ...], rates: tuple[float, ...] = (0.0, 0.0, 0.0), interval_s: float = 0.0) -> SsrOrbit:
    satellite = np.array([4], np.int16)
    return SsrOrbit(_header(interval_s), satellite, np.array([1]), np.array([rac]), np.array([rates]))


def _clock(polynomial: tuple[float, ...], interval_s: float = 0.0) -> SsrClock:
    return SsrClock(_header(interval_s), np.array([4], np.int16), np.array([polynomial]))


def test_the_axes_of_a_circular_orbit() -> None:
    assert rotation_ecef_from_rac(POSITION, VELOCITY) == pytest.approx(np.eye(3), abs=1e-15)


def test_the_axes_are_right_handed_and_along_is_the_velocity() -> None:
    velocity = np.array([500.0, 2900.0, -700.0])
    axes = rotation_ecef_from_rac(POSITION, velocity)
    assert axes.T @ axes == pytest.approx(np.eye(3), abs=1e-15)
    assert np.linalg.det(axes) == pytest.approx(1.0)
    assert axes[:, 1] == pytest.approx(velocity / np.linalg.norm(velocity))
    assert axes[:, 2] @ POSITION == pytest.approx(0.0, abs=1e-8)


def test_the_correction_is_subtracted() -> None:
    row = pack_correction(_orbit((1.0, 2.0, 3.0)), 0, None, 0)
    position, velocity = POSITION.copy(), VELOCITY.copy()
    correct_orbit(row, T_NS, position, velocity)
    assert position - POSITION == pytest.approx([-1.0, -2.0, -3.0], abs=1e-8)


@pytest.mark.parametrize(("interval_s", "elapsed"), [(0.0, 20.0), (10.0, 15.0), (5.0, 17.5)])
def test_rates_count_from_the_middle_of_the_interval(interval_s: float, elapsed: float) -> None:
    assert reference_time_ns(_header(interval_s)) == T_NS + round((20.0 - elapsed) * NS)
    orbit = _orbit((0.0, 0.0, 0.0), (0.001, 0.002, -0.003), interval_s)
    row = pack_correction(orbit, 0, _clock((0.5, 0.01, 0.0001), interval_s), 0)
    position, velocity = POSITION.copy(), VELOCITY.copy()
    correct_orbit(row, T_NS + 20 * NS, position, velocity)
    assert position - POSITION == pytest.approx([-0.001 * elapsed, -0.002 * elapsed, 0.003 * elapsed], abs=1e-8)
    assert velocity - VELOCITY == pytest.approx([-0.001, -0.002, 0.003], abs=1e-12)
    wanted_m = 0.5 + 0.01 * elapsed + 0.0001 * elapsed**2
    assert clock_correction_s(row, T_NS + 20 * NS) * C == pytest.approx(wanted_m, abs=1e-12)


def test_a_high_rate_clock_is_added() -> None:
    row = pack_correction(None, 0, _clock((0.5, 0.0, 0.0)), 0, high_rate_clock_m=0.02)
    assert clock_correction_s(row, T_NS) * C == pytest.approx(0.52, abs=1e-12)


def test_a_positive_clock_correction_lengthens_the_satellites_offset() -> None:
    rows, ranges = np.array([pack(kepler())] * 2), np.full(2, 2.2e7)
    corrections = np.array([pack_correction(_orbit((0.0, 0.0, 0.0)), 0, _clock((1.5, 0.0, 0.0)), 0), no_correction()])
    plain = broadcast_at_transmission(rows, T_NS, ranges)
    corrected = corrected_at_transmission(rows, corrections, T_NS, ranges)
    assert (corrected.clock_s[0] - plain.clock_s[0]) * C == pytest.approx(1.5, abs=1e-6)
    assert corrected.position_ecef_m[0] == pytest.approx(plain.position_ecef_m[0], abs=1e-6)
    assert corrected.status[1] == StateStatus.NO_CORRECTION
    assert np.isnan(corrected.position_ecef_m[1]).all()


def test_half_a_correction_is_none() -> None:
    rows, ranges = np.array([pack(kepler())] * 2), np.full(2, 2.2e7)
    corrections = np.array(
        [pack_correction(_orbit((0.1, 0.0, 0.0)), 0, None, 0), pack_correction(None, 0, _clock((0.1, 0, 0)), 0)]
    )
    assert list(corrected_at_transmission(rows, corrections, T_NS, ranges).status) == [2, 2]
