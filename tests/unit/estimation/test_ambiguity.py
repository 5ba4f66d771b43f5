"""Integer least squares. Oracles: the literature's example, brute force, identities, and simulated success rates."""

import itertools

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from plumbline.estimation.ambiguity import decorrelate, resolve, search, success_rate

# de Jonge & Tiberius 1996, LGR 12: the example that every implementation of LAMBDA is tried on.
FLOAT = np.array([5.450, 3.100, 2.970])
COVARIANCE = np.array([[6.290, 5.978, 0.544], [5.978, 6.292, 2.340], [0.544, 2.340, 6.288]])


def random_covariance(rng: np.random.Generator, n: int, noise: float = 0.01) -> np.ndarray:
    """Strongly correlated, as between the ambiguities of a short observation span."""
    geometry = rng.normal(size=(n, 3))
    return np.diag(rng.uniform(0.2, 2.0, n)) * noise + geometry @ np.diag(rng.uniform(0.1, 4.0, 3)) @ geometry.T


def brute_force(a: np.ndarray, q: np.ndarray, reach: int) -> list[tuple[float, tuple[int, ...]]]:
    inverse, centre = np.linalg.inv(q), np.rint(a).astype(int)
    found = []
    for offset in itertools.product(range(-reach, reach + 1), repeat=a.size):
        z = centre + np.array(offset)
        found.append((float((a - z) @ inverse @ (a - z)), tuple(z.tolist())))
    return sorted(found)[:2]


def test_the_example_of_the_literature() -> None:
    found = resolve(FLOAT, COVARIANCE, min_ratio=1.0, min_success_rate=0.0, partial=False)
    assert found.integers.tolist() == [5, 3, 4]
    assert found.second.tolist() == [6, 4, 4]
    assert found.squared_norm == pytest.approx(0.2183, abs=5e-5)
    assert found.second_squared_norm == pytest.approx(0.3073, abs=5e-5)


@pytest.mark.parametrize("n", [1, 2, 3, 4, 5])
@pytest.mark.parametrize("seed", range(6))
def test_search_against_brute_force(n: int, seed: int) -> None:
    rng = np.random.default_rng([seed, n])
    a = rng.normal(0.0, 20.0, n)
    mix = rng.normal(size=(n, n))
    q = mix @ mix.T * 0.05 + np.eye(n) * 0.02  # mild correlation: brute force then reaches the best two
    found = resolve(a, q, min_ratio=1.0, min_success_rate=0.0, partial=False)
    (best, z), (second, z2) = brute_force(a, q, 4)
    assert tuple(found.integers.tolist()) == z
    assert found.squared_norm == pytest.approx(best, rel=1e-8)
    if second < 4.0 * best:
        assert tuple(found.second.tolist()) == z2
        assert found.second_squared_norm == pytest.approx(second, rel=1e-8)
    else:
        assert found.ratio == pytest.approx(4.0)


@given(n=st.integers(1, 24), seed=st.integers(0, 2**32 - 1))
@settings(max_examples=60, deadline=None)
def test_decorrelation_is_a_volume_preserving_change_of_integers(n: int, seed: int) -> None:
    q = random_covariance(np.random.default_rng(seed), n)
    l, d, tt, positive = decorrelate(q)  # noqa: E741
    assert positive
    np.testing.assert_allclose(tt @ q @ tt.T, l.T @ np.diag(d) @ l, rtol=1e-7, atol=1e-9 * np.abs(q).max())
    assert abs(round(np.linalg.det(tt.astype(float)))) == 1
    assert np.prod(d) == pytest.approx(np.linalg.det(q), rel=1e-5)
    assert np.abs(np.tril(l, -1)).max(initial=0.0) <= 0.5 + 1e-9


def test_decorrelation_makes_the_conditional_variances_alike() -> None:
    q = random_covariance(np.random.default_rng(5), 12)
    plain, d = np.diag(np.linalg.cholesky(q)) ** 2, decorrelate(q)[1]
    assert d.max() / d.min() < 0.05 * plain.max() / plain.min()
    assert success_rate(d) > success_rate(plain)


def test_the_true_integers_come_back_in_many_dimensions() -> None:
    rng = np.random.default_rng(11)
    q = random_covariance(rng, 60, 0.0005)
    for _ in range(10):
        truth = rng.integers(-1000, 1000, 60)
        found = resolve(rng.multivariate_normal(truth, q, method="cholesky"), q, 1.1, min_success_rate=0.9)
        assert found.complete
        np.testing.assert_array_equal(found.integers, truth)


def test_bootstrapped_success_rate_is_a_lower_bound_that_is_nearly_met() -> None:
    rng = np.random.default_rng(3)
    q = random_covariance(rng, 5) * 0.3
    foretold, tries = success_rate(decorrelate(q)[1]), 3000
    errors = rng.multivariate_normal(np.zeros(5), q, size=tries)
    hits = sum(not resolve(e, q, 1.0, 0.0, partial=False).integers.any() for e in errors)
    spread = 4.0 * np.sqrt(foretold * (1.0 - foretold) / tries)
    assert 0.1 < foretold < 0.99
    assert foretold - spread < hits / tries < foretold + spread + 0.05


def test_ratio_limit_keeps_the_best_and_bounds_the_second() -> None:
    q = random_covariance(np.random.default_rng(8), 14)
    l, d, tt, _ = decorrelate(q)  # noqa: E741
    z = tt @ (np.arange(14) * 7.0 + 0.03)
    full, norms, ended = search(l, d, z)
    limited, limited_norms, limited_ended = search(l, d, z, 3.0)
    assert ended
    assert limited_ended
    np.testing.assert_array_equal(full[0], limited[0])
    assert norms[0] == limited_norms[0]
    assert limited_norms[1] == pytest.approx(min(norms[1], 3.0 * max(norms[0], 1e-3)))


def test_what_can_be_resolved_is_resolved_and_the_rest_follows_by_regression() -> None:
    rng = np.random.default_rng(2)
    sharp, blunt = random_covariance(rng, 6, 1e-4), np.eye(3) * 4.0
    mix = rng.normal(size=(3, 6))
    q = np.block([[sharp, sharp @ mix.T], [mix @ sharp, blunt + mix @ sharp @ mix.T]])
    truth = rng.integers(-50, 50, 9)
    a = rng.multivariate_normal(truth, q, method="cholesky")
    found = resolve(a, q, min_ratio=1.5, min_success_rate=0.99)
    assert found.accepted
    assert not found.complete
    assert 4 <= found.integers.size < 9
    z = found.transform.astype(float)
    np.testing.assert_array_equal(found.transform @ truth, found.integers)
    gain = q @ z.T @ np.linalg.inv(z @ q @ z.T)
    np.testing.assert_allclose(found.values, a - gain @ (z @ a - found.integers), atol=1e-6)


def test_refusals_say_why() -> None:
    weak = resolve(np.array([0.3, 1.6]), np.eye(2), min_success_rate=0.99, partial=False)
    assert not weak.accepted
    assert "success rate" in weak.reason
    between = resolve(np.array([0.5]), np.eye(1) * 1e-4, min_ratio=2.0)
    assert not between.accepted
    assert "ratio 1.00" in between.reason
    singular = resolve(np.zeros(2), np.ones((2, 2)) * np.array([[1.0, 1.0], [1.0, 1.0]]))
    assert not singular.accepted
    assert resolve(np.zeros(0), np.zeros((0, 0))).reason == "no ambiguities"
