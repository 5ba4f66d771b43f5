"""LAMBDA against RTKLIB's own implementation."""

import numpy as np
import pytest

from plumbline.estimation.ambiguity import resolve

rtklib = pytest.importorskip("pyrtklib5")


def _rtklib_lambda(a: np.ndarray, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Best and second best integers, and their squared norms."""
    n = a.size
    arrays = [rtklib.Arr1Ddouble(size) for size in (n, n * n, 2 * n, 2)]
    for i in range(n):
        arrays[0][i] = float(a[i])
        for j in range(n):
            arrays[1][i + j * n] = float(q[i, j])
    status = getattr(rtklib, "lambda")(n, 2, *arrays)
    assert status == 0
    values = np.rint([arrays[2][i] for i in range(2 * n)])  # it transforms back in floating point
    return values[:n], values[n:], np.array([arrays[3][0], arrays[3][1]])


@pytest.mark.parametrize("n", [3, 8, 15, 25])
@pytest.mark.parametrize("seed", range(4))
def test_same_integers_and_norms(n: int, seed: int) -> None:
    rng = np.random.default_rng([seed, n])
    geometry = rng.normal(size=(n, 3))
    q = np.diag(rng.uniform(0.01, 0.05, n)) + geometry @ np.diag([1.0, 2.0, 4.0]) @ geometry.T
    a = rng.multivariate_normal(rng.integers(-90, 90, n), q, method="cholesky")
    best, second, norms = _rtklib_lambda(a, q)
    found = resolve(a, q, min_ratio=1.0, min_success_rate=0.0, partial=False)
    np.testing.assert_array_equal(found.integers, best)
    assert found.squared_norm == pytest.approx(norms[0], rel=1e-6)
    if norms[1] < 4.0 * norms[0]:
        np.testing.assert_array_equal(found.second, second)
        assert found.second_squared_norm == pytest.approx(norms[1], rel=1e-6)
