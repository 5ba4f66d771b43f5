"""Screening of innovations. Oracles: the errors drawn, χ², and weighted least squares in plain NumPy."""

import numpy as np
import pytest
from scipy.stats import chi2

from plumbline.estimation.dia_innovations import screen
from plumbline.estimation.dia_tables import Levels, noncentrality, w_critical

LEVELS = Levels()
CRITICAL = w_critical(LEVELS) ** 2


def _covariance(rng: np.random.Generator, m: int) -> np.ndarray:
    root = rng.normal(size=(m, m))
    return root @ root.T / m + np.diag(rng.uniform(0.5, 2.0, m))


def test_an_error_is_left_out_and_estimated() -> None:
    rng, m = np.random.default_rng(1), 8
    s = _covariance(rng, m)
    for i in range(m):
        v = 0.3 * np.linalg.cholesky(s) @ rng.normal(size=m)
        v[i] += 20.0
        found = screen(s, v, np.zeros((m, 0)), CRITICAL, 3)
        assert np.flatnonzero(~found.use).tolist() == [i]
        assert abs(found.error[i] - 20.0) < 4.0 * found.sigma_error[i]
        assert found.statistic_after < chi2.ppf(0.999, m - 1) < found.statistic


def test_clocks_are_nuisance() -> None:
    """Whatever two clocks do, the statistic is that of the residuals about the weighted means."""
    rng, m = np.random.default_rng(2), 10
    s, clocks = _covariance(rng, m), np.kron(np.eye(2), np.ones((5, 1)))
    v = np.linalg.cholesky(s) @ rng.normal(size=m)
    weight = np.linalg.inv(s)
    left = v - clocks @ np.linalg.solve(clocks.T @ weight @ clocks, clocks.T @ weight @ v)
    for shift in (0.0, 1e3):
        found = screen(s, v + clocks @ [shift, -2.0 * shift], clocks, np.inf, 3)
        assert found.statistic == pytest.approx(left @ weight @ left, rel=1e-6)
        assert found.degrees_of_freedom == 8
        assert found.use.all()


def test_false_alarms_and_power_are_those_stated() -> None:
    """10,000 draws: the w-test's significance, and the power at the minimal detectable bias."""
    rng, m, n = np.random.default_rng(3), 6, 10_000
    s = _covariance(rng, m)
    root, none = np.linalg.cholesky(s), np.zeros((m, 0))
    sigma = screen(s, np.zeros(m), none, np.inf, 0).sigma_error
    size = np.sqrt(noncentrality(LEVELS)) * sigma
    false = found = 0
    for trial in range(n):
        v = root @ rng.normal(size=m)
        false += abs(screen(s, v, none, np.inf, 0).w[trial % m]) > w_critical(LEVELS)
        v[trial % m] += size[trial % m]
        found += abs(screen(s, v, none, np.inf, 0).w[trial % m]) > w_critical(LEVELS)
    assert found / n == pytest.approx(LEVELS.power, abs=0.03)
    assert false / n < 2.0 * LEVELS.w_significance
