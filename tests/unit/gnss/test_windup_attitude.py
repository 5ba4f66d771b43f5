"""Oracles: one turn of an antenna is one cycle (J. T. Wu 1993), body axes' definition, the shadow's geometry."""

import math

import numpy as np
import pytest

from plumbline.gnss.attitude import ORBIT_NORMAL, body_axes, in_shadow
from plumbline.gnss.windup import windup_cycles
from plumbline.signals import satellite_of_name

SUN = np.array([1.5e11, 0.0, 0.0])


def _turned(angle: float) -> tuple[np.ndarray, np.ndarray]:
    """North and west of a receiver at the pole turned by an angle against the clock, seen from above."""
    north = np.array([math.cos(angle), math.sin(angle), 0.0])
    return north, np.array([-math.sin(angle), math.cos(angle), 0.0])


@pytest.mark.parametrize("sign", [1.0, -1.0])
def test_a_turn_of_the_receiver_is_a_cycle_and_stays_continuous(sign: float) -> None:
    """Overhead satellite: right-handed waves; three turns give three cycles, without a jump on the way."""
    down = np.array([0.0, 0.0, -1.0])
    body = np.array([[1.0, 0.0, 0.0], [0.0, -1.0, 0.0], [0.0, 0.0, -1.0]])
    value = math.nan
    values = []
    for k in range(3 * 36 + 1):
        value = windup_cycles(down, body, *_turned(sign * k * math.pi / 18.0), value)
        values.append(value)
    steps = np.diff(values)
    assert np.abs(steps).max() < 0.03
    assert abs(values[-1] - values[0]) == pytest.approx(3.0, abs=1e-9)
    assert np.all(steps * sign < 0.0)


def test_turning_both_antennas_together_changes_nothing() -> None:
    down = np.array([0.0, 0.0, -1.0])
    for angle in (0.0, 0.7, 2.0):
        x, y = _turned(angle)
        body = np.array([x, -y, down])
        north, west = _turned(angle)
        assert windup_cycles(down, body, north, west, math.nan) == pytest.approx(0.0, abs=1e-7)


def test_body_axes_look_at_the_earth_and_the_sun() -> None:
    position, velocity = np.array([1.6e7, 1.0e7, 1.8e7]), np.array([-2000.0, 2500.0, 500.0])
    axes = body_axes(position, velocity, SUN, False)
    assert axes @ axes.T == pytest.approx(np.eye(3), abs=1e-14)
    assert np.linalg.det(axes) == pytest.approx(1.0)
    assert axes[2] @ position == pytest.approx(-np.linalg.norm(position))
    to_sun = (SUN - position) / np.linalg.norm(SUN - position)
    assert axes[1] @ to_sun == pytest.approx(0.0, abs=1e-12)
    assert axes[0] @ to_sun > 0.0


def test_geostationary_beidou_keeps_to_its_orbit() -> None:
    position, velocity = np.array([4.2e7, 0.0, 0.0]), np.array([0.0, 10.0, 0.0])
    axes = body_axes(position, velocity, SUN + 1e10, True)
    assert axes[1] == pytest.approx([0.0, 0.0, -1.0])
    assert axes[0] == pytest.approx([0.0, 1.0, 0.0])
    assert [bool(ORBIT_NORMAL[satellite_of_name(n)]) for n in ("C01", "C60", "C20", "G01")] == [
        True,
        True,
        False,
        False,
    ]


def test_the_shadow_is_behind_the_earth() -> None:
    assert in_shadow(np.array([-2.6e7, 6.0e6, 0.0]), SUN)
    assert not in_shadow(np.array([-2.6e7, 6.5e6, 0.0]), SUN)
    assert not in_shadow(np.array([2.6e7, 0.0, 0.0]), SUN)
