"""Weighted least squares by normal equations, for problems as small and well-scaled as a code-only position."""

import numpy as np
from numba import njit
from numpy.typing import NDArray

from plumbline.estimation.kalman import cholesky_lower, lower_inverse

Floats = NDArray[np.float64]


@njit(cache=True)
def solve(h: Floats, v: Floats, sigma: Floats) -> tuple[Floats, Floats, bool]:
    """Minimise ``Σ ((v − h x) / sigma)²``.

    ``h`` (m, n), ``v`` and ``sigma`` (m,). Returns ``x`` (n,), its covariance (n, n) and whether the problem is
    solvable (the normal matrix is positive definite, with no pivot below 1e-12 of its diagonal).
    """
    m, n = h.shape
    normal = np.zeros((n, n))
    right = np.zeros(n)
    for i in range(m):
        weight = 1.0 / (sigma[i] * sigma[i])
        for j in range(n):
            if h[i, j] != 0.0:
                right[j] += weight * h[i, j] * v[i]
                for k in range(j + 1):
                    normal[j, k] += weight * h[i, j] * h[i, k]
    for j in range(n):
        for k in range(j):
            normal[k, j] = normal[j, k]
    factor, positive = cholesky_lower(normal)
    for j in range(n):
        if not positive or factor[j, j] * factor[j, j] < 1e-12 * normal[j, j]:
            return np.zeros(n), np.zeros((n, n)), False
    inverse = lower_inverse(factor)
    covariance = np.zeros((n, n))
    for i in range(n):
        for j in range(n):
            for k in range(max(i, j), n):
                covariance[i, j] += inverse[k, i] * inverse[k, j]
    return covariance @ right, covariance, True


@njit(cache=True)
def residuals(h: Floats, v: Floats, x: Floats) -> Floats:
    """``v − h x``, (m,)."""
    return v - h @ x
