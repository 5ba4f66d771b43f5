"""The measurement update of a Kalman filter, in forms that keep what the data say.

Testing and updating are two steps. All observations of an instant are tested together: the innovation covariance
``s = h p hᵀ + r`` is factored by Cholesky, the innovations are whitened with the factor, and their w-statistics name an
outlier (Baarda 1968; Teunissen 2006, *Testing theory*, ch. 4). What passes updates the state one scalar at a time in
Joseph's form, ``p = (1 − k h) p (1 − k h)ᵀ + k r kᵀ`` (Bucy & Joseph 1968), which stays symmetric and positive whatever
the rounding. Design rows are mostly zeros (a handful of 35 states), so only what is not zero is multiplied.

Suffixes: ``x`` state (n,), ``p`` covariance (n, n), ``h`` design matrix (m, n), ``r`` observation variances (m,), ``v``
innovations (m,), ``s`` their covariance (m, m).
"""

import numpy as np
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float64]


@njit(cache=True)
def nonzero_columns(h: Floats) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Columns of each row that are not zero: indices (m, n), of which the first counts (m,) are meant."""
    m, n = h.shape
    columns = np.zeros((m, n), np.int64)
    counts = np.zeros(m, np.int64)
    for i in range(m):
        for j in range(n):
            if h[i, j] != 0.0:
                columns[i, counts[i]] = j
                counts[i] += 1
    return columns, counts


@njit(cache=True)
def innovation_covariance(p: Floats, h: Floats, r: Floats) -> Floats:
    """``h p hᵀ + diag(r)``, (m, m)."""
    m, n = h.shape
    columns, counts = nonzero_columns(h)
    s = np.zeros((m, m))
    ph = np.zeros(n)
    for i in range(m):
        ph[:] = 0.0
        for c in range(counts[i]):
            j = columns[i, c]
            for k in range(n):
                ph[k] += p[j, k] * h[i, j]
        for o in range(i + 1):
            total = 0.0
            for c in range(counts[o]):
                total += h[o, columns[o, c]] * ph[columns[o, c]]
            s[i, o] = total
            s[o, i] = total
        s[i, i] += r[i]
    return s


@njit(cache=True)
def cholesky_lower(s: Floats) -> tuple[Floats, bool]:
    """Lower factor ``l`` with ``l lᵀ = s`` and whether ``s`` was positive definite (else ``l`` is unfinished)."""
    m = s.shape[0]
    factor = np.zeros((m, m))
    for j in range(m):
        pivot = s[j, j]
        for k in range(j):
            pivot -= factor[j, k] * factor[j, k]
        if not pivot > 0.0:
            return factor, False
        root = np.sqrt(pivot)
        factor[j, j] = root
        for i in range(j + 1, m):
            total = s[i, j]
            for k in range(j):
                total -= factor[i, k] * factor[j, k]
            factor[i, j] = total / root
    return factor, True


@njit(cache=True)
def lower_inverse(factor: Floats) -> Floats:
    """Inverse of a lower triangular matrix, (m, m)."""
    m = factor.shape[0]
    inverse = np.zeros((m, m))
    for j in range(m):
        inverse[j, j] = 1.0 / factor[j, j]
        for i in range(j + 1, m):
            total = 0.0
            for k in range(j, i):
                total -= factor[i, k] * inverse[k, j]
            inverse[i, j] = total / factor[i, i]
    return inverse


@njit(cache=True)
def whiten(inverse_factor: Floats, v: Floats) -> Floats:
    """Innovations of unit covariance, ``l⁻¹ v``, (m,); their sum of squares is the NIS."""
    m = v.size
    white = np.zeros(m)
    for i in range(m):
        for k in range(i + 1):
            white[i] += inverse_factor[i, k] * v[k]
    return white


@njit(cache=True)
def w_statistics(inverse_factor: Floats, white: Floats) -> Floats:
    """w-test of each observation, ``(s⁻¹ v)ᵢ / √(s⁻¹)ᵢᵢ``, (m,): standard normal without an outlier."""
    m = white.size
    statistics = np.zeros(m)
    for i in range(m):
        along = 0.0
        norm = 0.0
        for k in range(i, m):
            along += inverse_factor[k, i] * white[k]
            norm += inverse_factor[k, i] * inverse_factor[k, i]
        statistics[i] = along / np.sqrt(norm)
    return statistics


@njit(cache=True)
def _projected(p: Floats, h: Floats, r: float) -> tuple[Floats, float]:
    """``h p`` (n,) and the innovation's variance ``h p hᵀ + r``."""
    n = h.size
    hp, variance = np.zeros(n), r
    for j in range(n):
        if h[j] != 0.0:
            for k in range(n):
                hp[k] += h[j] * p[j, k]
    for j in range(n):
        variance += h[j] * hp[j]
    return hp, variance


@njit(cache=True)
def update_scalar(x: Floats, p: Floats, h: Floats, r: float, v: float) -> float:
    """Update ``x`` and ``p`` in place by one observation (``h`` (n,), innovation ``v`` at the current ``x``), Joseph.

    Returns the innovation's variance. ``(1 − k h) p (1 − k h)ᵀ + r k kᵀ`` is formed in one pass over ``p`` as
    ``p − k (h p) − (p h − k (h p h)) kᵀ + r k kᵀ``: the whole quadratic form in the gain, so that an error of the gain
    enters squared. Symmetric to rounding.
    """
    n = x.size
    hp, variance = _projected(p, h, r)
    gain = hp / variance
    hph = variance - r
    for i in range(n):
        x[i] += gain[i] * v
        if hp[i] != 0.0:
            left, right = -gain[i], r * gain[i] - (hp[i] - gain[i] * hph)
            for k in range(n):
                p[i, k] += left * hp[k] + right * gain[k]
    return variance


@njit(cache=True)
def update_sequential(x: Floats, p: Floats, h: Floats, r: Floats, v: Floats, use: NDArray[np.bool_]) -> float:
    """Update ``x`` and ``p`` in place by the observations marked in ``use``; ``v`` belongs to the ``x`` given.

    Returns their NIS, the sum of squares of their whitened innovations.
    """
    start = x.copy()
    n, nis = x.size, 0.0
    for i in range(v.size):
        if use[i]:
            moved = 0.0
            for j in range(n):
                moved += h[i, j] * (x[j] - start[j])
            left = v[i] - moved
            nis += left * left / update_scalar(x, p, h[i], r[i], left)
    _make_symmetric(p)
    return nis


@njit(cache=True)
def _make_symmetric(p: Floats) -> None:
    for i in range(p.shape[0]):
        for j in range(i):
            mean = 0.5 * (p[i, j] + p[j, i])
            p[i, j], p[j, i] = mean, mean


@njit(cache=True)
def _carry_errors(q: Floats, gain: Floats, h: Floats, r: float) -> None:
    """``(1 − k h) q (1 − k h)ᵀ + r k kᵀ`` for any gain ``k`` (n,), in place."""
    hq, spread = _projected(q, h, r)
    for i in range(gain.size):
        along = spread * gain[i] - hq[i]
        for k in range(gain.size):
            q[i, k] += along * gain[k] - gain[i] * hq[k]


@njit(cache=True)
def update_with_errors(
    x: Floats, p: Floats, q: Floats, h: Floats, r: Floats, v: Floats, use: NDArray[np.bool_]
) -> float:  # fmt: skip
    """As :func:`update_sequential`, and ``q``, in place: the covariance of the errors that the gains of ``p`` leave.

    A filter that trusts its model less than it could has gains, and a covariance ``p``, that go with larger errors than
    it has; what these are follows from the same gains and the true model (Gelb 1974, *Applied Optimal Estimation*,
    7.2).
    """
    start = x.copy()
    n, nis = x.size, 0.0
    for i in range(v.size):
        if use[i]:
            moved = 0.0
            for j in range(n):
                moved += h[i, j] * (x[j] - start[j])
            left = v[i] - moved
            hp, variance = _projected(p, h[i], r[i])
            _carry_errors(q, hp / variance, h[i], r[i])
            nis += left * left / update_scalar(x, p, h[i], r[i], left)
    _make_symmetric(p)
    _make_symmetric(q)
    return nis
