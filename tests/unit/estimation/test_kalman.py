"""Kalman kernels against dense NumPy algebra and the statistics that they claim."""

import numpy as np
import pytest

from plumbline.estimation.kalman import (
    cholesky_lower,
    innovation_covariance,
    lower_inverse,
    update_sequential,
    update_with_errors,
    w_statistics,
    whiten,
)
from plumbline.estimation.least_squares import residuals, solve


def _problem(seed, n=9, m=14):
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(n, n))
    p = root @ root.T + 0.1 * np.eye(n)
    h = rng.normal(size=(m, n)) * (rng.random((m, n)) < 0.4)
    return rng.normal(size=n), p, h, rng.uniform(0.5, 2.0, m), rng.normal(size=m)


@pytest.mark.parametrize("seed", range(5))
def test_sequential_update_is_the_batch_update(seed):
    """Oracle: the textbook batch update with a dense gain, for the observations marked."""
    x, p, h, r, v = _problem(seed)
    use = np.arange(v.size) % 4 != 1
    hu, ru, vu = h[use], np.diag(r[use]), v[use]
    gain = p @ hu.T @ np.linalg.inv(hu @ p @ hu.T + ru)
    expected_x, expected_p = x + gain @ vu, (np.eye(x.size) - gain @ hu) @ p
    update_sequential(x, p, h, r, v, use)
    np.testing.assert_allclose(x, expected_x, rtol=1e-10, atol=1e-12)
    np.testing.assert_allclose(p, expected_p, rtol=1e-9, atol=1e-11)
    assert np.array_equal(p, p.T)


@pytest.mark.parametrize("seed", range(5))
def test_errors_of_an_update_with_gains_of_another_covariance(seed):
    """Oracle: (1 − K H) Q (1 − K H)ᵀ + K R Kᵀ of the batch, with the dense gain of P; Q = P gives P itself."""
    x, p, h, r, v = _problem(seed)
    q = _problem(seed + 10)[1]
    use = np.arange(v.size) % 4 != 1
    hu, ru = h[use], np.diag(r[use])
    gain = p @ hu.T @ np.linalg.inv(hu @ p @ hu.T + ru)
    left = np.eye(x.size) - gain @ hu
    expected_q = left @ q @ left.T + gain @ ru @ gain.T
    plain_x, plain_p, same = x.copy(), p.copy(), p.copy()
    nis = update_sequential(plain_x, plain_p, h, r, v, use)
    update_with_errors(x.copy(), p.copy(), same, h, r, v, use)
    assert update_with_errors(x, p, q, h, r, v, use) == pytest.approx(nis)
    np.testing.assert_array_equal(x, plain_x)
    np.testing.assert_array_equal(p, plain_p)
    np.testing.assert_allclose(q, expected_q, rtol=1e-9, atol=1e-11)
    np.testing.assert_allclose(same, p, rtol=1e-9, atol=1e-11)


def test_covariance_stays_positive_where_the_short_form_fails():
    """Oracle: positive definiteness. Prior and observation differ by 1e14 in variance, over and over."""
    n = 4
    p = np.eye(n) * 1e6
    x = np.zeros(n)
    rng = np.random.default_rng(1)
    for _ in range(200):
        h = rng.normal(size=(6, n))
        update_sequential(x, p, h, np.full(6, 1e-8), np.zeros(6), np.ones(6, np.bool_))
    assert np.linalg.eigvalsh(p).min() > 0.0


@pytest.mark.parametrize("seed", range(5))
def test_innovation_covariance_and_its_factor(seed):
    """Oracle: h p hᵀ + r in NumPy, and LLᵀ."""
    _, p, h, r, v = _problem(seed)
    s = innovation_covariance(p, h, r)
    np.testing.assert_allclose(s, h @ p @ h.T + np.diag(r), rtol=1e-12, atol=1e-12)
    factor, positive = cholesky_lower(s)
    assert positive
    np.testing.assert_allclose(factor @ factor.T, s, rtol=1e-12, atol=1e-12)
    white = whiten(lower_inverse(factor), v)
    assert white @ white == pytest.approx(v @ np.linalg.solve(s, v), rel=1e-9)


def test_cholesky_refuses_what_is_not_positive():
    """Oracle: an indefinite matrix, and one with NaN."""
    assert not cholesky_lower(np.array([[1.0, 2.0], [2.0, 1.0]]))[1]
    assert not cholesky_lower(np.array([[np.nan]]))[1]


def test_w_statistics_are_standard_normal_and_name_the_outlier():
    """Oracle: unit variance over many draws of the modelled noise; a large error is the largest statistic."""
    _, p, h, r, _ = _problem(3)
    s = innovation_covariance(p, h, r)
    inverse = lower_inverse(cholesky_lower(s)[0])
    draws = np.linalg.cholesky(s) @ np.random.default_rng(2).normal(size=(s.shape[0], 4000))
    statistics = np.array([w_statistics(inverse, whiten(inverse, draws[:, k])) for k in range(draws.shape[1])])
    np.testing.assert_allclose(statistics.std(axis=0), 1.0, atol=0.05)
    for i in range(s.shape[0]):
        spoiled = draws[:, i].copy()
        spoiled[i] += 60.0
        assert np.argmax(np.abs(w_statistics(inverse, whiten(inverse, spoiled)))) == i


def test_least_squares_is_numpys():
    """Oracle: numpy.linalg.lstsq on whitened rows, and (HᵀWH)⁻¹."""
    rng = np.random.default_rng(5)
    h, v, sigma = rng.normal(size=(12, 4)), rng.normal(size=12), rng.uniform(0.5, 3.0, 12)
    x, covariance, solvable = solve(h, v, sigma)
    assert solvable
    np.testing.assert_allclose(x, np.linalg.lstsq(h / sigma[:, None], v / sigma, rcond=None)[0], rtol=1e-10)
    np.testing.assert_allclose(covariance, np.linalg.inv(h.T @ np.diag(sigma**-2) @ h), rtol=1e-9)
    np.testing.assert_allclose(residuals(h, v, x), v - h @ x)


def test_least_squares_says_when_it_is_singular():
    """Oracle: two equal columns."""
    h = np.ones((5, 2))
    assert not solve(h, np.ones(5), np.ones(5))[2]
