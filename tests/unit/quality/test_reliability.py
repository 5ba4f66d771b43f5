"""Quality measures. Oracles: dense algebra of Lee 2016's equations, re-estimation with an error added, closed forms."""

import numpy as np
import pytest
from scipy import stats

from plumbline.estimation import dia
from plumbline.estimation.dia_tables import Levels, noncentrality
from plumbline.estimation.kalman import update_sequential
from plumbline.gnss.dops import dilution_of_precision
from plumbline.quality.reliability import Integrity, factors, geometry, measures
from plumbline.records import Floats

LEVELS = Levels()


def sky(n: int, seed: int = 1) -> Floats:
    """Unit vectors to n satellites, (n, 3), east, north, up."""
    rng = np.random.default_rng(seed)
    azimuth, elevation = rng.uniform(0, 2 * np.pi, n), np.arcsin(rng.uniform(0.15, 1.0, n))
    horizontal = np.cos(elevation)
    return np.column_stack([horizontal * np.sin(azimuth), horizontal * np.cos(azimuth), np.sin(elevation)])


def epoch(seed: int = 2) -> tuple[Floats, Floats, Floats, Floats]:
    """Design of 12 codes of position and clock, variances, prior covariance, rotation to ENU."""
    rng = np.random.default_rng(seed)
    rotation = np.linalg.qr(rng.normal(size=(3, 3)))[0]
    h = np.hstack([-sky(12) @ rotation, np.ones((12, 1))])
    return h, rng.uniform(0.5, 2.0, 12), np.diag([9.0, 4.0, 16.0, 1e4]), rotation


def test_measures_are_lees_equations() -> None:
    h, r, p, rotation = epoch()
    s = h @ p @ h.T + np.diag(r)
    v = np.linalg.cholesky(s) @ np.random.default_rng(3).normal(size=12)
    table, _ = dia.information(s, v, np.zeros((12, 0)))
    w, sigma_b = dia.w_values(table, np.zeros(12, bool))
    after = np.linalg.inv(np.linalg.inv(p) + h.T @ np.diag(1 / r) @ h)
    made = measures(sigma_b, r, np.ones(12, bool), h, r, after[:3], rotation, factors(LEVELS, Integrity()))
    residual_cofactor = np.diag(r) - h @ after @ h.T  # eq. 9
    np.testing.assert_allclose(made.redundancy, np.diag(residual_cofactor) / r, rtol=1e-9)  # eqs 10, 43
    assert made.redundancy.sum() == pytest.approx(12 - np.trace(after @ h.T @ np.diag(1 / r) @ h))
    expected = np.sqrt(noncentrality(LEVELS) * r / made.redundancy)  # eq. 55
    np.testing.assert_allclose(made.mdb, expected, rtol=1e-9)
    residual = residual_cofactor @ (v / r)
    np.testing.assert_allclose(w, residual / np.sqrt(np.diag(residual_cofactor)), atol=1e-9)  # eq. 37


def test_external_reliability_is_what_an_error_does_to_the_position() -> None:
    h, r, p, rotation = epoch()
    s = h @ p @ h.T + np.diag(r)
    table, _ = dia.information(s, np.zeros(12), np.zeros((12, 0)))
    _, sigma_b = dia.w_values(table, np.zeros(12, bool))
    for i in range(12):
        x, q, v = np.zeros(4), p.copy(), np.zeros(12)
        v[i] = np.sqrt(noncentrality(LEVELS)) * sigma_b[i]
        update_sequential(x, q, h, r, v, np.ones(12, bool))
        made = measures(sigma_b, r, np.ones(12, bool), h, r, q[:3].copy(), rotation, factors(LEVELS, Integrity()))
        np.testing.assert_allclose(made.external[i], rotation @ x[:3], atol=1e-9)
    assert np.isnan(
        measures(sigma_b, r, np.arange(12) != 4, h, r, q[:3].copy(), rotation, factors(LEVELS, Integrity())).external[4]
    ).all()


def test_geometry_agrees_with_the_dilutions_and_with_lees_projector() -> None:
    line, clock = sky(9), np.array([0, 0, 0, 2, 2, 2, 0, 2, 0])
    made = geometry(line, clock, np.ones(9, bool), np.eye(3))
    expected = dilution_of_precision(line, clock)
    assert (made.hdop, made.vdop, made.pdop) == pytest.approx((expected.hdop, expected.vdop, expected.pdop))
    a = np.hstack([-line, (clock[:, None] == [0, 2]).astype(float)])
    np.testing.assert_allclose(made.qdop, np.diag(a @ np.linalg.inv(a.T @ a) @ a.T), rtol=1e-9)
    assert made.qdop.sum() == pytest.approx(5.0)  # eq. 51: the unknowns
    used = np.ones(9, bool)
    used[2] = False
    without = geometry(line, clock, used, np.eye(3))
    assert without.qdop[2] == pytest.approx(made.qdop[2])  # what it would have if it were used
    assert without.hdop > made.hdop


def test_too_few_satellites_have_no_dilution() -> None:
    used = np.array([True, True, True, False, False, False])
    assert np.isnan(geometry(sky(6), np.zeros(6, np.int64), used, np.eye(3)).pdop)


def test_factors_are_the_distributions() -> None:
    made = factors(LEVELS, Integrity(risk=1e-6, prior=1e-4))
    assert 2 * stats.norm.sf(made.vertical) == pytest.approx(1e-6)
    assert stats.rayleigh.sf(made.horizontal) == pytest.approx(1e-6)
    assert 2 * stats.norm.sf(made.vertical_fault) == pytest.approx(1e-2)
