"""Tests over a window. Oracle: the same filter run twice, once on data with the error; SciPy's χ²."""

import numpy as np
import pytest
from scipy import stats

from plumbline.estimation.dia_window import (
    Share,
    Window,
    accumulate,
    add_epoch,
    add_share,
    carry_response,
    equivalent,
    respond,
)
from plumbline.records import Floats

N_EPOCHS = 60


def run(observations: Floats, h: Floats, transition: Floats, q: Floats, r: Floats) -> tuple[Floats, Floats, Floats]:
    """A plain Kalman filter: innovations (k, m), their covariances (k, m, m) and gains (k, n, m)."""
    n, m = h.shape[1], h.shape[0]
    x, p = np.zeros(n), 4.0 * np.eye(n)
    v, s, k = np.zeros((N_EPOCHS, m)), np.zeros((N_EPOCHS, m, m)), np.zeros((N_EPOCHS, n, m))
    for i, y in enumerate(observations):
        v[i] = y - h @ x
        s[i] = h @ p @ h.T + r
        k[i] = p @ h.T @ np.linalg.inv(s[i])
        x, p = transition @ (x + k[i] @ v[i]), transition @ (p - k[i] @ h @ p) @ transition.T + q
    return v, s, k


@pytest.fixture(scope="module")
def model() -> tuple[Floats, Floats, Floats, Floats]:
    rng = np.random.default_rng(11)
    transition = np.array([[1.0, 1.0, 0.0], [0.0, 0.95, 0.0], [0.0, 0.0, 0.9]])
    return rng.normal(size=(5, 3)), transition, 0.02 * np.eye(3), np.diag([1.0, 0.5, 2.0, 1.0, 0.7])


def test_the_response_is_what_an_error_does_to_the_innovations(
    model: tuple[Floats, Floats, Floats, Floats],
) -> None:
    h, transition, q, r = model
    y = np.random.default_rng(12).normal(size=(N_EPOCHS, 5))
    wrong, start, c = y.copy(), 7, np.eye(5)[:, [3]]
    wrong[start:, 3] += 2.5
    clean, _, gains = run(y, h, transition, q, r)
    shifted, _, _ = run(wrong, h, transition, q, r)
    response = np.zeros((3, 1))
    for i in range(start, N_EPOCHS):
        seen = respond(h, c, response)
        np.testing.assert_allclose(shifted[i] - clean[i], 2.5 * seen[:, 0], atol=1e-10)
        response = carry_response(transition, gains[i], response, seen)


def test_a_bias_too_small_for_an_epoch_is_found_over_a_window(model: tuple[Floats, Floats, Floats, Floats]) -> None:
    h, transition, q, r = model
    rng = np.random.default_rng(13)
    c, found, alone, size = np.eye(5)[:, [2]], 0, 0, 2.0  # 2 m where one sigma of the observation is 1.4
    x, y = np.zeros(3), np.zeros((N_EPOCHS, 5))
    for _ in range(100):
        x[:] = 0.0
        for i in range(N_EPOCHS):
            x = transition @ x + rng.normal(size=3) * np.sqrt(0.02)
            y[i] = h @ x + rng.normal(size=5) * np.sqrt(np.diag(r)) + size * c[:, 0]
        v, s, gains = run(y, h, transition, q, r)
        response, sums, single = np.zeros((3, 1)), np.zeros((1, 2)), 0.0
        for i in range(N_EPOCHS):
            seen = respond(h, c, response)
            weight = np.linalg.solve(s[i], seen)
            w = accumulate(sums, weight.T @ v[i], np.diag(seen.T @ weight).copy(), 1.0)
            single = max(single, abs((weight.T @ v[i])[0]) / np.sqrt((seen.T @ weight)[0, 0]))
            response = carry_response(transition, gains[i], response, seen)
        found += abs(w[0]) > 3.29
        alone += single > 3.29
    assert found > 95
    assert alone < found


def test_the_window_sums_are_chi_square_with_the_redundancies() -> None:
    window, rng = Window(), np.random.default_rng(14)
    for m in (4, 7, 2):
        window = add_epoch(window, float(m), m, 1.0)
    assert equivalent(window) == pytest.approx((13.0, 13.0))
    exceeding, n = 0, 4000
    for _ in range(n):
        window = Window()
        for value in rng.chisquare(6, 40):
            window = add_epoch(window, float(value), 6, 0.9)
        statistic, freedom = equivalent(window)
        exceeding += statistic > stats.chi2.ppf(0.95, freedom)
    assert exceeding / n == pytest.approx(0.05, abs=0.012)  # 3 sigma of the count, and the approximation
    assert equivalent(Window()) == (0.0, 0.0)


def test_what_is_usual_of_shares_is_their_mean_and_spread() -> None:
    """Oracle: mean and variance of the draws, NumPy; χ² shares have no excess; one wild share counts as four."""
    rng, usual, r = np.random.default_rng(15), Share(), 30
    for share in 1.7 * rng.chisquare(r, 20_000) / r:
        usual = add_share(usual, float(share), 5_000, 4.0)
    assert usual.mean == pytest.approx(1.7, rel=0.02)
    assert usual.variance == pytest.approx(1.7**2 * 2.0 / r, rel=0.1)
    assert usual.excess(r) < 0.01
    assert add_share(Share(epochs=99), 1e6, 100, 4.0).mean == pytest.approx(1.0 + 3.0 / 101)
