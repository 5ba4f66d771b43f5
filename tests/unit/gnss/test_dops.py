"""Oracle: a geometry whose normal matrix is inverted by hand."""

import math

import numpy as np
import pytest

from plumbline.gnss.dops import dilution_of_precision


def test_a_pyramid_has_closed_form_dilutions() -> None:
    """Zenith and four at elevation e: Q_ee = Q_nn = 1/(2 cos² e); up and clock from a 2 × 2 system."""
    e = math.radians(20.0)
    c, s = math.cos(e), math.sin(e)
    unit = np.array([[0, 0, 1], [c, 0, s], [-c, 0, s], [0, c, s], [0, -c, s]])
    got = dilution_of_precision(unit, np.zeros(5, np.int64))
    uu, ut, tt = 1.0 + 4.0 * s * s, -(1.0 + 4.0 * s), 5.0
    determinant = uu * tt - ut * ut
    assert got.hdop == pytest.approx(1.0 / c)
    assert got.vdop == pytest.approx(math.sqrt(tt / determinant))
    assert got.tdop == pytest.approx(math.sqrt(uu / determinant))
    assert got.pdop == pytest.approx(math.hypot(got.hdop, got.vdop))


def test_another_clock_costs_a_satellite() -> None:
    rng = np.random.default_rng(3)
    unit = rng.normal(size=(5, 3))
    unit[:, 2] = np.abs(unit[:, 2])
    unit /= np.linalg.norm(unit, axis=1)[:, None]
    one = dilution_of_precision(unit, np.zeros(5, np.int64))
    two = dilution_of_precision(unit, np.array([0, 0, 0, 0, 1]))
    four = dilution_of_precision(unit[:4], np.zeros(4, np.int64))
    assert two.pdop == pytest.approx(four.pdop, rel=1e-6)
    assert one.pdop < two.pdop


def test_too_few_or_flat_is_not_a_number() -> None:
    assert math.isnan(dilution_of_precision(np.eye(3), np.zeros(3, np.int64)).pdop)
    flat = np.array([[1, 0, 0], [0, 1, 0], [-1, 0, 0], [0, -1, 0], [0.6, 0.8, 0]])
    assert math.isnan(dilution_of_precision(flat, np.zeros(5, np.int64)).vdop)
