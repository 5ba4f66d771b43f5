"""Detection, identification, adaptation. Oracles: dense algebra, SciPy, least squares by elimination."""

from itertools import combinations

import numpy as np
import pytest
from scipy import linalg, stats

from plumbline.errors import ConfigurationError
from plumbline.estimation import dia
from plumbline.estimation.dia_tables import (
    Levels,
    alternative_critical,
    global_critical,
    global_critical_of_ratio,
    missed_detection_factor,
    noncentrality,
    w_critical,
)
from plumbline.records import Floats

LEVELS = Levels()
CRITICAL = alternative_critical(LEVELS)


def problem(seed: int, m: int = 24, n: int = 10) -> tuple[Floats, Floats, Floats]:
    """Design, covariance of the innovations and clean innovations of a random filter epoch."""
    rng = np.random.default_rng(seed)
    h = rng.normal(size=(m, n))
    s = h @ np.diag(rng.uniform(0.01, 4.0, n)) @ h.T + np.diag(rng.uniform(0.5, 2.0, m))
    return h, s, np.linalg.cholesky(s) @ rng.normal(size=m)


def dense(s: Floats, v: Floats, c: Floats) -> tuple[Floats, Floats, float]:
    """Estimate, covariance and explained χ² of the alternative ``c b``, by generalised least squares."""
    inverse = np.linalg.inv(s)
    covariance = np.linalg.inv(c.T @ inverse @ c)
    b = covariance @ (c.T @ inverse @ v)
    return b, covariance, float(b @ np.linalg.solve(covariance, b))


def units(m: int) -> np.ndarray:
    return np.arange(m + 1)


def identify(table: Floats, starts: np.ndarray, most: int = 10) -> dia.Findings:
    return dia.identify(table, starts, np.ones(len(starts) - 1, bool), CRITICAL[np.diff(starts)], most)


def test_the_tables_are_those_of_the_distributions() -> None:
    assert noncentrality(LEVELS) == pytest.approx(17.075, abs=1e-3)  # Baarda's 4.13² for 0.1 % and 80 %
    assert stats.ncx2.sf(w_critical(LEVELS) ** 2, 1, noncentrality(LEVELS)) == pytest.approx(0.80, abs=1e-4)
    for q in (2, 3):
        assert stats.ncx2.sf(CRITICAL[q], q, noncentrality(LEVELS)) == pytest.approx(0.80, abs=1e-6)
    assert global_critical(LEVELS, 10) == pytest.approx(18.307, abs=1e-3)
    assert global_critical(LEVELS, 0) == np.inf
    missed = stats.norm.cdf(w_critical(LEVELS) - missed_detection_factor(LEVELS, 0.01))
    assert missed == pytest.approx(0.01, rel=1e-6)
    with pytest.raises(ConfigurationError):
        Levels(power=1.0)


def test_a_ratio_that_varies_more_than_chi_square_has_the_critical_value_of_its_f_distribution() -> None:
    """Oracle: draws of χ²(r)/r over a variance factor that is itself χ²(ν)/ν, of which only the spread is told."""
    rng, r, spread, n = np.random.default_rng(31), 40, 30.0, 200_000
    share = rng.chisquare(r, n) / r / (rng.chisquare(spread, n) / spread)
    excess = share.var() / share.mean() ** 2 - 2.0 / r
    alarms = share / share.mean() * r > global_critical_of_ratio(LEVELS, r, excess)
    assert alarms.mean() == pytest.approx(LEVELS.significance, rel=0.05)
    assert global_critical_of_ratio(LEVELS, r, 0.0) == global_critical(LEVELS, r)
    assert global_critical_of_ratio(LEVELS, 0, 1.0) == np.inf


def test_the_tableau_is_the_information_of_the_catalogue() -> None:
    h, s, v = problem(1)
    table, positive = dia.information(s, v, h[:, :3].copy())
    c = np.hstack([np.eye(len(v)), h[:, :3], v[:, None]])
    assert positive
    np.testing.assert_allclose(table, c.T @ np.linalg.solve(s, c), atol=1e-11)
    assert not dia.information(s - 10.0 * np.eye(len(v)), v, np.zeros((len(v), 0)))[1]


def test_residuals_of_least_squares_make_the_same_tableau_as_a_filter_that_knows_nothing() -> None:
    h, _, v = problem(2)
    sigma = np.random.default_rng(2).uniform(0.5, 2.0, len(v))
    table, solvable = dia.residual_information(h, v, sigma)
    basis = linalg.null_space((h / sigma[:, None]).T)  # orthonormal: white redundancy space
    c = np.hstack([np.eye(len(v)), v[:, None]]) / sigma[:, None]
    assert solvable
    np.testing.assert_allclose(table, c.T @ basis @ basis.T @ c, atol=1e-11)
    assert table[-1, -1] == pytest.approx(np.linalg.lstsq(h / sigma[:, None], v / sigma, rcond=None)[1][0])


def test_adopting_an_alternative_is_leaving_its_observation_out() -> None:
    _, s, v = problem(3)
    v[5] += 40.0
    v[17] -= 25.0
    table, _ = dia.information(s, v, np.zeros((len(v), 0)))
    found = identify(table, units(len(v)))
    assert set(found.order.tolist()) == {5, 17}
    assert found.explained
    keep = ~found.adopted
    without = v[keep] @ np.linalg.solve(s[np.ix_(keep, keep)], v[keep])
    assert found.statistic_after == pytest.approx(without, rel=1e-9)
    c = np.eye(len(v))[:, [5, 17]]
    b, covariance, _ = dense(s, v, c)
    w, sigma = dia.w_values(found.swept, found.adopted)
    np.testing.assert_allclose(found.swept[[5, 17], -1], b, rtol=1e-9)
    np.testing.assert_allclose(sigma[[5, 17]], np.sqrt(np.diag(covariance)), rtol=1e-9)
    np.testing.assert_allclose(w[[5, 17]], b / np.sqrt(np.diag(covariance)), rtol=1e-9)
    inverse = np.linalg.inv(s[np.ix_(keep, keep)])
    expected = (inverse @ v[keep]) / np.sqrt(np.diag(inverse))
    np.testing.assert_allclose(w[keep], expected, atol=1e-9)
    np.testing.assert_allclose(sigma[keep], 1.0 / np.sqrt(np.diag(inverse)), rtol=1e-9)


def test_sweeping_back_restores_the_tableau() -> None:
    _, s, v = problem(4)
    table, _ = dia.information(s, v, np.zeros((len(v), 0)))
    swept = table.copy()
    for k in (3, 8, 11):
        dia.sweep(swept, k, False)
    for k in (8, 3, 11):
        dia.sweep(swept, k, True)
    np.testing.assert_allclose(swept, table, atol=1e-10)


def test_an_observation_that_was_wrongly_left_out_comes_back() -> None:
    """Two errors that together look like a third observation's: greedy selection falls for it and recovers."""
    h = np.array([[1.0], [1.0], [1.0], [1.0], [1.0], [1.0]])
    sigma = np.array([0.3, 1.0, 1.0, 1.0, 1.0, 1.0])
    v = np.array([0.0, 12.0, 12.5, 0.3, -0.4, 0.1])
    table, _ = dia.residual_information(h, v, sigma)
    taken_back = 0
    found = identify(table, units(6), 4)
    assert set(found.order.tolist()) == {1, 2}
    for seed in range(300):  # correlated problems in which the first choice is wrong now and then
        rng = np.random.default_rng(seed)
        h = np.hstack([np.ones((9, 1)), rng.normal(size=(9, 2)) * [1.0, 3.0]])
        v = rng.normal(size=9)
        v[:3] += rng.uniform(8.0, 15.0, 3)
        table, _ = dia.residual_information(h, v, np.ones(9))
        found = identify(table, units(9), 6)
        taken_back += found.taken_back
        w, _ = dia.w_values(found.swept, found.adopted)
        assert (np.abs(w[found.adopted]) > w_critical(LEVELS)).all()  # nothing stays out without reason
    assert taken_back > 0


def test_greedy_selection_finds_the_best_subset_nearly_always() -> None:
    """Oracle: all pairs, by brute force."""
    agree = 0
    for seed in range(60):
        _, s, v = problem(100 + seed, 14, 6)
        rng = np.random.default_rng(seed)
        v[rng.choice(14, 2, replace=False)] += rng.choice([-1, 1], 2) * rng.uniform(12.0, 30.0, 2)
        table, _ = dia.information(s, v, np.zeros((14, 0)))
        found = identify(table, units(14), 2)
        best = max(combinations(range(14), 2), key=lambda pair: dense(s, v, np.eye(14)[:, list(pair)])[2])
        agree += set(found.order.tolist()) == set(best)
    assert agree >= 57


def test_a_motion_is_told_from_outliers_and_outliers_from_a_motion() -> None:
    h, s, v = problem(5)
    m = len(v)
    starts = np.append(units(m), m + 3)
    motion = h[:, :3].copy()
    table, _ = dia.information(s, v + motion @ np.array([9.0, -7.0, 8.0]), motion)
    found = identify(table, starts)
    assert found.order.tolist() == [m]
    b, _, chi2 = dense(s, v + motion @ np.array([9.0, -7.0, 8.0]), motion)
    np.testing.assert_allclose(found.swept[m : m + 3, -1], b, rtol=1e-9)
    assert found.statistic - found.statistic_after == pytest.approx(chi2, rel=1e-9)
    moved = v.copy()
    moved[[2, 9]] += 30.0
    table, _ = dia.information(s, moved, motion)
    assert set(identify(table, starts).order.tolist()) == {2, 9}


def test_alternatives_that_cannot_be_told_apart_are_named_and_never_adopted_twice() -> None:
    h = np.ones((2, 1))  # two observations of one unknown: either may be wrong
    table, _ = dia.residual_information(h, np.array([0.0, 10.0]), np.ones(2))
    assert dia.correlation(table, 0, 1) == pytest.approx(-1.0)
    assert dia.inseparable(table, 0, np.arange(2), 0.99).tolist() == [1]
    found = identify(table, units(2), 2)
    assert len(found.order) == 1
    assert found.explained
    _, s, v = problem(6)
    full, _ = dia.information(s, v, np.zeros((len(v), 0)))
    inverse = np.linalg.inv(s)
    expected = inverse[3, 7] / np.sqrt(inverse[3, 3] * inverse[7, 7])
    assert dia.correlation(full, 3, 7) == pytest.approx(expected)


def test_no_more_is_left_out_than_allowed_and_the_rest_is_said_not_to_agree() -> None:
    _, s, v = problem(7)
    v[[1, 4, 8]] += 60.0
    table, _ = dia.information(s, v, np.zeros((len(v), 0)))
    found = identify(table, units(len(v)), 2)
    assert len(found.order) == 2
    assert not found.explained
    allowed = np.ones(len(v), bool)
    allowed[4] = False
    found = dia.identify(table, units(len(v)), allowed, CRITICAL[np.diff(units(len(v)))], 2)
    assert 4 not in found.order
